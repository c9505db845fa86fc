// Cameras and lights that stand, and may move, in a glTF file (KHR_lights_punctual). glTF's axes become ours.
#pragma once

#include <memory>
#include <string>
#include <vector>

#include "base/animated.h"
#include "base/camera.h"
#include "base/json.h"
#include "model/gltf_file.h"

namespace srf {

/// {"w", "h", "gltf": {"file", "name", "animation"}}: the lens and pose of a glTF camera. Its field of view is the
/// vertical one; the picture's shape is the scene's own.
class FileCamera {
 public:
  /// `node`: the scene's camera; `folder`: what the file name refers to.
  FileCamera(const JsonNode& node, const std::filesystem::path& folder);
  /// Throws bad_input where the node has no orientation then (a scale of 0).
  Camera<ObjectSpace> at(double seconds) const;
  std::uint64_t contentHash() const { return gltf_->content_hash; }

 private:
  std::shared_ptr<const Gltf> gltf_;
  const GltfAnimation* animation_;
  int node_, width_, height_;
  std::string where_;
};

/// {"type": "gltf", "file", "name", "animation", "scale"}: the light of that name, or all of the file's. glTF's numbers
/// are taken as ours, times `scale`: candela as the radiant intensity of a point light, lux as the irradiance of a
/// directional one. Spots are refused: a cone is none of this program's lights.
class FileLights {
 public:
  FileLights(const JsonNode& node, const std::filesystem::path& folder);
  struct Light {
    bool directional;
    Vec3 place;   ///< object space: position, or unit direction to the light
    Vec3 amount;  ///< intensity, or irradiance
  };
  std::vector<Light> at(double frame, double fps) const;
  std::uint64_t contentHash() const { return gltf_->content_hash; }

 private:
  std::shared_ptr<const Gltf> gltf_;
  const GltfAnimation* animation_;
  std::vector<int> nodes_;
  Animated<double> scale_;
  std::string where_;
};

}  // namespace srf
