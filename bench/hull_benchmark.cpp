// Time of the visual hull: 36 masks of 1024 x 1024 of a bumpy ball at 512 cells, everything from mask to mesh.
#include <cstdio>

#include "acquire/visual_hull.h"
#include "apps/program.h"
#include "base/numeric.h"
#include "base/ray_scene.h"
#include "bench/timing.h"

namespace srf {
namespace {

// A ball whose radius waves: convex and concave parts, about the unit size.
AcquisitionMesh bumpyBall(int rings) {
  AcquisitionMesh mesh;
  const int columns = 2 * rings;
  for (int r = 0; r <= rings; ++r)
    for (int c = 0; c < columns; ++c) {
      const double theta = kPi * r / rings, phi = 2 * kPi * c / columns;
      const double radius = 1 + 0.12 * std::sin(3 * theta) * std::sin(4 * phi) * std::sin(theta);
      mesh.positions.emplace_back(radius * std::sin(theta) * std::cos(phi), radius * std::sin(theta) * std::sin(phi),
                                  radius * std::cos(theta));
    }
  for (int r = 0; r < rings; ++r)
    for (int c = 0; c < columns; ++c) {
      const std::uint32_t a = r * columns + c, b = r * columns + (c + 1) % columns;
      mesh.triangles.push_back({a, a + columns, b});
      mesh.triangles.push_back({b, a + columns, b + columns});
    }
  return mesh;
}

std::vector<SilhouetteView> masks(int count, int size) {
  const AcquisitionMesh ball = bumpyBall(200);
  const auto scene = RayScene<AcquisitionSpace>::ofTriangles(ball.positions, ball.triangles);
  std::vector<SilhouetteView> views;
  for (int i = 0; i < count; ++i) {
    const double z = 1 - (2.0 * i + 1) / count, r = std::sqrt(1 - z * z), phi = kPi * (1 + std::sqrt(5.0)) * (i + 0.5);
    SilhouetteView view;
    view.name = "v" + std::to_string(i);
    view.camera.lens = pinholeFromFov(size, size, 33);
    view.camera.pose = *lookAt(Point<AcquisitionSpace>(4 * r * std::cos(phi), 4 * r * std::sin(phi), 4 * z),
                               Point<AcquisitionSpace>(), Vector<AcquisitionSpace>(0, 0, 1));
    view.mask = Image8(size, size, 1);
    std::vector<Ray<AcquisitionSpace>> rays(size);
    std::vector<TriangleHit> hits(size);
    for (int y = 0; y < size; ++y) {
      for (int x = 0; x < size; ++x) rays[x] = *view.camera.ray({x + 0.5, y + 0.5});
      scene.intersect(rays, hits);
      for (int x = 0; x < size; ++x) view.mask.at(x, y) = hits[x].hit() ? 255 : 0;
    }
    views.push_back(std::move(view));
  }
  return views;
}

}  // namespace
}  // namespace srf

int main(int argc, char** argv) {
  using namespace srf;
  Program program("hull-benchmark", "times the visual hull");
  int repeats = 5, resolution = 512, size = 1024, count = 36;
  program.app().add_option("--repeats", repeats, "timed runs");
  program.app().add_option("--resolution", resolution, "finest cells along the longest side");
  program.app().add_option("--size", size, "pixels along a mask's side");
  program.app().add_option("--views", count, "masks");
  return program.run(argc, argv, [&](Reporter& reporter) {
    const auto views = masks(count, size);
    HullOptions options;
    options.resolution = resolution;
    bench::Series times;
    std::size_t triangles = 0;
    for (int i = 0; i < repeats; ++i)
      times.add(
          bench::milliseconds([&] { triangles = carveVisualHull(views, options, reporter).mesh.triangles.size(); }));
    std::printf("| hull of %d masks of %d x %d at %d cells, %zu triangles | %s ms |\n", count, size, size, resolution,
                triangles, bench::shown(times).c_str());
  });
}
