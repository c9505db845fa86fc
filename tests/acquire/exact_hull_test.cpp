#include "acquire/exact_hull.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <memory>

#include "acquire/camera_import.h"
#include "acquire/silhouette.h"
#include "acquire/silhouette_contours.h"
#include "acquire/surface_distance.h"
#include "base/error.h"
#include "base/numeric.h"
#include "tests/support/test_support.h"

namespace srf {
namespace {

using Space = AcquisitionSpace;
using Point3 = Point<Space>;

Camera<Space> orthographic(const Vec3& from, int pixels, double pixels_per_unit) {
  Camera<Space> camera;
  camera.lens.model = CameraModel::orthographic;
  camera.lens.width = camera.lens.height = pixels;
  camera.lens.fl_x = camera.lens.fl_y = pixels_per_unit;
  camera.lens.cx = camera.lens.cy = 0.5 * pixels;
  camera.pose = *lookAt<Space>(
      Point3(from), Point3(),
      Vector<Space>(0.001, 0.002, from.x * from.x > 1 ? 1 : 0) + Vector<Space>(0, from.x * from.x > 1 ? 0 : 1, 0));
  return camera;
}

std::vector<Vec2> square(double center, double half) {
  return {{center - half, center - half},
          {center + half, center - half},
          {center + half, center + half},
          {center - half, center + half}};
}

Box<Space> cube(double half) {
  return {{-half, -half, -half}, {half, half, half}};
}

SilhouettePolygons view(const std::string& name, const Camera<Space>& camera, std::vector<std::vector<Vec2>> loops) {
  return {name, camera, std::move(loops), false};
}

void expectClosed(const AcquisitionMesh& mesh, int components, long euler) {
  const MeshTopology topology = meshTopology(mesh);
  EXPECT_TRUE(topology.closed && topology.manifold && topology.oriented);
  EXPECT_EQ(topology.components, components);
  EXPECT_EQ(topology.euler_characteristic, euler);
}

// An outline with waves, of a perspective camera from all sides.
SilhouettePolygons wavyOutline(int i, int count, int vertices) {
  const double z = 1 - (2.0 * i + 1) / count, r = std::sqrt(1 - z * z), phi = kPi * (1 + std::sqrt(5.0)) * (i + 0.5);
  SilhouettePolygons out;
  out.name = "v" + std::to_string(i);
  out.camera.lens = pinholeFromFov(256, 256, 30);
  out.camera.pose =
      *lookAt<Space>(Point3(5 * r * std::cos(phi), 5 * r * std::sin(phi), 5 * z), Point3(), Vector<Space>(0, 0, 1));
  out.loops.emplace_back();
  for (int k = 0; k < vertices; ++k) {
    const double a = 2 * kPi * k / vertices, radius = 88 + 5 * std::sin(3 * a + i);
    out.loops[0].push_back({128 + radius * std::cos(a), 128 + radius * std::sin(a)});
  }
  return out;
}

TEST(SilhouetteContours, ARingHasTwoLoopsAndComesBackAsItsCoverage) {
  Image8 mask(64, 48, 1);
  for (int y = 0; y < 48; ++y)
    for (int x = 0; x < 64; ++x) {
      const double d = std::hypot(x + 0.5 - 32, y + 0.5 - 24);
      mask.at(x, y) = static_cast<std::uint8_t>(255 * std::clamp(std::min(18.5 - d, d - 7.5), 0.0, 1.0));
    }
  const auto loops = silhouetteContours(mask);
  ASSERT_EQ(loops.size(), 2u);
  for (const auto& loop : loops)
    for (const Vec2& p : loop) {
      const double d = std::hypot(p.x - 32, p.y - 24);
      EXPECT_LT(std::min(std::fabs(d - 18), std::fabs(d - 8)), 0.1);
    }
  const Image8 back = coverageOf(loops, 64, 48);
  for (std::size_t i = 0; i < mask.data().size(); ++i) ASSERT_NEAR(back.data()[i], mask.data()[i], 40);
}

TEST(SilhouetteContours, PixelsThatTouchAtACornerAreApart) {
  Image8 mask(8, 8, 1);
  mask.at(2, 2) = mask.at(3, 3) = 255;
  EXPECT_EQ(silhouetteContours(mask).size(), 2u);
}

TEST(SilhouetteContours, AtTheBorderTheContourFollowsThePicture) {
  Image8 mask(10, 10, 1);
  for (int y = 3; y < 7; ++y)
    for (int x = 5; x < 10; ++x) mask.at(x, y) = 255;
  EXPECT_TRUE(reachesBorder(mask));
  const auto loops = silhouetteContours(mask, true);
  ASSERT_EQ(loops.size(), 1u);
  double right = 0, left = 10;
  for (const Vec2& p : loops[0]) right = std::max(right, p.x), left = std::min(left, p.x);
  EXPECT_NEAR(right, 10, 1e-9);
  EXPECT_NEAR(left, 0, 1e-9);
}

TEST(ExactHull, ContoursAreSimplifiedWithinTheirTolerance) {
  SilhouetteView disc{"disc", orthographic({0, 0, 5}, 200, 40), Image8(200, 200, 1)};
  for (int y = 0; y < 200; ++y)
    for (int x = 0; x < 200; ++x)
      disc.mask.at(x, y) =
          static_cast<std::uint8_t>(255 * std::clamp(80 + 6 * std::sin(5 * std::atan2(y - 100., x - 100.)) -
                                                         std::hypot(x + 0.5 - 100, y + 0.5 - 100),
                                                     0.0, 1.0));
  const auto contour = silhouetteContours(disc.mask);
  std::size_t last = contour[0].size();
  for (const double tolerance : {0.25, 1.0, 3.0}) {
    const SilhouettePolygons polygons = silhouettePolygons(disc, tolerance);
    ASSERT_EQ(polygons.loops.size(), 1u);
    EXPECT_LT(polygons.vertexCount(), last);
    last = polygons.vertexCount();
    const auto& loop = polygons.loops[0];
    for (const Vec2& p : contour[0]) {
      double nearest = 1e9;
      for (std::size_t i = 0; i < loop.size(); ++i) {
        const Vec2 &a = loop[i], &b = loop[(i + 1) % loop.size()];
        const double dx = b.x - a.x, dy = b.y - a.y;
        const double t = std::clamp(((p.x - a.x) * dx + (p.y - a.y) * dy) / (dx * dx + dy * dy), 0.0, 1.0);
        nearest = std::min(nearest, std::hypot(p.x - a.x - t * dx, p.y - a.y - t * dy));
      }
      ASSERT_LE(nearest, tolerance + 1e-9);
    }
  }
}

TEST(ExactHull, PrismsMeetInABlockOfTheirExactVolume) {
  const std::vector<SilhouettePolygons> views{view("front", orthographic({0, 0, 5}, 100, 20), {square(50, 20)}),
                                              view("side", orthographic({5, 0, 0}, 100, 20), {square(50, 20)})};
  const AcquisitionMesh mesh = exactHull(views, cube(3), Reporter::silent());
  expectClosed(mesh, 1, 2);
  // Two units a side across; along y both views are turned a little against each other.
  EXPECT_NEAR(meshVolume(mesh), 8, 0.03);
  EXPECT_LE(mesh.positions.size(), 24u) << "vertices within facets are left";
}

TEST(ExactHull, AHoleInASilhouetteGoesThrough) {
  const std::vector<SilhouettePolygons> views{
      view("front", orthographic({0, 0, 5}, 100, 20), {square(50, 20), square(50, 8)}),
      view("side", orthographic({5, 0, 0}, 100, 20), {{{30, 40}, {70, 40}, {70, 60}, {30, 60}}})};
  const AcquisitionMesh mesh = exactHull(views, cube(3), Reporter::silent());
  EXPECT_EQ(meshTopology(mesh).euler_characteristic, 0);
  EXPECT_TRUE(meshTopology(mesh).closed);
}

TEST(ExactHull, WhatACroppedPictureDoesNotShowIsKept) {
  // A bar that leaves the picture to the right: the view cuts what it sees, and nothing beyond its border.
  SilhouetteView close{"close", orthographic({0, 0, 5}, 100, 50), Image8(100, 100, 1)};  // shows 2 x 2 units
  for (int y = 40; y < 60; ++y)
    for (int x = 30; x < 100; ++x) close.mask.at(x, y) = 255;
  const SilhouettePolygons polygons = silhouettePolygons(close, 0.1);
  EXPECT_TRUE(polygons.of_background);
  const AcquisitionMesh mesh = exactHull(std::vector{polygons}, cube(2), Reporter::silent());
  EXPECT_TRUE(meshTopology(mesh).closed);
  // 4 x 4 of the box less the 2 x 2 that are seen, and the bar of 1.4 x 0.4; times 4.
  EXPECT_NEAR(meshVolume(mesh), 4 * (16 - 4 + 1.4 * 0.4), 0.05);
}

TEST(ExactHull, BackgroundTakenAwayLeavesTheSameCornersAsTheObjectKept) {
  std::vector<SilhouettePolygons> object, background;
  for (int i = 0; i < 12; ++i) {
    object.push_back(wavyOutline(i, 12, 24));
    background.push_back(object.back());
    background.back().of_background = true;
    background.back().loops.push_back(square(128, 128));
  }
  // Every point of the box beside the object is seen as background by some view.
  const AcquisitionMesh kept = exactHull(object, cube(1.05), Reporter::silent());
  const AcquisitionMesh left = exactHull(background, cube(1.05), Reporter::silent());
  EXPECT_NEAR(meshVolume(left), meshVolume(kept), 1e-12);
  EXPECT_EQ(left.positions.size(), kept.positions.size()) << "vertices within facets are left";
}

TEST(ExactHull, AgreesWithCarvingOfTheSamePolygons) {
  std::vector<SilhouettePolygons> polygons;
  std::vector<SilhouetteView> masks;
  for (int i = 0; i < 12; ++i) {
    polygons.push_back(wavyOutline(i, 12, 24));
    masks.push_back({polygons[i].name, polygons[i].camera, coverageOf(polygons[i].loops, 256, 256)});
  }
  HullOptions options;
  options.exclude_outliers = false;
  const VisualHull carved = carveVisualHull(masks, options, Reporter::silent());
  const AcquisitionMesh exact = exactHull(polygons, cube(2), Reporter::silent());
  expectClosed(exact, 1, 2);
  auto off = distancesTo(exact, carved.mesh.positions);
  auto back = distancesTo(carved.mesh, pointsOn(exact, 20000));
  std::sort(off.begin(), off.end());
  std::sort(back.begin(), back.end());
  EXPECT_LT(off[off.size() / 2], 0.25 * carved.cell);
  EXPECT_LT(off[off.size() * 95 / 100], 0.25 * carved.cell);
  EXPECT_LT(off.back(), 1.75 * carved.cell);
  EXPECT_LT(back[back.size() * 95 / 100], 0.25 * carved.cell);
  EXPECT_NEAR(meshVolume(exact) / meshVolume(carved.mesh), 1, 0.003);
  // The same bits again: nothing depends on where things lie in memory.
  EXPECT_EQ(exactHull(polygons, cube(2), Reporter::silent()).positions, exact.positions);
}

TEST(ExactHull, AgreesWithCarvingOfPhotographs) {
  SRF_REQUIRE_DATA(data, "middlebury");
  for (const char* name : {"templeSparseRing", "dinoSparseRing"}) {
    SCOPED_TRACE(name);
    const Capture capture = openCapture(data / name, Reporter::silent());
    std::vector<SilhouettePolygons> polygons;
    std::vector<SilhouetteView> masks;
    for (const SilhouetteView& view : silhouettes(capture, {}, Reporter::silent())) {
      polygons.push_back(silhouettePolygons(view, 2));
      masks.push_back({view.name, polygons.back().camera,
                       coverageOf(polygons.back().loops, view.camera.lens.width, view.camera.lens.height)});
      if (polygons.back().of_background)
        for (std::uint8_t& v : masks.back().mask.data()) v = static_cast<std::uint8_t>(255 - v);
    }
    HullOptions options;
    options.exclude_outliers = false;
    options.bounds = capture.bounds;
    const VisualHull carved = carveVisualHull(masks, options, Reporter::silent());
    const AcquisitionMesh exact = exactHull(polygons, *capture.bounds, Reporter::silent());
    const MeshTopology topology = meshTopology(exact);
    EXPECT_TRUE(topology.closed && topology.manifold && topology.oriented);
    // Slits narrower than a cell are not carved: the largest distance holds one way.
    auto off = distancesTo(exact, carved.mesh.positions), back = distancesTo(carved.mesh, pointsOn(exact, 100000));
    std::sort(off.begin(), off.end());
    std::sort(back.begin(), back.end());
    for (const auto& way : {off, back}) {
      EXPECT_LT(way[way.size() / 2], 0.25 * carved.cell);
      EXPECT_LT(way[way.size() * 95 / 100], 0.25 * carved.cell);
    }
    EXPECT_LT(off.back(), 1.75 * carved.cell);
    EXPECT_NEAR(meshVolume(exact) / meshVolume(carved.mesh), 1, 0.002);
  }
}

TEST(ExactHull, TheSameMasksGiveTheSameBits) {
  // Stairs and equal parts: many vertices whose loss costs the same.
  std::vector<SilhouetteView> views;
  for (int i = 0; i < 4; ++i) {
    SilhouettePolygons placed = wavyOutline(i, 4, 8);
    SilhouetteView blocks{placed.name, placed.camera, Image8(256, 256, 1)};
    for (int y = 0; y < 256; ++y)
      for (int x = 0; x < 256; ++x)
        for (int k = 0; k < 5; ++k)
          if (std::hypot(x - 60.0 - 34 * k, y - 128.0) < 15 ||
              (k == 2 && std::abs(x - y) < 9 && std::abs(y - 128) < 80))
            blocks.mask.at(x, y) = 255;
    views.push_back(std::move(blocks));
  }
  const auto polygonsOf = [&] {
    std::vector<SilhouettePolygons> polygons;
    for (const SilhouetteView& v : views) polygons.push_back(silhouettePolygons(v, 2));
    return polygons;
  };
  const auto polygons = polygonsOf();
  const AcquisitionMesh hull = exactHull(polygons, cube(2), Reporter::silent());
  for (unsigned seed = 1; seed <= 4; ++seed) {
    test::scatterHeap(seed);
    const auto again = polygonsOf();
    for (std::size_t i = 0; i < polygons.size(); ++i) EXPECT_EQ(again[i].loops, polygons[i].loops) << seed;
    test::scatterHeap(seed + 100);
    const AcquisitionMesh hull_again = exactHull(polygons, cube(2), Reporter::silent());
    EXPECT_EQ(hull_again.positions, hull.positions) << seed;
    EXPECT_EQ(hull_again.triangles, hull.triangles) << seed;
  }
}

TEST(ExactHull, LensesAreStraightened) {
  std::vector<SilhouetteView> views;
  for (int i = 0; i < 5; ++i) {
    SilhouettePolygons placed = wavyOutline(i, 5, 8);
    placed.camera.lens.model = CameraModel::opencv;
    placed.camera.lens.k1 = -0.3;
    SilhouetteView ball{placed.name, placed.camera, Image8(256, 256, 1)};
    for (int y = 0; y < 256; ++y)
      for (int x = 0; x < 256; ++x) {
        const auto ray = ball.camera.ray({x + 0.5, y + 0.5});
        ball.mask.at(x, y) = ray && length(cross(ray->direction, Point3() - ray->origin)) < 1 ? 255 : 0;
      }
    views.push_back(std::move(ball));
  }
  std::vector<SilhouettePolygons> polygons;
  for (const auto& v : views) polygons.push_back(silhouettePolygons(v, 0.5));
  const AcquisitionMesh mesh = exactHull(polygons, cube(3), Reporter::silent());
  HullOptions options;
  options.exclude_outliers = false;
  EXPECT_NEAR(meshVolume(mesh) / meshVolume(carveVisualHull(views, options, Reporter::silent()).mesh), 1, 0.01);
}

TEST(ExactHull, ViewsThatLeaveNothingAreNamed) {
  const std::vector<SilhouettePolygons> views{
      view("front", orthographic({0, 0, 5}, 100, 20), {square(50, 10)}),
      view("elsewhere", orthographic({5, 0, 0}, 100, 20), {{{0, 0}, {5, 0}, {5, 5}, {0, 5}}})};
  try {
    exactHull(views, cube(3), Reporter::silent());
    FAIL() << "no error";
  } catch (const Error& error) {
    EXPECT_EQ(error.kind(), ErrorKind::bad_input);
    EXPECT_NE(std::string(error.what()).find("elsewhere"), std::string::npos) << error.what();
  }
  EXPECT_THROW(exactHull({}, cube(1), Reporter::silent()), Error);
  EXPECT_THROW(exactHull(views, Box<Space>{}, Reporter::silent()), Error);
  SilhouetteView empty{"empty", orthographic({0, 0, 5}, 20, 4), Image8(20, 20, 1)};
  EXPECT_THROW(silhouettePolygons(empty, 1), Error);
  empty.mask = Image8(20, 20, 1, 255);
  EXPECT_THROW(silhouettePolygons(empty, 1), Error);
}

TEST(ExactHull, RemeshedItIsFitForDeformation) {
  std::vector<SilhouettePolygons> polygons;
  for (int i = 0; i < 8; ++i) polygons.push_back(wavyOutline(i, 8, 20));
  const AcquisitionMesh exact = exactHull(polygons, cube(2), Reporter::silent());
  const double edge = 0.05;
  Reporter reporter(ProgressMode::none, LogLevel::error);
  const AcquisitionMesh mesh = remeshed(exact, edge, reporter);
  expectClosed(mesh, 1, 2);
  EXPECT_EQ(reporter.figures()["remesh.self_intersections"], 0);
  EXPECT_EQ(mesh.normals.size(), mesh.positions.size());
  const auto narrowest = [](const AcquisitionMesh& m) {
    double least = 180;
    for (const Triangle& t : m.triangles)
      for (int k = 0; k < 3; ++k) {
        const auto &a = m.positions[t[k]], &b = m.positions[t[(k + 1) % 3]], &c = m.positions[t[(k + 2) % 3]];
        const double l = length(b - a) * length(c - a);
        least = std::min(least, l > 0 ? degrees(std::atan2(length(cross(b - a, c - a)), dot(b - a, c - a))) : 0);
      }
    return least;
  };
  EXPECT_LT(narrowest(exact), 1);
  EXPECT_GT(narrowest(mesh), 5);
  auto off = distancesTo(exact, mesh.positions), back = distancesTo(mesh, pointsOn(exact, 20000));
  EXPECT_LT(*std::max_element(off.begin(), off.end()), 0.5 * edge);
  EXPECT_LT(*std::max_element(back.begin(), back.end()), edge);
  EXPECT_THROW(remeshed(exact, 0, Reporter::silent()), Error);
}

}  // namespace
}  // namespace srf
