#include "model/captured_visibility.h"

#include <algorithm>
#include <array>
#include <bit>
#include <limits>

#include "base/numeric.h"
#include "base/parallel.h"
#include "base/ray_scene.h"

namespace srf {
namespace {

constexpr std::size_t kChunk = 512;          // points: rays of a packet run to the same light
constexpr double kAroundPixels = 1.7;        // capture pixels to the four points around
constexpr double kBeforePointLight = 0.999;  // of the distance to a point light, where a ray ends

// Rays from many points to one light or camera, kept until they are worth a call.
class RayBatch {
 public:
  explicit RayBatch(const RayScene<AcquisitionSpace>& scene) : scene_(scene) {}
  void add(std::size_t point, const Point<AcquisitionSpace>& from, const Direction<AcquisitionSpace>& direction,
           double far_distance) {
    points_.push_back(point);
    rays_.push_back({from, direction});
    far_.push_back(far_distance);
  }
  template <class Blocked>
  void cast(const Blocked& blocked) {
    blocked_.assign(rays_.size(), 0);
    scene_.occluded(rays_, far_, 0, blocked_);
    for (std::size_t k = 0; k < rays_.size(); ++k)
      if (blocked_[k]) blocked(points_[k]);
    points_.clear(), rays_.clear(), far_.clear();
  }

 private:
  const RayScene<AcquisitionSpace>& scene_;
  std::vector<std::size_t> points_;
  std::vector<Ray<AcquisitionSpace>> rays_;
  std::vector<double> far_;
  std::vector<std::uint8_t> blocked_;
};

}  // namespace

double aroundReach(const SrfManifest& field, const DeformableModel& model) {
  std::vector<double> sizes;
  const Point<AcquisitionSpace> center = model.bounds().center();
  for (const StoredView& view : field.views)
    if (const auto at = view.camera.project(center)) sizes.push_back(view.camera.pixelFootprint(at->depth));
  if (sizes.empty()) return 0;
  const auto middle = sizes.begin() + static_cast<std::ptrdiff_t>(sizes.size() / 2);
  std::nth_element(sizes.begin(), middle, sizes.end());
  return kAroundPixels * *middle;
}

double shadowRayOffset(const DeformableModel& model) {
  constexpr double kLeast = 1.5e-3;  // of the diameter
  return model.positional_error + kLeast * model.bounds().diameter();
}

CapturedVisibility castCapturedVisibility(const SrfManifest& field, const DeformableModel& model,
                                          std::span<const Direction<AcquisitionSpace>> normals, Reporter& reporter) {
  const std::size_t points = model.size();
  CapturedVisibility found{
      VisibilityBits(points, field.lights.size()), {}, VisibilityBits(points, field.lights.size()), model.visible};
  const AcquisitionMesh surface = model.restMesh();
  const auto scene = RayScene<AcquisitionSpace>::ofTriangles(surface.positions, surface.triangles);
  const double offset = shadowRayOffset(model), reach = aroundReach(field, model);
  VisibilityBits lights_of_view(field.views.size(), field.lights.size());
  for (std::size_t v = 0; v < field.views.size(); ++v)
    for (const LightId light : field.views[v].lights)
      if (field.lights[light.value].kind != LightKind::captured) lights_of_view.set(v, light.value);

  Reporter::Stage stage(reporter, "fit: shadow rays", points);
  parallelFor(points, kChunk, [&](std::size_t begin, std::size_t end) {
    RayBatch rays(scene);
    std::vector<Point<AcquisitionSpace>> above;
    std::vector<std::array<Point<AcquisitionSpace>, 4>> around;
    VisibilityBits asked(end - begin, field.lights.size());
    for (std::size_t i = begin; i < end; ++i) {
      const Vector<AcquisitionSpace> up = offset * normals[i];
      above.push_back(model.p0[i] + up);
      const Direction<AcquisitionSpace> u = anyPerpendicular(normals[i]);
      const Vector<AcquisitionSpace> v = cross(normals[i], u);
      std::array<Point<AcquisitionSpace>, 4> corners{above.back(), above.back(), above.back(), above.back()};
      for (int k = 0; k < 4 && reach > 0; ++k) {
        const Vector<AcquisitionSpace> aside =
            (k % 2 == 0 ? reach : -reach) * (k < 2 ? Vector<AcquisitionSpace>(u) : v);
        // Onto the surface, where it is near: a bent one leaves its tangent plane.
        const Ray<AcquisitionSpace> down{model.p0[i] + aside + reach * normals[i], -normals[i]};
        const TriangleHit hit = scene.intersect(down);
        const bool near = hit.hit() && hit.distance < 2 * reach;
        corners[k] = (near ? down.origin + double{hit.distance} * down.direction : model.p0[i] + aside) + up;
      }
      around.push_back(corners);
      for (std::size_t view = 0; view < field.views.size(); ++view)
        if (model.visible.get(i, view))
          for (std::size_t w = 0; w < asked.wordsPerPoint(); ++w)
            asked.words()[(i - begin) * asked.wordsPerPoint() + w] |= lights_of_view.row(view)[w];
    }

    // Only this range's rows are touched here, so no two threads share a word.
    const auto clear = [](VisibilityBits& bits, std::size_t point, std::size_t column) {
      bits.words()[point * bits.wordsPerPoint() + column / 64] &= ~(std::uint64_t{1} << (column % 64));
    };
    for (std::size_t light = 0; light < field.lights.size(); ++light) {
      const CaptureLight& l = field.lights[light];
      const auto add = [&](std::size_t i, const Point<AcquisitionSpace>& from) {
        const double far_distance = l.kind == LightKind::point ? kBeforePointLight * distance(from, l.position)
                                                               : std::numeric_limits<double>::infinity();
        rays.add(i, from, l.directionFrom(from), far_distance);
      };
      for (std::size_t i = begin; i < end; ++i) {
        if (!asked.get(i - begin, light) || !(dot(normals[i], l.directionFrom(model.p0[i])) > 0)) continue;
        found.lit.set(i, light);
        add(i, above[i - begin]);
      }
      rays.cast([&](std::size_t i) { clear(found.lit, i, light); });
      for (std::size_t i = begin; i < end; ++i) {
        if (!found.lit.get(i, light)) continue;
        found.lit_around.set(i, light);
        for (const auto& corner : around[i - begin]) add(i, corner);
      }
      rays.cast([&](std::size_t i) { clear(found.lit_around, i, light); });
    }
    for (std::size_t view = 0; view < field.views.size(); ++view) {
      const Camera<AcquisitionSpace>& camera = field.views[view].camera;
      for (std::size_t i = begin; i < end; ++i)
        if (model.visible.get(i, view))
          for (const auto& corner : around[i - begin])
            rays.add(i, corner, camera.viewDirection(corner),
                     camera.lens.isOrthographic() ? std::numeric_limits<double>::infinity()
                                                  : distance(camera.center(), corner));
      rays.cast([&](std::size_t i) { clear(found.seen_around, i, view); });
    }
    stage.advance(end - begin);
  });
  found.lit_by_rays = found.lit;
  return found;
}

}  // namespace srf
