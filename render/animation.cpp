#include "render/animation.h"

#include <algorithm>
#include <chrono>
#include <optional>

#include "base/files.h"
#include "base/image_io.h"
#include "base/text.h"
#include "render/light_set.h"

namespace srf {
namespace {

namespace fs = std::filesystem;

std::uint64_t fileHash(const fs::path& file) {
  const auto bytes = readBinaryFile(file);
  return contentHash(bytes.data(), bytes.size());
}

std::set<std::string> checkedLayers(const std::vector<std::string>& asked) {
  const std::vector<std::string> known = knownLayers();
  std::string list;
  for (const std::string& name : known) list += (list.empty() ? "" : ", ") + name;
  for (const std::string& name : asked) {
    if (std::find(known.begin(), known.end(), name) != known.end()) continue;
    const std::string near = nearestWord(name, known);
    throw Error(ErrorKind::usage,
                "unknown layer '" + name + "'" + (near.empty() ? "" : "; did you mean '" + near + "'?") +
                    " (known: " + list + ")",
                "--aovs");
  }
  return {asked.begin(), asked.end()};
}

/// What a frame's picture depends on, as it stands in the frame's header: --resume keeps a frame that says the same.
Attributes commonAttributes(const Scene& scene, const SrfManifest& manifest, const fs::path& srf,
                            const std::set<std::string>& layers) {
  std::string settings = hexHash(scene.content_hash);
  for (const std::string& layer : layers) settings += "," + layer;
  std::string maps;
  for (const SceneLight& light : scene.lights)
    if (const auto* environment = std::get_if<EnvironmentLight>(&light)) maps += hexHash(fileHash(environment->map));
  Attributes attributes;
  attributes["software"] = "srf " SRF_VERSION;
  attributes["settingsHash"] = hexHash(contentHash(settings.data(), settings.size()));
  attributes["fieldHash"] = hexHash(fileHash(srf / "manifest.json"));  // holds the hashes of the stores
  attributes["modelHash"] = hexHash(manifest.model(manifest.active_model)->hash);
  attributes["environmentHash"] = hexHash(contentHash(maps.data(), maps.size()));
  return attributes;
}

constexpr const char* kSupportAttribute = "captureSupport";

/// The header of a frame that the same input and settings have finished.
std::optional<Attributes> finished(const fs::path& file, const Attributes& attributes) {
  if (!fs::exists(file)) return std::nullopt;
  try {
    Attributes found = readExrAttributes(file);
    const bool same = std::all_of(attributes.begin(), attributes.end(), [&](const auto& entry) {
      const auto it = found.find(entry.first);
      return it != found.end() && it->second == entry.second;
    });
    if (same) return found;
  } catch (const Error&) {  // damaged: rendered again
  }
  return std::nullopt;
}

std::size_t writeFrame(const fs::path& file, const Frame& frame, const Attributes& attributes) {
  static constexpr const char* kNames[] = {"R", "G", "B", "A"};
  std::vector<ExrChannel> channels;
  for (int c = 0; c < 4; ++c) channels.push_back({kNames[c], frame.rgba.data().data() + c, 4, false});
  // Layers hold positions, rotations and numbers of views, for which a half has too few digits.
  for (const auto& [name, image] : frame.layers) channels.push_back({name, image.data().data(), 1, true});
  return writeExr(file, frame.rgba.width(), frame.rgba.height(), channels, attributes);
}

void countPoints(const DeformedStatistics& statistics, double moment, Reporter& reporter) {
  reporter.count("points.mirrored", statistics.mirrored);
  reporter.count("points.collapsed", statistics.collapsed);
  reporter.count("points.not_finite", statistics.not_finite);
  reporter.count("points.unsure_handedness", statistics.unsure_handedness);
  if (statistics.not_finite > 0)
    reporter.warn("frame " + shortNumber(moment) + ": the deformation sends " + std::to_string(statistics.not_finite) +
                  " points of the model nowhere (NaN or Inf); they are left out");
}

fs::path fieldOf(const Scene& scene, const AnimationOptions& options) {
  const fs::path srf = options.srf.empty() ? scene.srf : options.srf;
  if (srf.empty()) throw badInput(scene.file.string(), "names no field; add \"srf\" to it or give --srf X.srf");
  if (options.srf.empty() && !fs::is_directory(srf))
    throw badInput(scene.file.string() + ": /srf", "'" + srf.string() +
                                                       "' is not a folder, expected an SRF, relative to the scene's "
                                                       "file; make one with `srf acquire` or mend the path");
  return srf;
}

void warnOfGround(const Scene& scene, Reporter& reporter) {
  const auto captured = [](const SceneLight& light) { return std::holds_alternative<CapturedLight>(light); };
  if (scene.effects.ground && std::any_of(scene.lights.begin(), scene.lights.end(), captured))
    reporter.warn(
        scene.file.string() +
        ": /effects/ground: captured lights are fixed to the surface and stand nowhere in the scene; the ground "
        "is not lit by them");
}

/// The scene's model at one moment after another.
struct MovingScene {
  const Scene& scene;
  const LightSet& lights;
  const VertexMotion* vertex_motion;  ///< may be null
  DeformedModel deformed;
  Reporter& reporter;
  std::optional<std::pair<double, MovedVertices>> vertices;  ///< of the moment asked for last
  bool moved = false;

  const MovedVertices& verticesAt(double moment) {
    if (!vertices || vertices->first != moment) vertices.emplace(moment, vertex_motion->at(moment));
    return vertices->second;
  }
  std::uint64_t verticesHash(const std::vector<double>& moments) {
    std::uint64_t hash = 0;
    for (const double moment : moments) {
      const auto& positions = verticesAt(moment).positions;
      hash = contentHash(positions.data(), positions.size() * sizeof positions[0], hash);
    }
    return hash;
  }
  void moveTo(double moment) {
    if (moved && scene.deformation.constant()) return;
    deformed.deform(scene.deformation.at(moment), vertex_motion ? &verticesAt(moment) : nullptr);
    countPoints(deformed.statistics(), moment, reporter);
    // M8: the sign comes from the volume of each closed part. One frame of the motion says it for all.
    if (const std::size_t unsure = deformed.statistics().unsure_handedness; unsure > 0 && !moved)
      reporter.warn("the mesh that moves is open in parts: nothing tells whether " + std::to_string(unsure) +
                    " of its vertices are mirrored, and they are taken not to be");
    moved = true;
  }
  Frame render(double moment, FrameRenderer& renderer) {
    moveTo(moment);
    return renderer.render(scene.cameraAt(moment), deformed, lights.at(moment), effectsAt(scene.effects, moment));
  }
  /// The mean over the moments; layers are those of the one in the middle, since positions and numbers have no mean.
  Frame render(const std::vector<double>& moments, FrameRenderer& renderer) {
    Frame frame = render(moments.front(), renderer);
    if (moments.size() == 1) return frame;
    std::vector<double> sum(frame.rgba.data().begin(), frame.rgba.data().end());
    for (std::size_t i = 1; i < moments.size(); ++i) {
      Frame next = render(moments[i], renderer);
      for (std::size_t k = 0; k < sum.size(); ++k) sum[k] += next.rgba.data()[k];
      if (i <= moments.size() / 2) frame.layers = std::move(next.layers), frame.support = next.support;
    }
    for (std::size_t k = 0; k < sum.size(); ++k)
      frame.rgba.data()[k] = static_cast<float>(sum[k] / static_cast<double>(moments.size()));
    return frame;
  }
};

}  // namespace

std::optional<ReflectanceFit> guidingFit(const Scene& scene, const fs::path& srf, const SrfManifest& manifest,
                                         const DeformableModel& model) {
  if (scene.interpolation == Interpolation::plain) return std::nullopt;
  std::optional<ReflectanceFit> fit = loadFit(srf, manifest, model);
  if (!fit && scene.interpolation != Interpolation::automatic)
    throw badInput(scene.file.string() + ": /interpolation",
                   std::string("found \"") + (scene.interpolation == Interpolation::model ? "model" : "guided") +
                       "\", yet the model of " + srf.string() + " holds no fit; run srf model again, or use \"plain\"");
  if (scene.shadows == Shadows::both) return std::nullopt;  // plain alone has the photographs' own shadows to add to
  return fit;
}

FrameSettings frameSettings(const Scene& scene, const std::optional<ReflectanceFit>& fit, std::size_t memory_bytes) {
  FrameSettings settings;
  settings.accuracy = scene.accuracy;
  settings.fit = fit ? &*fit : nullptr;
  settings.model_alone = scene.interpolation == Interpolation::model;
  settings.shadows = scene.shadows;
  if (scene.shadows == Shadows::automatic)
    settings.shadows = !fit || scene.deformation.none() ? Shadows::captured : Shadows::deformed;
  settings.samples = scene.samples;
  settings.matte = scene.effects.matte;
  settings.memory_bytes = memory_bytes;
  return settings;
}

std::vector<RenderedFrame> renderAnimation(const Scene& scene, const AnimationOptions& options, Reporter& reporter) {
  const fs::path srf = fieldOf(scene, options);
  const std::string pattern = options.output.empty() ? scene.output : options.output;
  if (pattern.empty())
    throw badInput(scene.file.string(), "names no output; add \"output\" to it or give -o name.####.exr");
  if (fs::path(pattern).extension() != ".exr")
    throw badInput("output", "found '" + pattern + "', expected a name that ends in .exr");
  const std::vector<int>& numbers = options.frames.empty() ? scene.frames : options.frames;
  const std::set<std::string> layers = checkedLayers(options.layers);

  // Everything that can be wrong is found before the first frame.
  const SrfManifest manifest = readManifest(srf);
  const DeformableModel model = loadModel(srf, manifest);
  const std::optional<ReflectanceFit> fit = guidingFit(scene, srf, manifest, model);
  const LightSet light_set(scene, manifest, reporter);
  warnOfGround(scene, reporter);
  const auto vertex_motion = scene.deformation.movesVertices()
                                 ? scene.deformation.vertexMotion(model.restMesh(), scene.fps, reporter)
                                 : nullptr;
  for (const int number : numbers)
    for (const double moment : momentsOf(scene.effects, number)) {
      scene.cameraAt(moment);
      scene.deformation.at(moment);
      light_set.at(moment);
      if (vertex_motion) vertex_motion->at(moment);
    }
  if (!numbers.empty()) PartialFile may_write(frameFile(pattern, numbers.front()));

  const Attributes common = commonAttributes(scene, manifest, srf, layers);
  FrameSettings settings = frameSettings(scene, fit, options.memory_bytes);
  settings.layers = layers;
  settings.support = options.support;
  settings.shortcuts = options.shortcuts;
  FrameSupport support;  // of all frames together
  MovingScene moving{scene, light_set, vertex_motion.get(), DeformedModel(model), reporter};
  std::optional<FrameRenderer> renderer;  // opened with the first frame that is not kept
  std::vector<RenderedFrame> rendered;
  Reporter::Stage stage(reporter, "render", numbers.size());
  for (const int number : numbers) {
    const auto start = std::chrono::steady_clock::now();
    RenderedFrame result{number, frameFile(pattern, number)};
    Attributes attributes = common;
    attributes["frameNumber"] = std::to_string(number);
    const std::vector<double> moments = momentsOf(scene.effects, number);
    if (vertex_motion) attributes["verticesHash"] = hexHash(moving.verticesHash(moments));
    const auto kept = options.resume ? finished(result.file, attributes) : std::nullopt;
    if (kept) {
      result.kept = true;
      if (const auto told = kept->find(kSupportAttribute); options.support && told != kept->end())
        result.support = FrameSupport::fromNumbers(told->second);
    } else {
      if (!renderer) renderer.emplace(srf, manifest, model, settings, reporter);
      const Frame frame = moving.render(moments, *renderer);
      if ((result.support = frame.support)) attributes[kSupportAttribute] = frame.support->numbers();
      attributes["command"] = options.command;
      attributes["framesPerSecond"] = std::to_string(scene.fps);
      if (const std::size_t clamped = writeFrame(result.file, frame, attributes)) {
        reporter.count("pixels.clamped", clamped);
        reporter.warn(result.file.string() + ": " + std::to_string(clamped) +
                      " values are beyond the range of half floats (65504) and were clamped; lower the lights");
      }
    }
    if (result.support) {
      support.add(*result.support);
      reporter.figure("support.frame." + std::to_string(number), result.support->share(result.support->supported));
    }
    result.seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
    rendered.push_back(result);
    if (options.finished) options.finished(result, numbers.size() - rendered.size());
    stage.advance();
  }
  if (support.hits > 0) {
    reporter.figure("support.supported", support.share(support.supported));
    reporter.figure("support.far_from_views", support.share(support.view_far));
    reporter.figure("support.far_from_lights", support.share(support.light_far));
    reporter.figure("support.seen_by_no_view", support.share(support.occluded));
    reporter.figure("support.stretched", support.share(support.stretched));
  }
  return rendered;
}

ExplainedFrame explainPixel(const Scene& scene, const AnimationOptions& options, int frame, int x, int y,
                            Reporter& reporter) {
  const fs::path srf = fieldOf(scene, options);
  const Camera<ObjectSpace> camera = scene.cameraAt(frame);
  if (x < 0 || y < 0 || x >= camera.lens.width || y >= camera.lens.height)
    throw Error(ErrorKind::usage,
                "found " + std::to_string(x) + "," + std::to_string(y) + ", expected a pixel of the picture of " +
                    std::to_string(camera.lens.width) + " x " + std::to_string(camera.lens.height),
                "--pixel");
  ExplainedFrame result;
  result.field = readManifest(srf);
  result.model = loadModel(srf, result.field);
  result.lights = LightSet(scene, result.field, reporter).at(frame);
  DeformedModel deformed(result.model);
  std::optional<MovedVertices> vertices;
  if (scene.deformation.movesVertices())
    vertices = scene.deformation.vertexMotion(result.model.restMesh(), scene.fps, reporter)->at(frame);
  deformed.deform(scene.deformation.at(frame), vertices ? &*vertices : nullptr);
  const std::optional<ReflectanceFit> fit = guidingFit(scene, srf, result.field, result.model);
  FrameRenderer renderer(srf, result.field, result.model, frameSettings(scene, fit, options.memory_bytes), reporter);
  result.pixel = renderer.explain(camera, deformed, result.lights, x, y, effectsAt(scene.effects, frame));
  result.positions = deformed.positions();
  result.tangents = deformed.tangents();
  return result;
}

}  // namespace srf
