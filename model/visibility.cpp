#include "model/visibility.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "base/parallel.h"

namespace srf {
namespace {

// Cosine between normal and viewing direction at which a view is taken to face the point: grazing views sample the
// surface too thinly to be of use, and there the normals of a carved surface decide by chance.
constexpr double kLeastCosine = 0.02;
constexpr std::size_t kChunk = 512;  // points
// Pixels by which what a texel shows may lie off the point's tangent plane.
constexpr double kOffPlane = 3;
// Pixels beyond the texels that are looked at besides: a hit lies between points.
constexpr double kMargin = 0.5;
// Cosine at which a view without strange texels faces a point well enough to do without those that have some.
constexpr double kFacing = 0.25;

// Which of `seen` lie in `view` among texels that show another part of the surface.
void findMixed(const RayScene<AcquisitionSpace>& scene, const Camera<AcquisitionSpace>& camera,
               std::span<const std::size_t> seen, std::span<const Point<AcquisitionSpace>> points,
               std::span<const Direction<AcquisitionSpace>> normals, double least_distance,
               std::vector<std::uint8_t>& mixed) {
  std::vector<Ray<AcquisitionSpace>> rays;
  std::vector<std::size_t> of;
  std::vector<double> allowed(seen.size());
  for (std::size_t k = 0; k < seen.size(); ++k) {
    const auto projected = camera.project(points[seen[k]]);
    allowed[k] = kOffPlane * camera.pixelFootprint(projected->depth) + least_distance;
    // The corners of the square that the four texels of a look-up fill, and a little more: an outline that passes
    // through it leaves one of them outside.
    const double left = std::floor(projected->pixel.x - 0.5) - kMargin, right = left + 2 + 2 * kMargin;
    const double top = std::floor(projected->pixel.y - 0.5) - kMargin, bottom = top + 2 + 2 * kMargin;
    for (const Vec2 corner : {Vec2{left, top}, {right, top}, {left, bottom}, {right, bottom}})
      if (const auto ray = camera.ray(corner)) rays.push_back(*ray), of.push_back(k);
  }
  std::vector<TriangleHit> hits(rays.size());
  scene.intersect(rays, hits);
  mixed.assign(seen.size(), 0);
  for (std::size_t r = 0; r < rays.size(); ++r) {
    if (!hits[r].hit()) continue;  // beyond the silhouette: the coverage's business
    const std::size_t point = seen[of[r]];
    const auto met = rays[r].origin + double{hits[r].distance} * rays[r].direction;
    if (std::fabs(dot(normals[point], met - points[point])) > allowed[of[r]]) mixed[of[r]] = 1;
  }
}

}  // namespace

VisibilityBits findVisibility(std::span<const Point<AcquisitionSpace>> points,
                              std::span<const Direction<AcquisitionSpace>> normals,
                              const RayScene<AcquisitionSpace>& scene, std::span<const StoredView> views,
                              double least_distance, Reporter& reporter) {
  VisibilityBits visible(points.size(), views.size());
  Reporter::Stage stage(reporter, "visibility", points.size());
  parallelFor(points.size(), kChunk, [&](std::size_t begin, std::size_t end) {
    std::vector<std::size_t> asked;
    std::vector<Ray<AcquisitionSpace>> rays;
    std::vector<double> far_distances;
    std::vector<std::uint8_t> blocked;
    // View by view, so that the rays of a packet run to the same camera.
    for (std::size_t view = 0; view < views.size(); ++view) {
      const Camera<AcquisitionSpace>& camera = views[view].camera;
      asked.clear(), rays.clear(), far_distances.clear();
      for (std::size_t i = begin; i < end; ++i) {
        const auto direction = camera.viewDirection(points[i]);
        if (!(dot(normals[i], direction) > kLeastCosine)) continue;
        const auto seen = camera.project(points[i]);
        if (!seen || !camera.lens.inside(seen->pixel)) continue;
        asked.push_back(i);
        rays.push_back({points[i], direction});
        // An orthographic camera lies as far away as one likes.
        far_distances.push_back(camera.lens.isOrthographic() ? std::numeric_limits<double>::infinity()
                                                             : distance(camera.center(), points[i]));
      }
      if (asked.empty()) continue;
      blocked.assign(asked.size(), 0);
      scene.occluded(rays, far_distances, least_distance, blocked);
      for (std::size_t k = 0; k < asked.size(); ++k)
        if (!blocked[k]) visible.set(asked[k], view);
    }
    stage.advance(end - begin);
  });
  return visible;
}

VisibilityBits withoutMixedTexels(const VisibilityBits& visible, std::span<const Point<AcquisitionSpace>> points,
                                  std::span<const Direction<AcquisitionSpace>> normals,
                                  const RayScene<AcquisitionSpace>& scene, std::span<const StoredView> views,
                                  double least_distance, Reporter& reporter) {
  VisibilityBits kept(points.size(), views.size());
  Reporter::Stage stage(reporter, "visibility: outlines", points.size());
  parallelFor(points.size(), kChunk, [&](std::size_t begin, std::size_t end) {
    const auto cosine = [&](std::size_t point, std::size_t view) {
      return dot(normals[point], views[view].camera.viewDirection(points[point]));
    };
    std::vector<std::size_t> seen;
    std::vector<std::uint8_t> mixed;
    std::vector<std::pair<std::size_t, std::size_t>> doubtful;  // points and views
    std::vector<double> squarest(end - begin, 0);               // cosine of the views that see a point unmixed
    for (std::size_t view = 0; view < views.size(); ++view) {
      seen.clear();
      for (std::size_t i = begin; i < end; ++i)
        if (visible.get(i, view)) seen.push_back(i);
      if (seen.empty()) continue;
      findMixed(scene, views[view].camera, seen, points, normals, least_distance, mixed);
      for (std::size_t k = 0; k < seen.size(); ++k) {
        if (mixed[k]) {
          doubtful.emplace_back(seen[k], view);
        } else {
          kept.set(seen[k], view);
          double& best = squarest[seen[k] - begin];
          best = std::max(best, cosine(seen[k], view));
        }
      }
    }
    for (const auto& [point, view] : doubtful)
      if (squarest[point - begin] < std::min(kFacing, cosine(point, view))) kept.set(point, view);
    stage.advance(end - begin);
  });
  return kept;
}

}  // namespace srf
