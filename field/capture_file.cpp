#include "field/capture_file.h"

#include <algorithm>
#include <array>
#include <cstring>
#include <map>
#include <nlohmann/json.hpp>
#include <set>

#include "field/capture_json.h"

namespace srf {
namespace {

namespace fs = std::filesystem;

// Keys of nerfstudio, instant-ngp and the tools around them that say nothing this project needs: accepted unread.
#define SRF_FOREIGN_TOP_KEYS                                                                                           \
  "aabb_scale", "render_aabb", "render_aabb_to_local", "applied_scale", "ply_file_path", "train_filenames",            \
      "val_filenames", "test_filenames", "orientation_override", "auto_scale_poses_override", "scale", "offset", "up", \
      "from_mitsuba", "from_na", "importance_sampling", "n_extra_learnable_dims", "integer_depth_scale",               \
      "depth_unit_scale_factor", "enable_depth_loading", "enable_ray_loading", "fix_premult", "sharpen",               \
      "white_transparent", "black_transparent", "rolling_shutter", "x_fov", "y_fov", "envmap", "has_mask",             \
      "fisheye_crop_radius", "metadata", "description", "n_frames"
#define SRF_FOREIGN_FRAME_KEYS                                                                                       \
  "sharpness", "colmap_im_id", "depth_file_path", "depth_path", "normal_file_path", "rotation", "time", "timestamp", \
      "camera_id", "cam_id", "appearance_id", "motion_mask_path", "semantics_path", "img_name", "id", "frame_id",    \
      "transform_matrix_start", "transform_matrix_end", "rolling_shutter", "driver_parameters", "vertical_flip",     \
      "fisheye_crop_radius"

bool isImageName(const fs::path& path) {
  static const std::set<std::string> kExtensions{".png",  ".jpg", ".jpeg", ".exr", ".tif",
                                                 ".tiff", ".hdr", ".bmp",  ".webp"};
  std::string extension = path.extension().string();
  for (char& c : extension) c = static_cast<char>(std::tolower(static_cast<unsigned char>(c)));
  return kExtensions.contains(extension);
}

fs::path photoFile(const fs::path& folder, const JsonNode& node) {
  const std::string name = node.string();
  if (name.empty()) throw node.error("is empty, expected the path of a photograph");
  const fs::path file = (folder / name).lexically_normal();
  if (isImageName(file)) return file;
  for (const char* extension : {".png", ".jpg", ".exr"}) {
    const fs::path with = file.string() + extension;
    if (fs::exists(with)) return with;
  }
  if (fs::is_regular_file(file)) return file;
  throw node.error("names '" + file.string() + "', which is missing with .png, .jpg and .exr too; mend the path");
}

void requireFile(const fs::path& file, const std::string& place) {
  if (fs::exists(file)) return;
  if (place.empty()) throw badInput(file.string(), "does not exist; check the path");
  throw badInput(place, "names '" + file.string() + "', which does not exist; check the path");
}

// A camera as numbers that can be compared and ordered.
using CameraKey = std::array<double, 27>;
CameraKey cameraKey(const Camera<AcquisitionSpace>& camera) {
  const Intrinsics& c = camera.lens;
  CameraKey key{static_cast<double>(c.model),
                static_cast<double>(c.width),
                static_cast<double>(c.height),
                c.fl_x,
                c.fl_y,
                c.cx,
                c.cy,
                c.skew,
                c.k1,
                c.k2,
                c.k3,
                c.k4,
                c.p1,
                c.p2};
  std::size_t at = 14;
  for (const Vec3& row : camera.pose.rotation().raw().row)
    for (int i = 0; i < 3; ++i) key[at++] = row[i];
  for (int i = 0; i < 3; ++i) key[at++] = camera.pose.origin().raw()[i];
  return key;
}

// Equal but for the last digits that a program may print differently.
bool sameCamera(const Camera<AcquisitionSpace>& a, const Camera<AcquisitionSpace>& b) {
  const CameraKey x = cameraKey(a), y = cameraKey(b);
  const double distance = 1 + length(a.pose.origin().raw());
  for (std::size_t i = 0; i < x.size(); ++i)
    if (std::fabs(x[i] - y[i]) > 1e-6 * (i < 23 ? 1 + std::fabs(x[i]) : distance)) return false;
  return true;
}

class Reader {
 public:
  Reader(const fs::path& file, JsonNode root) : folder_(file.parent_path()), root_(std::move(root)) {}

  Capture read() {
    root_.onlyKeys({SRF_LENS_KEYS, "camera_angle_x", "camera_angle_y", "is_fisheye", "aabb", "units", "color_space",
                    "applied_transform", "lights", "frames", SRF_FOREIGN_TOP_KEYS});
    capture_.folder = folder_;
    if (const auto units = root_.find("units")) capture_.units = units->string();
    if (const auto space = root_.find("color_space"))
      capture_.integer_transfer = space->choice({"srgb", "lin_rec709"}) == 0 ? Transfer::srgb : Transfer::linear;
    if (const auto box = root_.find("aabb")) readBounds(*box);
    if (const auto applied = root_.find("applied_transform")) readAppliedTransform(*applied);
    if (const auto lights = root_.find("lights")) readLights(*lights);
    const JsonNode frames = root_["frames"];
    if (frames.size() == 0) throw frames.error("is empty, expected at least one frame");
    for (std::size_t i = 0; i < frames.size(); ++i)
      if (frames.at(i)
              .onlyKeys({SRF_LENS_KEYS, "camera_angle_x", "camera_angle_y", "is_fisheye", "file_path", "mask_path",
                         "view", "light", "pl_pos", "pl_intensity", "transform_matrix", SRF_FOREIGN_FRAME_KEYS})
              .has("pl_pos"))
        has_lights_ = true;
    if (!has_lights_) {
      capture_.lights.push_back({.name = "captured", .kind = LightKind::captured});
      used_.push_back(false);
    }
    for (std::size_t i = 0; i < frames.size(); ++i) readFrame(frames.at(i));
    for (std::size_t i = 0; i < used_.size(); ++i)
      if (!used_[i])
        throw root_["lights"].at(i).error("light '" + capture_.lights[i].name +
                                          "' has no frames; add its photographs or remove it");
    return std::move(capture_);
  }

 private:
  void readBounds(const JsonNode& node) {
    if (node.size() != 2) throw node.error("expected [[min x, y, z], [max x, y, z]]");
    Box<AcquisitionSpace> box{node.at(0).vec3(), node.at(1).vec3()};
    if (!(minComponent(box.max - box.min) > 0)) throw node.error("has a min that is not below max on every axis");
    capture_.bounds = box;
  }

  void readAppliedTransform(const JsonNode& node) {
    if (node.size() != 3 && node.size() != 4) throw node.error("expected the three or four rows of a matrix");
    std::array<double, 12> m{};
    for (std::size_t i = 0; i < 3; ++i) {
      const auto row = node.at(i).numbers(4);
      std::copy(row.begin(), row.end(), m.begin() + static_cast<std::ptrdiff_t>(4 * i));
    }
    capture_.applied_transform = m;
  }

  void readLights(const JsonNode& node) {
    for (std::size_t i = 0; i < node.size(); ++i) {
      const CaptureLight light = readLight(node.at(i));
      if (light.kind == LightKind::captured)
        throw node.at(i)["type"].error("captured is what a capture without lights has; expected directional or point");
      if (!light_by_name_.emplace(light.name, i).second)
        throw node.at(i)["name"].error("'" + light.name + "' is there twice; give each light its own name");
      capture_.lights.push_back(light);
      used_.push_back(false);
    }
    has_lights_ = node.size() > 0;
  }

  std::optional<LightId> frameLight(const JsonNode& frame) {
    const auto name = frame.find("light"), position = frame.find("pl_pos");
    if (position) return pointLight(frame, *position);
    if (frame.find("pl_intensity")) throw frame.error("has pl_intensity without pl_pos; add it");
    if (!has_lights_ && !name) return LightId{0};
    if (!name) return std::nullopt;
    const std::string text = name->string();
    const auto found = light_by_name_.find(text);
    if (found != light_by_name_.end()) return LightId{static_cast<std::uint32_t>(found->second)};
    std::vector<std::string> known;
    for (const auto& [word, unused] : light_by_name_) known.push_back(word);
    const std::string near = nearestWord(text, known);
    throw name->error("found '" + text + "', which /lights does not have; " +
                      (near.empty() ? "add it there" : "did you mean '" + near + "'?"));
  }

  // NRHints-style data gives each frame its own point light; frames of equal ones share it.
  LightId pointLight(const JsonNode& frame, const JsonNode& position) {
    if (frame.has("light")) throw position.error("stands beside light; expected one of the two");
    CaptureLight light{.kind = LightKind::point, .position = Point<AcquisitionSpace>(position.vec3())};
    if (const auto node = frame.find("pl_intensity")) {
      const Vec3 v = node->isNumber() ? Vec3{1, 1, 1} * node->number() : node->vec3();
      if (!(minComponent(v) >= 0 && maxComponent(v) > 0)) throw node->error("expected an intensity above 0");
      light.strength = v;
    }
    const Vec3 p = light.position.raw(), s = light.strength;
    const auto [it, is_new] =
        point_lights_.emplace(std::array<double, 6>{p.x, p.y, p.z, s.x, s.y, s.z}, capture_.lights.size());
    if (is_new) {
      for (std::size_t i = point_lights_.size() - 1;; ++i) {
        light.name = "pl" + std::to_string(i);
        if (light_by_name_.emplace(light.name, capture_.lights.size()).second) break;
      }
      capture_.lights.push_back(light);
      used_.push_back(false);
    }
    return LightId{static_cast<std::uint32_t>(it->second)};
  }

  void readFrame(const JsonNode& frame) {
    const JsonNode path = frame["file_path"];
    const Photo photo{photoFile(folder_, path), frameLight(frame), path.where()};
    Camera<AcquisitionSpace> camera;
    camera.pose = readPose(frame["transform_matrix"]);
    camera.lens = readLens({frame, root_}, [&] {
      requireFile(photo.file, photo.place);
      return readImageSize(photo.file);
    });

    const std::size_t index = viewOf(frame, camera, path);
    CaptureView& view = capture_.views[index];
    if (const auto mask = frame.find("mask_path")) {
      const fs::path file = (folder_ / mask->string()).lexically_normal();
      if (!view.mask_file.empty() && view.mask_file != file)
        throw mask->error("is another mask than '" + view.mask_file.string() +
                          "' of the same view; give a view one mask");
      if (view.mask_file.empty()) view.mask_place = mask->where();
      view.mask_file = file;
    }
    if (photo.light) {
      used_[photo.light->value] = true;
      if (!cells_.emplace(index, photo.light->value).second)
        throw frame.error("is a second photograph of view '" + view.name + "' under light '" +
                          capture_.lights[photo.light->value].name + "'; keep one of them" +
                          (has_lights_ ? "" : " (frames of equal pose are one view)"));
    }
    view.photos.push_back(photo);
  }

  std::size_t viewOf(const JsonNode& frame, const Camera<AcquisitionSpace>& camera, const JsonNode& path) {
    const auto name = frame.find("view");
    if (name) {
      const std::string text = name->string();
      if (text.empty()) throw name->error("is empty, expected a name");
      const auto [it, is_new] = view_by_name_.emplace(text, capture_.views.size());
      if (is_new)
        capture_.views.push_back({.name = text, .camera = camera});
      else if (!sameCamera(camera, capture_.views[it->second].camera))
        throw frame.error("has another pose or lens than the frames of view '" + text +
                          "' before it; mend it or name another view");
      return it->second;
    }
    const auto [it, is_new] = view_by_camera_.emplace(cameraKey(camera), capture_.views.size());
    if (is_new) {
      const std::string stem = fs::path(path.string()).lexically_normal().replace_extension().generic_string();
      std::string unique = stem;
      for (int i = 2; !view_by_name_.emplace(unique, capture_.views.size()).second; ++i)
        unique = stem + " " + std::to_string(i);
      capture_.views.push_back({.name = unique, .camera = camera});
    }
    return it->second;
  }

  fs::path folder_;
  JsonNode root_;
  Capture capture_;
  bool has_lights_ = false;
  std::vector<bool> used_;
  std::map<std::string, std::size_t> light_by_name_, view_by_name_;
  std::map<std::array<double, 6>, std::size_t> point_lights_;
  std::map<CameraKey, std::size_t> view_by_camera_;
  std::set<std::pair<std::size_t, std::uint32_t>> cells_;
};

}  // namespace

Capture readCapture(const fs::path& folder_or_file) {
  const fs::path file = fs::is_directory(folder_or_file) ? folder_or_file / "transforms.json" : folder_or_file;
  return Reader(file, readJsonFile(file)).read();
}

void requireFiles(const CaptureView& view) {
  for (const Photo& photo : view.photos) requireFile(photo.file, photo.place);
  if (!view.mask_file.empty()) requireFile(view.mask_file, view.mask_place);
}

void writeCapture(const fs::path& folder, const Capture& capture) {
  const auto relative = [&](const fs::path& file) {
    const fs::path path =
        fs::absolute(file).lexically_normal().lexically_relative(fs::absolute(folder).lexically_normal());
    return (path.empty() ? fs::absolute(file) : path).generic_string();
  };
  Json root;
  const bool one_lens = std::all_of(capture.views.begin(), capture.views.end(), [&](const CaptureView& v) {
    return v.camera.lens == capture.views.front().camera.lens;
  });
  if (one_lens && !capture.views.empty()) writeLens(root, capture.views.front().camera.lens);
  root["units"] = capture.units;
  root["color_space"] = capture.integer_transfer == Transfer::srgb ? "srgb" : "lin_rec709";
  if (capture.bounds) root["aabb"] = {vec3Json(capture.bounds->min), vec3Json(capture.bounds->max)};
  if (const auto& m = capture.applied_transform) {
    root["applied_transform"] = Json::array();
    for (std::size_t i = 0; i < 12; i += 4)
      root["applied_transform"].push_back({(*m)[i], (*m)[i + 1], (*m)[i + 2], (*m)[i + 3]});
  }
  if (!capture.unknownIllumination())
    for (const CaptureLight& light : capture.lights) root["lights"].push_back(lightJson(light));
  root["frames"] = Json::array();
  for (const CaptureView& view : capture.views)
    for (const Photo& photo : view.photos) {
      Json frame;
      frame["file_path"] = relative(photo.file);
      if (!view.mask_file.empty()) frame["mask_path"] = relative(view.mask_file);
      frame["view"] = view.name;
      if (photo.light && !capture.unknownIllumination()) frame["light"] = capture.lights[photo.light->value].name;
      if (!one_lens) writeLens(frame, view.camera.lens);
      frame["transform_matrix"] = poseJson(view.camera.pose);
      root["frames"].push_back(std::move(frame));
    }
  writeJsonFile(folder / "transforms.json", root);
}

}  // namespace srf
