#include "render/level_choice.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace srf {
namespace {

constexpr double kLeastCosine = 1e-3;  // of a slant: beyond it a pixel's footprint says nothing

double reachOf(const Camera<ObjectSpace>& camera, const SurfaceHit& hit) {
  return camera.lens.isOrthographic() ? 1 : hit.distance;
}
double slantOf(const LookUp& look_up, const Direction<AcquisitionSpace>& view) {
  return std::max(std::fabs(dot(look_up.normal, view)), kLeastCosine);
}

}  // namespace

LevelChoice::LevelChoice(std::span<const SourceView> views, const Box<AcquisitionSpace>& bounds, double texels)
    : views_(views), texels_(texels) {
  if (!(texels_ > 0)) return;
  for (const SourceView& view : views) {
    if (!view.coverage) continue;
    const Intrinsics& lens = view.camera.lens;
    double density = lens.fl_x * lens.fl_y;
    if (!lens.isOrthographic()) {
      const Vec3 eye = view.camera.pose.origin().raw();
      double squared = 0;  // distance to the box
      for (int k = 0; k < 3; ++k) {
        const double beside = std::max({bounds.min[k] - eye[k], eye[k] - bounds.max[k], 0.0});
        squared += beside * beside;
      }
      density = squared > 0 ? density / squared : std::numeric_limits<double>::infinity();
    }
    densest_ = std::max(densest_, density);
  }
}

bool LevelChoice::mayApply(const Camera<ObjectSpace>& camera, double samples_per_pixel, const SurfaceHit& hit,
                           const LookUp& look_up, const Direction<AcquisitionSpace>& view) const {
  if (!(texels_ > 0)) return false;
  const double reach = reachOf(camera, hit), slant = slantOf(look_up, view);
  const Vec3 &u = hit.tangents.u.raw(), &v = hit.tangents.v.raw();
  const Vec3 n{u.y * v.z - u.z * v.y, u.z * v.x - u.x * v.z, u.x * v.y - u.y * v.x};
  const double most = reach * reach * densest_,
               least = texels_ * texels_ * camera.lens.fl_x * camera.lens.fl_y * samples_per_pixel * slant;
  return !(most * most < 0.99 * least * least * dot(n, n));
}

void LevelChoice::apply(const Camera<ObjectSpace>& camera, double samples_per_pixel, const SurfaceHit& hit,
                        const LookUp& look_up, const Direction<AcquisitionSpace>& view,
                        std::span<ChosenView> chosen) const {
  if (!mayApply(camera, samples_per_pixel, hit, look_up, view)) return;
  const double reach = reachOf(camera, hit), slant = slantOf(look_up, view);
  const double stretch = length(cross(hit.tangents.u, hit.tangents.v).raw());
  // Area of the surface at rest that the sample shows.
  const double area = reach * reach / (camera.lens.fl_x * camera.lens.fl_y * samples_per_pixel * slant * stretch);
  if (!(area * densest_ >= texels_ * texels_) || !std::isfinite(area)) return;
  for (ChosenView& c : chosen) {
    const SourceView& source = views_[c.view];
    const Camera<AcquisitionSpace>& photo = source.camera;
    const double far = photo.lens.isOrthographic() ? 1 : distance(photo.center(), look_up.p);
    const double cosine = std::max(dot(look_up.normal, photo.viewDirection(look_up.p)), kLeastCosine);
    const double across = std::sqrt(area * cosine * photo.lens.fl_x * photo.lens.fl_y) / far;
    if (!(across >= texels_)) continue;
    const auto at = photo.project(look_up.p);
    if (!at) continue;
    int level = std::min(1 + static_cast<int>(std::min(std::log2(across / texels_), 30.0)), source.geometry.levels - 1);
    for (; level > 0; --level) {
      const Fetch fetch = bilinearFetch(source, at->pixel, level);
      if (fetch.covered < c.fetch.covered) continue;
      c.fetch = fetch;
      break;
    }
  }
}

}  // namespace srf
