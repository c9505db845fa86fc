#include "render/gltf_scene.h"

#include <algorithm>

#include "base/numeric.h"
#include "model/gltf_pose.h"

namespace srf {
namespace {

std::string stringOr(const JsonNode& node, const char* key) {
  return node.has(key) ? node[key].string() : "";
}

std::shared_ptr<const Gltf> open(const JsonNode& node, const std::filesystem::path& folder) {
  return std::make_shared<const Gltf>(readGltf(existingFile(node["file"], folder)));
}

}  // namespace

FileCamera::FileCamera(const JsonNode& node, const std::filesystem::path& folder) {
  node.onlyKeys({"w", "h", "gltf"});
  width_ = static_cast<int>(node["w"].integer(1, 65536));
  height_ = static_cast<int>(node["h"].integer(1, 65536));
  const JsonNode source = node["gltf"].onlyKeys({"file", "name", "animation"});
  where_ = source.where();
  gltf_ = open(source, folder);
  node_ = gltf_->cameraNode(stringOr(source, "name"), where_ + "/name");
  animation_ = gltf_->animation(stringOr(source, "animation"), where_ + "/animation");
}

Camera<ObjectSpace> FileCamera::at(double seconds) const {
  const AffineTransform world = poseAt(*gltf_, animation_, seconds).world[static_cast<std::size_t>(node_)];
  const GltfCamera& camera =
      gltf_->cameras[static_cast<std::size_t>(gltf_->nodes[static_cast<std::size_t>(node_)].camera)];
  // It looks along its -z with +y up; what scale its node has is no matter.
  const Point<ObjectSpace> eye(objectFromGltf(world.translation));
  const auto back = normalize(Vector<ObjectSpace>(objectFromGltf(world.linear.column(2))));
  const auto up = normalize(Vector<ObjectSpace>(objectFromGltf(world.linear.column(1))));
  const auto pose = back && up ? lookAt(eye, eye - Vector<ObjectSpace>(*back), Vector<ObjectSpace>(*up)) : std::nullopt;
  if (!pose)
    throw badInput(where_, "the camera's node is flattened at " + std::to_string(seconds) + " s; mend its scale");
  if (camera.perspective) return {pinholeFromFov(width_, height_, degrees(camera.yfov)), *pose};
  Intrinsics lens;
  lens.model = CameraModel::orthographic;
  lens.width = width_, lens.height = height_;
  lens.fl_x = lens.fl_y = height_ / (2 * camera.yfov);
  lens.cx = 0.5 * width_, lens.cy = 0.5 * height_;
  return {lens, *pose};
}

FileLights::FileLights(const JsonNode& node, const std::filesystem::path& folder) {
  node.onlyKeys({"type", "file", "name", "animation", "scale"});
  where_ = node.where();
  gltf_ = open(node, folder);
  const std::string name = stringOr(node, "name");
  animation_ = gltf_->animation(stringOr(node, "animation"), where_ + "/animation");
  scale_ = readAnimatedScale(node, "scale");
  if (!name.empty()) {
    nodes_ = {gltf_->lightNode(name, where_ + "/name")};
  } else {
    for (std::size_t i = 0; i < gltf_->nodes.size(); ++i)
      if (gltf_->nodes[i].light >= 0) nodes_.push_back(static_cast<int>(i));
    if (nodes_.empty()) throw node["file"].error("the glTF has no light; expected KHR_lights_punctual");
  }
  for (const int i : nodes_) {
    const GltfNode& holder = gltf_->nodes[static_cast<std::size_t>(i)];
    const GltfLight& light = gltf_->lights[static_cast<std::size_t>(holder.light)];
    if (light.type != "point" && light.type != "directional")
      throw badInput(where_, "the light '" + (light.name.empty() ? holder.name : light.name) + "' is of type '" +
                                 light.type + "', expected point or directional; change it, or name another");
    if (!(light.intensity >= 0 && minComponent(light.colour) >= 0))
      throw badInput(where_, "the light '" + (light.name.empty() ? holder.name : light.name) +
                                 "' has an intensity or a colour below 0; mend the file, or name another");
  }
}

std::vector<FileLights::Light> FileLights::at(double frame, double fps) const {
  const GltfPose pose = poseAt(*gltf_, animation_, frame / fps);
  std::vector<Light> lights;
  for (const int i : nodes_) {
    const AffineTransform& world = pose.world[static_cast<std::size_t>(i)];
    const GltfLight& light = gltf_->lights[static_cast<std::size_t>(gltf_->nodes[static_cast<std::size_t>(i)].light)];
    const Vec3 amount = (light.intensity * std::max(0.0, scale_.at(frame))) * light.colour;
    if (light.type == "point") {
      lights.push_back({false, objectFromGltf(world.translation), amount});
      continue;
    }
    const auto to = normalize(Vector<ObjectSpace>(objectFromGltf(world.linear.column(2))));  // it shines along -z
    if (!to) throw badInput(where_, "a light's node is flattened at frame " + std::to_string(frame));
    lights.push_back({true, to->raw(), amount});
  }
  return lights;
}

}  // namespace srf
