// The exact hull against the carved one of the same polygons: how far they lie apart, and what each takes.
//   exact_hull_benchmark [CAPTURE] [--tolerance PIXELS] [--vertices N] [--views N] [--finer N] [--resolution N]
// Without a capture: 36 outlines of a bumpy ball with 100 vertices each.
#include <cmath>
#include <cstdio>
#include <ctime>

#include "acquire/camera_import.h"
#include "acquire/exact_hull.h"
#include "acquire/silhouette.h"
#include "acquire/silhouette_contours.h"
#include "acquire/surface_distance.h"
#include "apps/program.h"
#include "base/numeric.h"
#include "base/ray_scene.h"
#include "bench/timing.h"

namespace srf {
namespace {

// The outline of a ball with waves on it, as seen from a distance of 5: the largest angle to the centre for each
// direction of the picture.
SilhouettePolygons ballOutline(int view, int views, int vertices, int size) {
  const double z = 1 - (2.0 * view + 1) / views, r = std::sqrt(1 - z * z),
               phi = kPi * (1 + std::sqrt(5.0)) * (view + 0.5);
  SilhouettePolygons out;
  out.name = "v" + std::to_string(view);
  out.camera.lens = pinholeFromFov(size, size, 30);
  out.camera.pose = *lookAt(Point<AcquisitionSpace>(5 * r * std::cos(phi), 5 * r * std::sin(phi), 5 * z),
                            Point<AcquisitionSpace>(), Vector<AcquisitionSpace>(0, 0, 1));
  std::vector<double> furthest(vertices, 0);
  constexpr int kRings = 400;
  for (int i = 1; i < kRings; ++i)
    for (int j = 0; j < 2 * kRings; ++j) {
      const double theta = kPi * i / kRings, a = kPi * j / kRings;
      const double radius = 1 + 0.12 * std::sin(3 * theta) * std::sin(4 * a) * std::sin(theta);
      const auto seen = out.camera.project(Point<AcquisitionSpace>(
          radius * std::sin(theta) * std::cos(a), radius * std::sin(theta) * std::sin(a), radius * std::cos(theta)));
      const double x = seen->pixel.x - 0.5 * size, y = seen->pixel.y - 0.5 * size;
      const int sector = static_cast<int>((std::atan2(y, x) / (2 * kPi) + 1) * vertices) % vertices;
      furthest[sector] = std::max(furthest[sector], std::hypot(x, y));
    }
  std::vector<Vec2> loop;
  for (int k = 0; k < vertices; ++k) {
    const double a = 2 * kPi * (k + 0.5) / vertices;
    loop.push_back({0.5 * size + furthest[k] * std::cos(a), 0.5 * size + furthest[k] * std::sin(a)});
  }
  out.loops.push_back(std::move(loop));
  return out;
}

void printDistances(const char* what, std::vector<double> off, double cell) {
  std::sort(off.begin(), off.end());
  const auto at = [&](double share) {
    return off[static_cast<std::size_t>(share * static_cast<double>(off.size() - 1))] / cell;
  };
  std::printf("%s: median %.3f, 95th percentile %.3f, largest %.3f cells (%zu points)\n", what, at(0.5), at(0.95),
              at(1), off.size());
}

// How narrow a closed mesh or the space about it is at each point: along the normal to the next surface, the nearer of
// inwards (a sheet or an edge) and outwards (a slit).
std::vector<double> narrowestAt(const AcquisitionMesh& mesh, const std::vector<Point<AcquisitionSpace>>& points,
                                const std::vector<std::uint32_t>& triangles) {
  const auto scene = RayScene<AcquisitionSpace>::ofTriangles(mesh.positions, mesh.triangles);
  const double least = 1e-6 * mesh.bounds().diameter();
  std::vector<double> width(points.size(), 0);
  for (std::size_t i = 0; i < points.size(); ++i) {
    const Triangle& t = mesh.triangles[triangles[i]];
    const auto &a = mesh.positions[t[0]], &b = mesh.positions[t[1]], &c = mesh.positions[t[2]];
    const auto normal = normalize(cross(b - a, c - a));
    if (!normal) continue;
    const TriangleHit in = scene.intersect(Ray<AcquisitionSpace>{points[i], -*normal}, least),
                      out = scene.intersect(Ray<AcquisitionSpace>{points[i], *normal}, least);
    width[i] = std::min<double>(in.hit() ? in.distance : 0, out.hit() ? out.distance : INFINITY);
  }
  return width;
}

// What part of the points far from the other surface lie where it is narrow, in cells.
void printNarrowParts(const std::vector<double>& off, const std::vector<double>& width, double cell) {
  for (const double far : {0.25, 1.75}) {
    std::size_t beyond = 0, narrow[3] = {};
    for (std::size_t i = 0; i < off.size(); ++i) {
      if (off[i] <= far * cell) continue;
      ++beyond;
      for (int k = 0; k < 3; ++k) narrow[k] += width[i] < (1 << k) * cell;
    }
    const auto share = [&](std::size_t part, std::size_t whole) {
      return 100.0 * static_cast<double>(part) / static_cast<double>(std::max<std::size_t>(1, whole));
    };
    std::printf(
        "beyond %.2f cells: %.2f %% of the points; of them %.1f, %.1f, %.1f %% where it is narrower than 1, 2, 4 "
        "cells\n",
        far, share(beyond, off.size()), share(narrow[0], beyond), share(narrow[1], beyond), share(narrow[2], beyond));
  }
  std::vector<double> wide;
  for (std::size_t i = 0; i < off.size(); ++i)
    if (width[i] >= 2 * cell) wide.push_back(off[i]);
  printDistances("  where it is at least 2 cells wide", wide, cell);
}

}  // namespace
}  // namespace srf

int main(int argc, char** argv) {
  using namespace srf;
  Program program("exact_hull_benchmark", "Exact and carved hull of the same polygons",
                  "GPL-3.0-or-later (links CGAL)");
  std::string folder;
  double tolerance = 1;
  int vertices = 100, views = 36, finer = 1;
  bool remesh = true;
  HullOptions carving;
  program.app().add_option("CAPTURE", folder, "photographs or masks; default: a bumpy ball");
  program.app().add_option("--tolerance", tolerance, "pixels that contours of a capture are simplified by");
  program.app().add_option("--vertices", vertices, "of each outline of the ball");
  program.app().add_option("--views", views, "outlines of the ball");
  program.app().add_option("--finer", finer, "pixels along a pixel of the masks that are carved, made of the polygons");
  program.app().add_option("--resolution", carving.resolution, "cells of the carved hull; 0: one pixel each");
  program.app().add_flag("--remesh,!--no-remesh", remesh, "also remesh the exact hull at the cell");
  return program.run(argc, argv, [&](Reporter& reporter) {
    std::vector<SilhouettePolygons> polygons;
    if (folder.empty()) {
      for (int i = 0; i < views; ++i) polygons.push_back(ballOutline(i, views, vertices, 512));
    } else {
      const Capture capture = openCapture(folder, reporter);
      for (const SilhouetteView& view : silhouettes(capture, {}, reporter))
        polygons.push_back(silhouettePolygons(view, tolerance));
      carving.bounds = capture.bounds;
    }
    std::size_t sum = 0;
    std::vector<SilhouetteView> masks;
    for (const SilhouettePolygons& p : polygons) {
      sum += p.vertexCount();
      // The polygons on a finer picture.
      Camera<AcquisitionSpace> camera = p.camera;
      Intrinsics& lens = camera.lens;
      lens.width *= finer, lens.height *= finer;
      for (double* x : {&lens.fl_x, &lens.fl_y, &lens.cx, &lens.cy, &lens.skew}) *x *= finer;
      auto loops = p.loops;
      for (auto& loop : loops)
        for (Vec2& q : loop) q = {finer * q.x, finer * q.y};
      Image8 mask = coverageOf(loops, lens.width, lens.height);
      if (p.of_background)
        for (std::uint8_t& v : mask.data()) v = static_cast<std::uint8_t>(255 - v);
      masks.push_back({p.name, camera, std::move(mask)});
    }
    std::printf("%zu views, %.1f vertices each\n", polygons.size(),
                static_cast<double>(sum) / static_cast<double>(polygons.size()));
    carving.exclude_outliers = false;
    VisualHull carved;
    const double carving_ms = bench::milliseconds([&] { carved = carveVisualHull(masks, carving, reporter); });
    std::printf("carved: %.2f s, cell %.5g, %zu triangles, volume %.6g\n", carving_ms / 1e3, carved.cell,
                carved.mesh.triangles.size(), meshVolume(carved.mesh));
    Box<AcquisitionSpace> box = carved.mesh.bounds();
    for (int i = 0; i < 3; ++i) box.min[i] -= 4 * carved.cell, box.max[i] += 4 * carved.cell;
    if (carving.bounds)
      for (int i = 0; i < 3; ++i) {
        box.min[i] = std::max(box.min[i], carving.bounds->min[i]);
        box.max[i] = std::min(box.max[i], carving.bounds->max[i]);
      }
    AcquisitionMesh exact;
    const std::clock_t start = std::clock();
    const double exact_ms = bench::milliseconds([&] { exact = exactHull(polygons, box, reporter); });
    const MeshTopology topology = meshTopology(exact);
    std::printf(
        "exact: %.1f s (%.1f s of one processor), %zu vertices, %zu triangles, volume %.6g, %s, %d components\n",
        exact_ms / 1e3, static_cast<double>(std::clock() - start) / CLOCKS_PER_SEC, exact.positions.size(),
        exact.triangles.size(), meshVolume(exact), topology.closed && topology.manifold ? "closed" : "not closed",
        topology.components);
    printDistances("carved to exact", distancesTo(exact, carved.mesh.positions), carved.cell);
    std::vector<std::uint32_t> triangles;
    const auto points = pointsOn(exact, 200000, &triangles);
    const auto back = distancesTo(carved.mesh, points);
    printDistances("exact to carved", back, carved.cell);
    printNarrowParts(back, narrowestAt(exact, points, triangles), carved.cell);
    printDistances("exact corners to carved", distancesTo(carved.mesh, exact.positions), carved.cell);
    if (!remesh) return;
    const AcquisitionMesh clean = remeshed(exact, carved.cell, reporter);
    printDistances("remeshed to exact", distancesTo(exact, clean.positions), carved.cell);
    std::printf("remeshed: %zu triangles, %g of them cut others\n", clean.triangles.size(),
                reporter.figures().at("remesh.self_intersections"));
  });
}
