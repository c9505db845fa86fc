// The layers of a frame (--aovs): what its hits are made from, one image a channel.
#pragma once

#include <map>
#include <set>
#include <string>
#include <vector>

#include "base/image.h"
#include "render/capture_support.h"
#include "render/look_up.h"
#include "render/view_selection.h"

namespace srf {

/// The layers of --aovs by group: "P", "P0", "N", "L", "handedness", "stretch", "shear", "fallback", "overlap", "V",
/// "Z", "view", "confidence", "light_angle", "extrapolation", "occlusion" (doc: conventions, Layers).
std::vector<std::string> knownLayers();

/// What the layers show of one hit.
struct LayerValues {
  const SurfaceHit& hit;
  const LookUp& look_up;
  const Direction<AcquisitionSpace>& view;
  std::span<const ChosenView> chosen;
  double nearest_view;        ///< radians from v to the direction of the nearest acquired view, used or not
  const HitSupport* support;  ///< null where no layer asks for it
  int surfaces;               ///< blended at the hit: overlapping splats, or one triangle
};

/// The layers asked for, one image a channel.
class Layers {
 public:
  /// `groups`: of knownLayers(); `views`: how many views of a hit the group "view" shows.
  Layers(const std::set<std::string>& groups, int views, int width, int height);
  bool wanted() const { return !images_.empty(); }
  /// Different pixels may be set by different threads.
  void set(int x, int y, const LayerValues& at);
  /// Channel name ("P.X", "view.0") to a one-channel image.
  std::map<std::string, ImageF> take() { return std::move(images_); }

 private:
  void put(int x, int y, const std::string& channel, double value);
  void put(int x, int y, const std::string& group, const Vec3& value);

  int views_;
  std::map<std::string, ImageF> images_;
};

}  // namespace srf
