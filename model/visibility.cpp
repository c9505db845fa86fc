#include "model/visibility.h"

#include <limits>

#include "base/parallel.h"
#include "base/ray_scene.h"

namespace srf {
namespace {

// Cosine between normal and viewing direction at which a view is taken to face the point: grazing views sample the
// surface too thinly to be of use, and there the normals of a carved surface decide by chance.
constexpr double kLeastCosine = 0.02;
constexpr std::size_t kChunk = 512;  // points

}  // namespace

VisibilityBits findVisibility(std::span<const Point<AcquisitionSpace>> points,
                              std::span<const Direction<AcquisitionSpace>> normals, const AcquisitionMesh& surface,
                              std::span<const StoredView> views, double least_distance, Reporter& reporter) {
  VisibilityBits visible(points.size(), views.size());
  const auto scene = RayScene<AcquisitionSpace>::ofTriangles(surface.positions, surface.triangles);
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

}  // namespace srf
