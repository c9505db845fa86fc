#include "render/scene.h"

#include <charconv>
#include <cmath>
#include <nlohmann/json.hpp>
#include <unordered_set>

#include "base/files.h"
#include "base/numeric.h"
#include "base/text.h"
#include "field/capture_json.h"

namespace srf {
namespace {

constexpr int kMostFrames = 1000000;
constexpr double kLeastLength = 1e-30, kMostLength = 1e30;  // units

/// A number from `least` to `most`.
double numberWithin(const JsonNode& node, double least, double most) {
  const double x = node.number();
  if (!(x >= least && x <= most))
    throw node.error("found " + shortNumber(x) + ", expected a number from " + shortNumber(least) + " to " +
                     shortNumber(most));
  return x;
}

/// Where the value of key `i` of an animated value stands.
JsonNode keyNode(const JsonNode& node, std::size_t i) {
  return node.isObject() ? node["keys"].at(i).at(1) : node;
}

/// A direction: every key is made a unit vector.
Animated<Vec3> readDirection(const JsonNode& node) {
  const Animated<Vec3> value = readAnimatedVec3(node);
  auto keys = value.keys();
  for (std::size_t i = 0; i < keys.size(); ++i) {
    const auto unit = normalize(Vector<ObjectSpace>(keys[i].second));
    if (!unit) throw keyNode(node, i).error("has length 0, expected a direction [x, y, z]");
    keys[i].second = unit->raw();
  }
  return {std::move(keys), value.interpolation()};
}

/// An animated number whose keys all lie from `least` to `most`.
Animated<double> readNumberWithin(const JsonNode& node, double least, double most) {
  Animated<double> value = readAnimatedNumber(node);
  for (std::size_t i = 0; i < value.keys().size(); ++i) numberWithin(keyNode(node, i), least, most);
  return value;
}

SceneCamera readCamera(const JsonNode& node, const std::filesystem::path& folder) {
  std::string forms;
  for (const char* form : {"look_at", "transform_matrix", "gltf"}) {
    if (!node.has(form)) continue;
    if (!forms.empty())
      throw node.error("has " + forms + " and " + form + ", expected one of the two; remove the other");
    forms = form;
  }
  if (node.has("gltf")) return FileCamera(node, folder);
  if (!node.has("look_at")) {
    node.onlyKeys({SRF_LENS_KEYS, "camera_angle_x", "camera_angle_y", "transform_matrix", "look_at", "vfov", "gltf"});
    if (!node.has("transform_matrix"))
      throw node.error("has neither look_at, transform_matrix nor gltf; add one of them");
    if (const auto vfov = node.find("vfov"))
      throw vfov->error("belongs to look_at; give fl_x and fl_y beside a transform_matrix");
    // The file's camera stands in object space; the reader's type speaks of a capture's.
    return atRest({readLens({node}), readPose(node["transform_matrix"])});
  }
  for (const char* key : {SRF_LENS_KEYS, "camera_angle_x", "camera_angle_y"})
    if (const auto found = node.find(key); found && key != std::string_view("w") && key != std::string_view("h"))
      throw found->error("belongs to transform_matrix; give vfov beside look_at");
  node.onlyKeys({"w", "h", "vfov", "look_at"});
  LookAtCamera camera;
  camera.width = static_cast<int>(node["w"].integer(1, 65536));
  camera.height = static_cast<int>(node["h"].integer(1, 65536));
  camera.vfov = readAnimatedNumber(node["vfov"]);
  for (std::size_t i = 0; i < camera.vfov.keys().size(); ++i) {
    const double vfov = camera.vfov.keys()[i].second;
    if (!(vfov > 0 && vfov < 180))
      throw keyNode(node["vfov"], i).error("found " + shortNumber(vfov) + ", expected degrees above 0 and below 180");
  }
  const JsonNode look_at = node["look_at"].onlyKeys({"eye", "target", "up"});
  camera.eye = readAnimatedVec3(look_at["eye"]);
  camera.target = readAnimatedVec3(look_at["target"]);
  camera.up = readDirection(look_at["up"]);
  return camera;
}

SceneLight readLight(const JsonNode& node, const std::filesystem::path& folder) {
  switch (node["type"].choice({"point", "directional", "environment", "captured", "gltf"})) {
    case 0:
      node.onlyKeys({"type", "position", "intensity"});
      return PointLight{readAnimatedVec3(node["position"]), readAnimatedAmounts(node["intensity"])};
    case 1:
      node.onlyKeys({"type", "direction", "irradiance"});
      return DirectionalLight{readDirection(node["direction"]), readAnimatedAmounts(node["irradiance"])};
    case 2: {
      node.onlyKeys({"type", "map", "rotation", "scale", "samples"});
      EnvironmentLight light;
      light.map = existingFile(node["map"], folder);
      light.rotation = node.has("rotation") ? readAnimatedNumber(node["rotation"]) : Animated<double>(0);
      light.scale = readAnimatedScale(node, "scale");
      if (const auto samples = node.find("samples")) light.samples = static_cast<int>(samples->integer(0, 1000000));
      return light;
    }
    case 4:
      return FileLights(node, folder);
    default:
      node.onlyKeys({"type", "light", "scale"});
      return CapturedLight{node.has("light") ? node["light"].string() : "", readAnimatedScale(node, "scale")};
  }
}

Accuracy readAccuracy(const JsonNode& node) {
  node.onlyKeys({"views", "lights", "frame", "light_sharing", "min_distance", "texels", "shading", "shadow_rays"});
  Accuracy accuracy;
  if (const auto views = node.find("views")) accuracy.views = static_cast<int>(views->integer(1, 64));
  if (const auto lights = node.find("lights")) accuracy.lights = static_cast<int>(lights->integer(1, 64));
  if (const auto frame = node.find("frame"))
    accuracy.frame = frame->choice({"bisector", "polar"}) == 0 ? FrameMode::bisector : FrameMode::polar;
  if (const auto degrees = node.find("light_sharing")) accuracy.light_sharing = numberWithin(*degrees, 0, 90);
  if (const auto distance = node.find("min_distance")) accuracy.min_distance = numberWithin(*distance, 1e-9, 1);
  if (const auto texels = node.find("texels")) {
    accuracy.texels = numberWithin(*texels, 0, 1e6);
    if (accuracy.texels > 0 && accuracy.texels < 1.5)
      throw texels->error("found " + std::to_string(accuracy.texels) +
                          ", expected 0 (the photographs as they are) or at least 1.5");
  }
  if (const auto shading = node.find("shading"))
    accuracy.shading = static_cast<Shading>(shading->choice(kShadingWords));
  if (const auto rays = node.find("shadow_rays")) accuracy.shadow_rays = static_cast<int>(rays->integer(0, 1000000));
  return accuracy;
}

void readEffects(const JsonNode& node, Scene& scene) {
  node.onlyKeys({"shadows", "matte", "ground", "motion_blur", "depth_of_field"});
  if (const auto shadows = node.find("shadows")) {
    constexpr Shadows kShadows[] = {Shadows::captured, Shadows::deformed, Shadows::both, Shadows::off};
    scene.shadows = kShadows[shadows->choice({"captured", "deformed", "both", "off"})];
    if ((scene.interpolation == Interpolation::guided || scene.interpolation == Interpolation::model) &&
        scene.shadows == Shadows::both)
      throw shadows->error(
          "found \"both\", which is for plain interpolation: guided interpolation tells the rest pose's shadows apart; "
          "use \"deformed\"");
  }
  Effects& effects = scene.effects;
  if (const auto matte = node.find("matte")) effects.matte = matte->boolean();
  if (const auto ground = node.find("ground")) {
    ground->onlyKeys({"height", "shadow_only", "albedo"});
    effects.ground.emplace().height = readAnimatedNumber((*ground)["height"]);
    if (const auto shadow_only = ground->find("shadow_only")) effects.ground->shadow_only = shadow_only->boolean();
    if (const auto albedo = ground->find("albedo")) {
      effects.ground->albedo = readAnimatedVec3(*albedo);
      for (std::size_t i = 0; i < effects.ground->albedo.keys().size(); ++i)
        for (int c = 0; c < 3; ++c) numberWithin(keyNode(*albedo, i).at(c), 0, 1);
    }
  }
  if (const auto blur = node.find("motion_blur")) {
    blur->onlyKeys({"shutter", "samples"});
    effects.motion_blur.emplace().shutter = readNumberWithin((*blur)["shutter"], 0, kMostFrames);
    if (const auto samples = blur->find("samples"))
      effects.motion_blur->samples = static_cast<int>(samples->integer(1, 1024));
  }
  if (const auto lens = node.find("depth_of_field")) {
    lens->onlyKeys({"aperture", "focus"});
    effects.depth_of_field = DepthOfField{readNumberWithin((*lens)["aperture"], 0, kMostLength),
                                          readNumberWithin((*lens)["focus"], kLeastLength, kMostLength)};
  }
}

std::vector<int> readFrames(const JsonNode& node) {
  if (node.isNumber()) return {static_cast<int>(node.integer(-kMostFrames, kMostFrames))};
  return parseFrames(node.string(), node.where());
}

/// What the keys that change a picture hold, whatever their order of reading.
std::uint64_t contentOf(const JsonNode& root) {
  Json content = root.raw();
  for (const char* key : {"srf", "frames", "output"}) content.erase(key);
  const std::string text = content.dump();
  return contentHash(text.data(), text.size());
}

}  // namespace

Scene readScene(const std::filesystem::path& file, const std::vector<std::string>& overrides, Reporter& reporter) {
  JsonNode root = readJsonFile(file);
  for (const std::string& assignment : overrides) root = withOverride(root, assignment);
  root.onlyKeys({"srf", "camera", "deformation", "lights", "frames", "fps", "output", "interpolation", "samples",
                 "effects", "accuracy"});
  const std::filesystem::path folder = file.parent_path();
  Scene scene;
  scene.file = file;
  if (const auto srf = root.find("srf")) scene.srf = folder / srf->string();
  scene.camera = readCamera(root["camera"], folder);
  if (const auto list = root.find("deformation"))
    scene.deformation = AnimatedDeformation::parse(*list, folder, reporter);
  const JsonNode lights = root["lights"];
  for (std::size_t i = 0; i < lights.size(); ++i) scene.lights.push_back(readLight(lights.at(i), folder));
  if (const auto frames = root.find("frames")) scene.frames = readFrames(*frames);
  if (const auto fps = root.find("fps")) scene.fps = numberWithin(*fps, 1e-3, 1e4);
  if (const auto output = root.find("output")) scene.output = output->string();
  if (const auto way = root.find("interpolation")) {
    constexpr Interpolation kWays[] = {Interpolation::plain, Interpolation::guided, Interpolation::model};
    scene.interpolation = kWays[way->choice({"plain", "guided", "model"})];
  }
  if (const auto samples = root.find("samples")) scene.samples = static_cast<int>(samples->integer(1, 1024));
  if (const auto effects = root.find("effects")) readEffects(*effects, scene);
  if (const auto accuracy = root.find("accuracy")) scene.accuracy = readAccuracy(*accuracy);
  scene.content_hash = contentOf(root);
  const auto mix = [&scene](std::uint64_t hash) {
    scene.content_hash = contentHash(&hash, sizeof hash, scene.content_hash);
  };
  if (const auto* from_file = std::get_if<FileCamera>(&scene.camera)) mix(from_file->contentHash());
  for (const SceneLight& light : scene.lights)
    if (const auto* from_file = std::get_if<FileLights>(&light)) mix(from_file->contentHash());
  return scene;
}

std::string shadingAsJson(Shading shading) {
  return '"' + std::string(kShadingWords[static_cast<std::size_t>(shading)]) + '"';
}

Camera<ObjectSpace> Scene::cameraAt(double frame) const {
  if (const auto* fixed = std::get_if<Camera<ObjectSpace>>(&camera)) return *fixed;
  if (const auto* from_file = std::get_if<FileCamera>(&camera)) return from_file->at(frame / fps);
  const auto& moving = std::get<LookAtCamera>(camera);
  const std::string where = file.string() + ": /camera";
  const std::string at_frame = " at frame " + shortNumber(frame);
  const double vfov = moving.vfov.at(frame);
  if (!(vfov > 0 && vfov < 180))  // cubic keys may overshoot
    throw badInput(where + "/vfov", "is " + shortNumber(vfov) + at_frame + ", expected degrees above 0 and below 180");
  const Point<ObjectSpace> eye(moving.eye.at(frame)), target(moving.target.at(frame));
  const auto pose = lookAt(eye, target, Vector<ObjectSpace>(moving.up.at(frame)));
  if (!pose)
    throw badInput(where + "/look_at", normalize(target - eye)
                                           ? "up is parallel to the viewing direction" + at_frame + "; tilt it"
                                           : "eye and target are the same point" + at_frame + "; move one of them");
  return {pinholeFromFov(moving.width, moving.height, vfov), *pose};
}

std::vector<int> parseFrames(const std::string& text, const std::string& where) {
  const char* at = text.data();
  const char* const end = at + text.size();
  const auto fail = [&](const std::string& what) {
    return Error(where.starts_with("--") ? ErrorKind::usage : ErrorKind::bad_input,
                 "found '" + text + "', " + what + "expected frames such as 0-60, 0-60x2, 3 or 1,3,10-20", where);
  };
  const auto number = [&] {
    int value = 0;
    const auto [next, code] = std::from_chars(at, end, value);
    if (code != std::errc() || std::abs(value) > kMostFrames) throw fail("");
    at = next;
    return value;
  };
  const auto skip = [&](char c) { return at != end && *at == c && ++at; };
  std::vector<int> frames;
  std::unordered_set<int> named;
  do {
    while (skip(' ')) {}
    const int first = number();
    int last = first, step = 1;
    if (skip('-')) {
      last = number();
      if (skip('x')) step = number();
      if (last < first) throw fail("which runs backwards; ");
      if (step < 1) throw fail("whose step is not above 0; ");
    }
    while (skip(' ')) {}
    for (int frame = first; frame <= last; frame += step)
      if (named.insert(frame).second) frames.push_back(frame);
    if (frames.size() > static_cast<std::size_t>(kMostFrames)) throw fail("which is more than a million frames; ");
  } while (skip(','));
  if (at != end) throw fail("");
  return frames;
}

std::filesystem::path frameFile(const std::string& pattern, int frame) {
  std::filesystem::path path(pattern);
  std::string name = path.filename().string();
  const std::string digits = std::to_string(std::abs(frame));
  const auto padded = [&](std::size_t width) {
    return (frame < 0 ? "-" : "") + (digits.size() < width ? std::string(width - digits.size(), '0') : "") + digits;
  };
  if (const auto last = name.find_last_of('#'); last != std::string::npos) {
    const auto before = name.find_last_not_of('#', last);
    const std::size_t first = before == std::string::npos ? 0 : before + 1;
    name.replace(first, last + 1 - first, padded(last + 1 - first));
  } else if (const auto percent = name.find("%0"); percent != std::string::npos && percent + 3 < name.size() &&
                                                   std::isdigit(static_cast<unsigned char>(name[percent + 2])) &&
                                                   name[percent + 3] == 'd') {
    name.replace(percent, 4, padded(static_cast<std::size_t>(name[percent + 2] - '0')));
  } else {
    const std::string extension = path.extension().string();
    name = path.stem().string() + "." + padded(4) + extension;
  }
  return path.replace_filename(name);
}

}  // namespace srf
