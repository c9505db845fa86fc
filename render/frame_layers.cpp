#include "render/frame_layers.h"

#include <algorithm>
#include <cmath>

#include "base/numeric.h"

namespace srf {
namespace {

struct LayerGroup {
  const char* name;
  std::vector<const char*> channels;  ///< of the group "view": made from k
};
const std::vector<LayerGroup>& layerGroups() {
  static const std::vector<LayerGroup> groups{
      {"P", {"P.X", "P.Y", "P.Z"}},
      {"P0", {"P0.X", "P0.Y", "P0.Z"}},
      {"N", {"N.X", "N.Y", "N.Z"}},
      {"L", {"L.X", "L.Y", "L.Z", "L.W"}},
      {"handedness", {"handedness"}},
      {"stretch", {"stretch.max", "stretch.min"}},
      {"shear", {"shear"}},
      {"fallback", {"fallback"}},
      {"overlap", {"overlap"}},
      {"V", {"V.X", "V.Y", "V.Z"}},
      {"Z", {"Z"}},
      {"view", {}},
      {"confidence", {"confidence"}},
      {"light_angle", {"light_angle"}},
      {"extrapolation", {"extrapolation"}},
      {"occlusion", {"occlusion"}},
  };
  return groups;
}

}  // namespace

std::vector<std::string> knownLayers() {
  std::vector<std::string> names;
  for (const LayerGroup& group : layerGroups()) names.emplace_back(group.name);
  return names;
}

Layers::Layers(const std::set<std::string>& groups, int views, int width, int height) : views_(views) {
  const auto add = [&](const std::string& channel, float fill) {
    images_.emplace(channel, ImageF(width, height, 1, fill));
  };
  for (const LayerGroup& group : layerGroups()) {
    if (!groups.contains(group.name)) continue;
    for (const char* channel : group.channels) add(channel, 0);
    if (std::string(group.name) != "view") continue;
    for (int i = 0; i < views; ++i) {
      add("view." + std::to_string(i), -1);
      add("view.weight." + std::to_string(i), 0);
    }
  }
}

void Layers::set(int x, int y, const LayerValues& at) {
  put(x, y, "P", at.hit.p_star.raw());
  put(x, y, "P0", at.look_up.p.raw());
  put(x, y, "N", (at.look_up.acquisition_from_object.inverse() * at.look_up.normal).raw());
  put(x, y, "V", at.view.raw());
  const double sign = determinant(at.look_up.acquisition_from_object) < 0 ? -1 : 1;
  if (images_.contains("L.W")) {
    const Quaternion q = quaternionFromRotation(sign * at.look_up.acquisition_from_object.raw());
    put(x, y, "L", {q.x, q.y, q.z});
    put(x, y, "L.W", q.w);
  }
  put(x, y, "handedness", sign);
  const TangentChange change = tangentChange(at.hit.tangents);
  put(x, y, "stretch.max", change.longest);
  put(x, y, "stretch.min", change.shortest);
  put(x, y, "shear", degrees(change.shear));
  put(x, y, "fallback", at.look_up.collapsed);
  put(x, y, "overlap", at.surfaces);
  put(x, y, "Z", at.hit.distance);
  for (int i = 0; i < std::min<int>(views_, static_cast<int>(at.chosen.size())); ++i) {
    put(x, y, "view." + std::to_string(i), at.chosen[i].view);
    put(x, y, "view.weight." + std::to_string(i), at.chosen[i].weight);
  }
  put(x, y, "confidence", degrees(at.nearest_view));
  if (!at.support) return;
  put(x, y, "light_angle", at.support->light_angle);
  put(x, y, "extrapolation", at.support->view_far ? 1 : at.support->light_far);
  put(x, y, "occlusion", at.support->occluded);
}

void Layers::put(int x, int y, const std::string& channel, double value) {
  const auto image = images_.find(channel);
  if (image != images_.end()) image->second.at(x, y) = std::isfinite(value) ? static_cast<float>(value) : 0.f;
}

void Layers::put(int x, int y, const std::string& group, const Vec3& value) {
  put(x, y, group + ".X", value.x);
  put(x, y, group + ".Y", value.y);
  put(x, y, group + ".Z", value.z);
}

}  // namespace srf
