#include "acquire/visual_hull.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <functional>
#include <random>

#include "acquire/hull_components.h"
#include "acquire/iso_surface.h"
#include "acquire/signed_silhouette.h"
#include "base/error.h"
#include "base/image_io.h"
#include "base/mesh_io.h"
#include "base/numeric.h"
#include "base/parallel.h"
#include "base/ray_scene.h"
#include "tests/support/hard_case.h"
#include "tests/support/test_support.h"

namespace srf {
namespace {

using Space = AcquisitionSpace;
using Point3 = Point<Space>;
using Vector3 = Vector<Space>;
using CameraAt = Camera<Space>;

// Whether rays meet the object, exactly.
using Object = std::function<void(const std::vector<Ray<Space>>&, std::vector<char>&)>;

Object ball(const Point3& center, double radius) {
  return [=](const std::vector<Ray<Space>>& rays, std::vector<char>& met) {
    met.resize(rays.size());
    for (std::size_t i = 0; i < rays.size(); ++i)
      met[i] = length(cross(rays[i].direction, center - rays[i].origin)) < radius;
  };
}
Object meshObject(const RayScene<Space>& scene) {
  return [&scene](const std::vector<Ray<Space>>& rays, std::vector<char>& met) {
    std::vector<TriangleHit> hits(rays.size());
    scene.intersect(rays, hits);
    met.resize(rays.size());
    for (std::size_t i = 0; i < rays.size(); ++i) met[i] = hits[i].hit();
  };
}

// Coverage by 8 x 8 rays a pixel, where the centres of its neighbours differ.
Image8 photograph(const CameraAt& camera, const Object& object) {
  constexpr int kSamples = 8;
  const int width = camera.lens.width, height = camera.lens.height;
  const auto ask = [&](const Vec2& pixel, std::vector<Ray<Space>>& rays) {
    rays.push_back(camera.ray(pixel).value_or(Ray<Space>{camera.center(), -camera.forward()}));
  };
  std::vector<Ray<Space>> rays;
  std::vector<char> center, met;
  for (int y = 0; y < height; ++y)
    for (int x = 0; x < width; ++x) ask({x + 0.5, y + 0.5}, rays);
  object(rays, center);
  Image8 mask(width, height, 1);
  for (int y = 0; y < height; ++y)
    for (int x = 0; x < width; ++x) {
      bool same = true;
      const char here = center[y * width + x];
      for (int b = std::max(y - 1, 0); b <= std::min(y + 1, height - 1); ++b)
        for (int a = std::max(x - 1, 0); a <= std::min(x + 1, width - 1); ++a) same &= center[b * width + a] == here;
      mask.at(x, y) = here ? 255 : 0;
      if (same) continue;
      rays.clear();
      for (int j = 0; j < kSamples; ++j)
        for (int i = 0; i < kSamples; ++i) ask({x + (i + 0.5) / kSamples, y + (j + 0.5) / kSamples}, rays);
      object(rays, met);
      mask.at(x, y) = static_cast<std::uint8_t>(
          std::lround(255.0 * static_cast<double>(std::count(met.begin(), met.end(), 1)) / (kSamples * kSamples)));
    }
  return mask;
}

// Cameras all over a sphere (a spiral of equal areas) that look at its middle.
std::vector<CameraAt> camerasAround(int count, int pixels, double degrees_wide, double distance_from,
                                    const Point3& middle = {}) {
  std::vector<CameraAt> cameras;
  for (int i = 0; i < count; ++i) {
    const double z = 1 - 2 * (i + 0.5) / count, phi = i * 2.399963229728653, r = std::sqrt(1 - z * z);
    CameraAt camera;
    camera.lens = pinholeFromFov(pixels, pixels, degrees_wide);
    camera.pose = *lookAt<Space>(middle + distance_from * Vector3(r * std::cos(phi), r * std::sin(phi), z), middle,
                                 Vector3(0.01, 0.02, 1));
    cameras.push_back(camera);
  }
  return cameras;
}

std::vector<SilhouetteView> photographs(const std::vector<CameraAt>& cameras, const Object& object) {
  std::vector<SilhouetteView> views(cameras.size());
  parallelFor(cameras.size(), 1, [&](std::size_t i, std::size_t) {
    views[i] = {"view" + std::to_string(i), cameras[i], photograph(cameras[i], object)};
  });
  return views;
}

// Shared by tests: a unit ball from all sides.
const std::vector<SilhouetteView>& ballViews() {
  static const auto views = photographs(camerasAround(36, 128, 30, 5), ball({}, 1));
  return views;
}

void expectClosedSurface(const AcquisitionMesh& mesh, int components, long euler) {
  const MeshTopology topology = meshTopology(mesh);
  EXPECT_TRUE(topology.closed);
  EXPECT_TRUE(topology.manifold);
  EXPECT_TRUE(topology.oriented);
  EXPECT_EQ(topology.components, components);
  EXPECT_EQ(topology.euler_characteristic, euler);
  EXPECT_GT(meshVolume(mesh), 0);
  ASSERT_EQ(mesh.normals.size(), mesh.positions.size());
  for (const Triangle& t : mesh.triangles) {
    const Vector3 area =
        cross(mesh.positions[t[1]] - mesh.positions[t[0]], mesh.positions[t[2]] - mesh.positions[t[0]]);
    ASSERT_GT(length(area), 0) << "a triangle without area";
  }
}

std::string errorOf(const std::vector<SilhouetteView>& views, const HullOptions& options = {}) {
  try {
    carveVisualHull(views, options, Reporter::silent());
  } catch (const Error& error) {
    EXPECT_TRUE(error.kind() == ErrorKind::bad_input || error.kind() == ErrorKind::usage);
    return error.what();
  }
  return "no error";
}

// --- Distances and polygons
// ----------------------------------------------------------------------------------------------

TEST(SignedSilhouette, StraightEdgesOfAnyAngleAreMetWithinSixHundredthsOfAPixel) {
  for (const double angle : {0.0, 0.2, 0.5, kPi / 4, 1.1, 2.0, 3.5, 5.3})
    for (const double offset : {0.0, 0.25, 0.5, 0.7}) {
      const double nx = std::cos(angle), ny = std::sin(angle), c = 32 * (nx + ny) + offset;
      Image8 mask(64, 64, 1);
      for (int y = 0; y < 64; ++y)
        for (int x = 0; x < 64; ++x) {
          int inside = 0;
          for (int j = 0; j < 32; ++j)
            for (int i = 0; i < 32; ++i) inside += nx * (x + (i + 0.5) / 32) + ny * (y + (j + 0.5) / 32) < c;
          mask.at(x, y) = static_cast<std::uint8_t>(std::lround(255.0 * inside / 1024));
        }
      const SignedSilhouette silhouette(mask);
      for (double s = -12; s <= 12; s += 0.37)
        for (const double d : {-6.0, -2.0, -1.0, -0.4, 0.0, 0.3, 1.0, 2.5, 5.0}) {
          const double x = 32 + (offset + d) * nx - s * ny, y = 32 + (offset + d) * ny + s * nx;
          ASSERT_NEAR(silhouette.at(x, y), d, std::fabs(d) < 0.5 ? 0.06 : 0.2) << "angle " << angle << " at " << s;
        }
    }
}

TEST(SignedSilhouette, DistancesGoOnBeyondTheBoxOfTheSilhouette) {
  Image8 mask(200, 100, 1);
  for (int y = 40; y < 60; ++y)
    for (int x = 40; x < 60; ++x) mask.at(x, y) = 255;
  const SignedSilhouette silhouette(mask);
  EXPECT_NEAR(silhouette.at(75, 50), 15, 0.1);
  EXPECT_NEAR(silhouette.at(72, 76), 20, 1.1);   // from the corner (60, 60), which is rounded where masks are hard
  for (const double x : {84.0, 100.0, 150.0}) {  // a lower bound, and not a bad one
    EXPECT_LE(silhouette.at(x, 50), x - 60 + 0.1);
    EXPECT_GE(silhouette.at(x, 50), x - 60 - 2);
  }
  EXPECT_FALSE(silhouette.cropped());
  for (int y = 40; y < 60; ++y) mask.at(199, y) = 255;
  EXPECT_TRUE(SignedSilhouette(mask).cropped());
}

// Every case of a cell, beside every random neighbourhood: the surface of any signs on a lattice is closed and
// manifold.
TEST(IsoSurface, AnySignsGiveAClosedManifoldSurface) {
  std::mt19937 random(1);
  constexpr int kBricks = 3, kCells = kBricks * kBrick;
  for (const double share : {0.1, 0.5, 0.8}) {
    std::vector<char> inside((kCells + 1) * (kCells + 1) * (kCells + 1), 0);
    const auto at = [&](int x, int y, int z) -> char& { return inside[(z * (kCells + 1) + y) * (kCells + 1) + x]; };
    for (int z = 1; z < kCells; ++z)
      for (int y = 1; y < kCells; ++y)
        for (int x = 1; x < kCells; ++x) at(x, y, z) = std::uniform_real_distribution(0.0, 1.0)(random) < share;
    std::vector<IsoBrick> bricks;
    std::vector<Point3> vertices;
    for (std::uint32_t b = 0; b < kBricks * kBricks * kBricks; ++b) {
      IsoBrick brick;
      brick.place = {b % kBricks, b / kBricks % kBricks, b / (kBricks * kBricks)};
      brick.first_vertex = static_cast<std::uint32_t>(vertices.size());
      const int ox = static_cast<int>(brick.place[0]) * kBrick, oy = static_cast<int>(brick.place[1]) * kBrick,
                oz = static_cast<int>(brick.place[2]) * kBrick;
      for (int z = 0; z <= kBrick; ++z)
        for (int y = 0; y <= kBrick; ++y)
          for (int x = 0; x <= kBrick; ++x)
            if (at(ox + x, oy + y, oz + z)) {
              const int corner = brickCorner(x, y, z);
              brick.inside[corner / 64] |= std::uint64_t{1} << (corner % 64);
            }
      for (int axis = 0; axis < 3; ++axis)
        for (int bit = 0; bit < kBrick * kBrick * kBrick; ++bit) {
          const int x = bit % kBrick, y = bit / kBrick % kBrick, z = bit / (kBrick * kBrick);
          if (brick.isInside(brickCorner(x, y, z)) ==
              brick.isInside(brickCorner(x + (axis == 0), y + (axis == 1), z + (axis == 2))))
            continue;
          brick.crossed[axis] |= std::uint64_t{1} << bit;
          Vec3 p{1.0 * ox + x, 1.0 * oy + y, 1.0 * oz + z};
          p[axis] += std::uniform_real_distribution(0.1, 0.9)(random);
          vertices.emplace_back(p);
        }
      bricks.push_back(brick);
    }
    const auto mesh = joinIsoBricks(bricks, vertices);
    ASSERT_TRUE(mesh);
    const MeshTopology topology = meshTopology(*mesh);
    EXPECT_TRUE(topology.closed);
    EXPECT_TRUE(topology.manifold);
    EXPECT_TRUE(topology.oriented);
    EXPECT_GT(meshVolume(*mesh), 0);
    EXPECT_FALSE(joinIsoBricks({bricks.begin(), bricks.end() - 1}, vertices)) << "a missing brick goes unseen";
  }
}

// --- Shapes
// --------------------------------------------------------------------------------------------------------------

TEST(VisualHull, SphereFrom72ViewsKeepsVolumeAndSurface) {
  const Point3 center(0.3, -0.2, 0.1);
  const auto cameras = camerasAround(72, 256, 30, 5, center);
  const auto views = photographs(cameras, ball(center, 1));
  const VisualHull hull = carveVisualHull(views, {}, Reporter::silent());
  expectClosedSurface(hull.mesh, 1, 2);
  EXPECT_NEAR(meshVolume(hull.mesh) / (4 * kPi / 3), 1, 0.002);
  const double footprint = cameras[0].pixelFootprint(5);
  EXPECT_NEAR(hull.cell, footprint, 0.05 * footprint);  // one pixel a cell
  std::vector<double> off, turned;
  for (std::size_t i = 0; i < hull.mesh.positions.size(); ++i) {
    const Vector3 r = hull.mesh.positions[i] - center;
    off.push_back(std::fabs(length(r) - 1));
    turned.push_back(degrees(angleBetween(*normalize(r), hull.mesh.normals[i])));
  }
  // Each vertex is near the sphere, and so dense that the sphere is as near to them.
  EXPECT_LT(*std::max_element(off.begin(), off.end()), 1.5 * footprint);
  std::nth_element(turned.begin(), turned.begin() + turned.size() / 2, turned.end());
  EXPECT_LT(turned[turned.size() / 2], 1.0);
  EXPECT_LT(*std::max_element(turned.begin(), turned.end()), 10);
  for (const ViewConsistency& view : hull.views) {
    EXPECT_GT(view.iou, 0.995);
    EXPECT_GT(view.covered, 0.995);
    EXPECT_FALSE(view.excluded);
  }
}

TEST(VisualHull, TorusHasGenusOne) {
  AcquisitionMesh torus;
  constexpr std::uint32_t n = 160;
  for (std::uint32_t j = 0; j < n; ++j)
    for (std::uint32_t i = 0; i < n; ++i) {
      const double s = 2 * kPi * i / n, t = 2 * kPi * j / n, r = 1 + 0.35 * std::cos(t);
      torus.positions.emplace_back(r * std::cos(s), r * std::sin(s), 0.35 * std::sin(t));
      const std::uint32_t a = j * n + i, b = j * n + (i + 1) % n, c = (j + 1) % n * n + i,
                          d = (j + 1) % n * n + (i + 1) % n;
      torus.triangles.push_back({a, b, d});
      torus.triangles.push_back({a, d, c});
    }
  const auto scene = RayScene<Space>::ofTriangles(torus.positions, torus.triangles);
  const auto views = photographs(camerasAround(36, 160, 36, 5), meshObject(scene));
  const VisualHull hull = carveVisualHull(views, {}, Reporter::silent());
  expectClosedSurface(hull.mesh, 1, 0);
  test::recordHardCase(32, "torus: Euler characteristic of the hull, off by",
                       std::fabs(meshTopology(hull.mesh).euler_characteristic), test::atMost(0));
  // The hole seen through leaves a little of its waist: more than the torus, less than 5 %.
  EXPECT_GT(meshVolume(hull.mesh), meshVolume(torus));
  EXPECT_LT(meshVolume(hull.mesh), 1.05 * meshVolume(torus));
}

TEST(VisualHull, TwoBallsAreTwoComponents) {
  const Object one = ball({-0.7, 0, 0}, 0.5), two = ball({0.6, 0.1, 0.2}, 0.35);
  const Object both = [&](const std::vector<Ray<Space>>& rays, std::vector<char>& met) {
    std::vector<char> more;
    one(rays, met);
    two(rays, more);
    for (std::size_t i = 0; i < met.size(); ++i) met[i] |= more[i];
  };
  const VisualHull hull = carveVisualHull(photographs(camerasAround(36, 128, 30, 5), both), {}, Reporter::silent());
  expectClosedSurface(hull.mesh, 2, 4);
  test::recordHardCase(32, "two balls: components of the hull, off by",
                       std::fabs(static_cast<double>(meshTopology(hull.mesh).components) - 2), test::atMost(0));
}

// An octahedron beside what the mesh holds.
void addOctahedron(AcquisitionMesh& mesh, const Point3& center, double radius) {
  const auto first = static_cast<std::uint32_t>(mesh.positions.size());
  for (const double r : {radius, -radius})
    for (const Vector3& axis : {Vector3(r, 0, 0), Vector3(0, r, 0), Vector3(0, 0, r)})
      mesh.positions.push_back(center + axis);
  for (const Triangle& t :
       {Triangle{0, 1, 2}, {1, 3, 2}, {3, 4, 2}, {4, 0, 2}, {1, 0, 5}, {3, 1, 5}, {4, 3, 5}, {0, 4, 5}})
    mesh.triangles.push_back({first + t[0], first + t[1], first + t[2]});
}

TEST(VisualHull, PiecesThatNoSilhouetteNeedsGo) {
  const auto towards = [](const Vector3& from) {
    CameraAt camera;
    camera.lens = pinholeFromFov(256, 256, 40);
    camera.pose = *lookAt<Space>(Point3{} + from, {}, {0, 0, 1});
    return camera;
  };
  const std::vector<CameraAt> line{towards({6, 0, 0}), towards({-6, 0, 0})};
  std::vector<CameraAt> corner = line;
  corner.push_back(towards({0, 6, 0}));
  AcquisitionMesh mesh;
  addOctahedron(mesh, {}, 1);
  addOctahedron(mesh, {1.5, 0.1, 0}, 0.2);    // before or behind the large one for both cameras of the line
  addOctahedron(mesh, {0, 1.5, 0.1}, 0.2);    // beside it
  addOctahedron(mesh, {0.2, 0, 1.2}, 0.005);  // dust
  const auto componentsLeft = [&](const std::vector<CameraAt>& cameras) {
    AcquisitionMesh left = mesh;
    dropUnneededComponents(left, cameras, Reporter::silent());
    return meshTopology(left).components;
  };
  EXPECT_EQ(componentsLeft(line), 2);
  EXPECT_EQ(componentsLeft(corner), 3);
  EXPECT_EQ(componentsLeft({line[0]}), 3) << "one picture is no reason to take a piece away";
}

TEST(VisualHull, ContainsTheObject) {
  SRF_REQUIRE_DATA(file, "scans/stanford-bunny.obj");
  AcquisitionMesh bunny = readMesh(file);
  cleanMesh(bunny);
  const auto scene = RayScene<Space>::ofTriangles(bunny.positions, bunny.triangles);
  const double size = bunny.bounds().diameter();
  const auto views = photographs(camerasAround(48, 256, 26, 2.5 * size, bunny.bounds().center()), meshObject(scene));
  HullOptions options;
  options.resolution = 128;
  const VisualHull hull = carveVisualHull(views, options, Reporter::silent());
  const MeshTopology topology = meshTopology(hull.mesh);
  EXPECT_TRUE(topology.closed && topology.manifold && topology.oriented);
  // Every vertex of the bunny lies inside the hull or within a cell of it: a ray along its normal from a cell below the
  // surface meets the hull from inside, or leaves through it just there.
  const auto carved = RayScene<Space>::ofTriangles(hull.mesh.positions, hull.mesh.triangles);
  const auto normals = vertexNormals(bunny);
  int outside = 0;
  std::vector<double> gap;
  for (std::size_t i = 0; i < bunny.positions.size(); i += 3) {
    const Ray<Space> ray{bunny.positions[i] - hull.cell * normals[i], normals[i]};
    const TriangleHit hit = carved.intersect(ray);
    if (!hit.hit()) {
      ++outside;
      continue;
    }
    const Triangle& t = hull.mesh.triangles[hit.triangle];
    const Vector3 plane = cross(hull.mesh.positions[t[1]] - hull.mesh.positions[t[0]],
                                hull.mesh.positions[t[2]] - hull.mesh.positions[t[0]]);
    outside += dot(plane, normals[i]) < 0;  // met from outside: the start was not in the hull
    gap.push_back(hit.distance - hull.cell);
  }
  EXPECT_EQ(outside, 0);
  std::sort(gap.begin(), gap.end());
  RecordProperty("median_gap_in_cells", std::to_string(gap[gap.size() / 2] / hull.cell));
  EXPECT_LT(gap[gap.size() / 2], 0.5 * hull.cell);  // concavities remain, yet half of the bunny is met
  double iou = 0;
  for (const auto& view : hull.views) iou += view.iou / static_cast<double>(hull.views.size());
  EXPECT_GT(iou, 0.985);
}

// --- Cameras
// -------------------------------------------------------------------------------------------------------------

TEST(VisualHull, DistortedAndOrthographicCamerasCarveTheSameBall) {
  for (const CameraModel model : {CameraModel::opencv, CameraModel::opencv_fisheye, CameraModel::orthographic}) {
    SCOPED_TRACE(cameraModelName(model));
    auto cameras = camerasAround(30, 80, 36, 4);
    for (CameraAt& camera : cameras) {
      camera.lens.model = model;
      if (model == CameraModel::opencv) camera.lens.k1 = -0.2, camera.lens.p1 = 0.01, camera.lens.skew = 1;
      if (model == CameraModel::opencv_fisheye) camera.lens.k1 = 0.05;
      if (model == CameraModel::orthographic) camera.lens.fl_x = camera.lens.fl_y = 32;
    }
    const VisualHull hull = carveVisualHull(photographs(cameras, ball({}, 1)), {}, Reporter::silent());
    expectClosedSurface(hull.mesh, 1, 2);
    EXPECT_NEAR(meshVolume(hull.mesh) / (4 * kPi / 3), 1, 0.01);
  }
}

TEST(VisualHull, WorksFarFromTheOriginAndAtSmallScale) {
  const Point3 far(1e5, -2e5, 1e5);
  const double scale = 1e-2;
  const auto views = photographs(camerasAround(36, 128, 30, 5 * scale, far), ball(far, scale));
  const VisualHull hull = carveVisualHull(views, {}, Reporter::silent());
  EXPECT_NEAR(meshVolume(hull.mesh) / (4 * kPi / 3 * scale * scale * scale), 1, 0.01);
}

TEST(VisualHull, CroppedViewsSayNothingOfWhatTheyDoNotSee) {
  // Half of the views are close-ups that show a part of the ball; the others see all of it.
  auto cameras = camerasAround(48, 128, 30, 5);
  for (std::size_t i = 0; i < cameras.size(); i += 2) {
    cameras[i].lens.fl_x *= 2.2, cameras[i].lens.fl_y *= 2.2;
    cameras[i].lens.cx += 60;
  }
  const auto views = photographs(cameras, ball({}, 1));
  const VisualHull hull = carveVisualHull(views, {}, Reporter::silent());
  expectClosedSurface(hull.mesh, 1, 2);
  test::recordHardCase(31, "half of the views crop the object: relative error of the hull's volume",
                       std::fabs(meshVolume(hull.mesh) / (4 * kPi / 3) - 1), test::atMost(0.015));
  for (const auto& view : hull.views) EXPECT_FALSE(view.excluded) << view.name << " " << view.iou;
}

TEST(VisualHull, SilhouettesThatDoNotBoundTheObjectAskForBounds) {
  // A ball that every picture cuts above and below, from cameras on the equator.
  std::vector<CameraAt> cameras;
  for (int i = 0; i < 8; ++i) {
    CameraAt camera;
    camera.lens = pinholeFromFov(96, 48, 10);
    const double phi = 0.4 + i * kPi / 4;
    camera.pose = *lookAt<Space>(Point3() + 9.0 * Vector3(std::cos(phi), std::sin(phi), 0), {}, Vector3(0, 0, 1));
    cameras.push_back(camera);
  }
  const auto views = photographs(cameras, ball({}, 1));
  const auto warnings = [&](const std::vector<SilhouetteView>& of, const HullOptions& options) {
    Reporter reporter(ProgressMode::none, LogLevel::error);
    carveVisualHull(of, options, reporter);
    std::string all;
    for (const std::string& line : reporter.warnings()) all += line + "\n";
    return all;
  };
  const std::string told = warnings(views, {});
  EXPECT_NE(told.find("do not bound the object"), std::string::npos) << told;
  EXPECT_NE(told.find("8 of 8 views (view0, view1, view2, ..)"), std::string::npos) << told;
  EXPECT_NE(told.find("--bounds"), std::string::npos) << told;
  HullOptions bounded;
  bounded.bounds.emplace();
  bounded.bounds->extend(Point3(-1.2, -1.2, -1.2));
  bounded.bounds->extend(Point3(1.2, 1.2, 1.2));
  EXPECT_EQ(warnings(views, bounded).find("do not bound"), std::string::npos);
  EXPECT_EQ(warnings(ballViews(), {}).find("do not bound"), std::string::npos);
}

TEST(VisualHull, BoundsCutTheHullAndCloseIt) {
  HullOptions options;
  options.bounds.emplace();
  options.bounds->extend(Point3(-2, -2, -2));
  options.bounds->extend(Point3(2, 2, 0.25));
  const VisualHull hull = carveVisualHull(ballViews(), options, Reporter::silent());
  expectClosedSurface(hull.mesh, 1, 2);
  EXPECT_NEAR(hull.mesh.bounds().max.z, 0.25, 1e-9 + 0.02 * hull.cell);
  const double cut = kPi * 0.75 * 0.75 * (3 - 0.75) / 3;  // the cap above z = 0.25
  EXPECT_NEAR(meshVolume(hull.mesh), 4 * kPi / 3 - cut, 0.03);
}

TEST(VisualHull, ACubeOfBoundsWhoseCornersAreTheLatticesIsClosed) {
  const auto views = photographs(camerasAround(10, 40, 30, 5), ball({}, 1));
  for (const double low : {-1.0, -0.5}) {
    HullOptions options;
    options.bounds.emplace().extend(Point3(low, low, low));
    options.bounds->extend(Point3(low + 1, low + 1, low + 1));
    const auto mesh = carveVisualHull(views, options, Reporter::silent()).mesh;
    EXPECT_TRUE(meshTopology(mesh).closed);
    EXPECT_NEAR(meshVolume(mesh), low == -1 ? kPi / 6 : 1, 0.02);
  }
}

TEST(VisualHull, ResolutionSetsTheCell) {
  HullOptions options;
  for (const int cells : {40, 100}) {
    options.resolution = cells;
    const VisualHull hull = carveVisualHull(ballViews(), options, Reporter::silent());
    // So many cells span the object itself, not some looser box: a few cells of the search for it may be over.
    const Box<Space> box = hull.mesh.bounds();
    const double ratio = hull.cell * cells / maxComponent(box.max - box.min);
    EXPECT_GT(ratio, 1 - 1e-9);
    EXPECT_LT(ratio, 1.05);
    EXPECT_NEAR(meshVolume(hull.mesh) / (4 * kPi / 3), 1, 0.02);
  }
}

TEST(VisualHull, IsTheSameForAnyNumberOfThreads) {
  setThreadCount(1);
  const VisualHull one = carveVisualHull(ballViews(), {}, Reporter::silent());
  setThreadCount(0);
  const VisualHull many = carveVisualHull(ballViews(), {}, Reporter::silent());
  EXPECT_EQ(one.mesh.positions, many.mesh.positions);
  EXPECT_EQ(one.mesh.triangles, many.mesh.triangles);
  EXPECT_EQ(one.mesh.normals, many.mesh.normals);
}

TEST(VisualHull, AThinNeedleIsNotCutOff) {
  // Thinner than the rough cells that look for the object's box.
  const double end = 1.8, radius = 0.012;
  const Object needle = [&](const std::vector<Ray<Space>>& rays, std::vector<char>& met) {
    ball({}, 0.5)(rays, met);
    for (std::size_t i = 0; i < rays.size(); ++i) {
      const Vec3 o = rays[i].origin.raw(), d = rays[i].direction.raw();
      // Where the ray comes nearest to the x axis.
      const double t = -(o.y * d.y + o.z * d.z) / (d.y * d.y + d.z * d.z), x = o.x + t * d.x;
      met[i] |= x > 0 && x < end && std::hypot(o.y + t * d.y, o.z + t * d.z) < radius;
    }
  };
  const auto views = photographs(camerasAround(24, 512, 48, 5), needle);
  const VisualHull hull = carveVisualHull(views, {}, Reporter::silent());
  // A tip 2.8 pixels wide loses some two of them to the masks' blur.
  EXPECT_NEAR(hull.mesh.bounds().max.x, end, 3 * hull.cell);
  EXPECT_EQ(meshTopology(hull.mesh).components, 1);
}

// --- Wrong silhouettes
// -----------------------------------------------------------------------------------------------------

TEST(VisualHull, AWrongMaskIsNamedAndLeftOut) {
  auto views = ballViews();
  views[7].mask = photograph(views[7].camera, ball({0.6, 0.5, 0}, 0.7));
  Reporter reporter(ProgressMode::none, LogLevel::error);
  const VisualHull hull = carveVisualHull(views, {}, reporter);
  EXPECT_TRUE(hull.views[7].excluded);
  EXPECT_EQ(std::count_if(hull.views.begin(), hull.views.end(), [](const auto& v) { return v.excluded; }), 1);
  ASSERT_EQ(reporter.warnings().size(), 1u);
  EXPECT_NE(reporter.warnings()[0].find("view7 "), std::string::npos) << reporter.warnings()[0];
  EXPECT_NE(reporter.warnings()[0].find(" %"), std::string::npos);
  EXPECT_NEAR(meshVolume(hull.mesh) / (4 * kPi / 3), 1, 0.02);

  HullOptions all;  // carved with it, the ball is eaten
  all.exclude_outliers = false;
  EXPECT_LT(meshVolume(carveVisualHull(views, all, Reporter::silent()).mesh), 0.8 * 4 * kPi / 3);
  all.tolerance = 1;  // or overruled at every point
  EXPECT_NEAR(meshVolume(carveVisualHull(views, all, Reporter::silent()).mesh) / (4 * kPi / 3), 1, 0.05);
}

TEST(VisualHull, RightMasksOfFewViewsAreNotAccused) {
  // Where some of few views may be overruled, what they leave bulges; one of them sees the bulges from the side.
  for (const unsigned seed : {3u, 23u, 42u, 76u}) {
    std::mt19937 random(seed);
    std::normal_distribution<double> normal;
    auto cameras = camerasAround(8 + static_cast<int>(seed % 5), 40, 30, 5);
    for (CameraAt& camera : cameras) {
      const Vector3 direction(normal(random), normal(random), normal(random));
      camera.pose =
          *lookAt<Space>(Point3{} + 5 * Vector3(normalize(direction)->raw()), Point3{}, Vector3(0.01, 0.02, 1));
    }
    Reporter reporter(ProgressMode::none, LogLevel::error);
    carveVisualHull(photographs(cameras, ball({}, 1)), {}, reporter);
    EXPECT_TRUE(reporter.warnings().empty()) << "seed " << seed << ": " << reporter.warnings()[0];
  }
}

TEST(VisualHull, FiveWrongMasksOf36AreFound) {
  auto views = ballViews();
  for (const int i : {2, 3, 11, 20, 33}) views[i].mask = photograph(views[i].camera, ball({0, 0.9, 1.2}, 0.5));
  const VisualHull hull = carveVisualHull(views, {}, Reporter::silent());
  for (std::size_t i = 0; i < views.size(); ++i)
    EXPECT_EQ(hull.views[i].excluded, i == 2 || i == 3 || i == 11 || i == 20 || i == 33) << views[i].name;
  EXPECT_NEAR(meshVolume(hull.mesh) / (4 * kPi / 3), 1, 0.02);
}

Image8 shifted(const Image8& mask, int dx, int dy) {
  Image8 out(mask.width(), mask.height(), 1);
  for (int y = 0; y < mask.height(); ++y)
    for (int x = 0; x < mask.width(); ++x)
      if (x >= dx && y >= dy && x - dx < mask.width() && y - dy < mask.height()) out.at(x, y) = mask.at(x - dx, y - dy);
  return out;
}

TEST(VisualHull, AShiftedSilhouetteAgreesLeast) {
  auto views = ballViews();
  views[5].mask = shifted(views[5].mask, 2, -1);
  HullOptions options;
  options.exclude_outliers = false;
  const VisualHull hull = carveVisualHull(views, options, Reporter::silent());
  expectClosedSurface(hull.mesh, 1, 2);
  double lower = 0;
  for (std::size_t i = 0; i < views.size(); ++i) lower += hull.views[i].covered < hull.views[5].covered;
  test::recordHardCase(30, "one silhouette shifted: views that score below it", lower, test::atMost(0));
}

TEST(VisualHull, ShiftsOfTwoPixelsEverywhereLeaveAHull) {
  auto views = ballViews();
  for (std::size_t i = 0; i < views.size(); ++i) views[i].mask = shifted(views[i].mask, i % 2 ? 2 : -2, i % 3 ? 2 : -2);
  const VisualHull hull = carveVisualHull(views, {}, Reporter::silent());
  // 2.8 of 47 pixels of radius at most: 0.94^3 and the creases.
  test::recordHardCase(30, "all silhouettes shifted by 2 pixels: volume of the hull over the ball's",
                       meshVolume(hull.mesh) / (4 * kPi / 3), test::atLeast(0.75));
  EXPECT_LT(meshVolume(hull.mesh), 4 * kPi / 3);
  for (const auto& view : hull.views) EXPECT_FALSE(view.excluded);
}

TEST(VisualHull, UselessMasksAreRefusedByName) {
  auto views = ballViews();
  std::fill(views[4].mask.data().begin(), views[4].mask.data().end(), 0);
  EXPECT_NE(errorOf(views).find("view4: the mask is empty"), std::string::npos) << errorOf(views);
  std::fill(views[4].mask.data().begin(), views[4].mask.data().end(), 255);
  EXPECT_NE(errorOf(views).find("view4: the mask is all object"), std::string::npos) << errorOf(views);
  views[4].mask = Image8(64, 128, 1, 255);
  EXPECT_NE(errorOf(views).find("view4: the mask has 64 x 128 pixels"), std::string::npos) << errorOf(views);
  double unnamed = 0;
  for (const int value : {0, 255}) {
    views[4].mask = Image8(128, 128, 1, static_cast<std::uint8_t>(value));
    unnamed += errorOf(views).find("view4") == std::string::npos;
  }
  test::recordHardCase(33, "empty and all-white masks that are not refused by name", unnamed, test::atMost(0));
  EXPECT_NE(errorOf({}).find("no silhouettes"), std::string::npos);
}

TEST(VisualHull, SilhouettesThatLeaveNothingNameTheWorstViews) {
  auto views = ballViews();
  // Three views each see something else: with all of them nothing is left.
  views[1].mask = photograph(views[1].camera, ball({0, 0, 0.8}, 0.15));
  views[9].mask = photograph(views[9].camera, ball({0.8, 0, 0}, 0.15));
  views[30].mask = photograph(views[30].camera, ball({0, -0.8, 0}, 0.15));
  HullOptions options;
  options.exclude_outliers = false;
  const std::string error = errorOf(views, options);
  EXPECT_NE(error.find("leave nothing"), std::string::npos) << error;
  for (const char* name : {"view1 ", "view9 ", "view30 "}) EXPECT_NE(error.find(name), std::string::npos) << error;
}

TEST(VisualHull, ViewsAlongOneLineAskForBounds) {
  auto views = ballViews();
  views.resize(1);
  EXPECT_NE(errorOf(views).find("give its bounds"), std::string::npos) << errorOf(views);
  HullOptions options;
  options.bounds.emplace();
  options.bounds->extend(Point3(-1.5, -1.5, -1.5));
  options.bounds->extend(Point3(1.5, 1.5, 1.5));
  expectClosedSurface(carveVisualHull(views, options, Reporter::silent()).mesh, 1, 2);
}

TEST(VisualHull, OptionsOutOfRangeAreRefused) {
  HullOptions options;
  options.tolerance = -1;
  EXPECT_NE(errorOf(ballViews(), options).find("tolerance"), std::string::npos);
  options = {};
  options.resolution = 100000;
  EXPECT_NE(errorOf(ballViews(), options).find("resolution"), std::string::npos);
}

// --- Real and independent captures
// -------------------------------------------------------------------------------------------

TEST(SilhouetteConsistency, AnExactMeshAgreesAndAWrongOneIsSeen) {
  const auto& views = ballViews();
  AcquisitionMesh mesh = carveVisualHull(views, {}, Reporter::silent()).mesh;
  for (const auto& view : silhouetteConsistency(mesh, views)) EXPECT_GT(view.iou, 0.98);
  for (auto& p : mesh.positions) p = Point3(0.5 * p.raw());
  for (const auto& view : silhouetteConsistency(mesh, views)) {
    EXPECT_NEAR(view.iou, 0.25, 0.02);  // a quarter of the area
    EXPECT_NEAR(view.covered, 0.25, 0.02);
  }
  for (auto& p : mesh.positions) p = Point3(2.4 * p.raw());
  for (const auto& view : silhouetteConsistency(mesh, views)) {
    EXPECT_NEAR(view.iou, 1 / 1.44, 0.03);  // perspective makes the nearer outline a little larger still
    EXPECT_EQ(view.covered, 1);
  }
}

TEST(SilhouetteConsistency, IsWhatRaysThroughThePixelsSay) {
  auto cameras = camerasAround(12, 300, 30, 5);
  for (CameraAt& camera : cameras) {
    camera.lens.model = CameraModel::opencv;
    camera.lens.k1 = -0.1, camera.lens.skew = 2, camera.lens.cx += 40;  // the ball leaves the picture
  }
  const auto views = photographs(cameras, ball({0.3, 0, 0}, 1.2));
  const AcquisitionMesh mesh = carveVisualHull(ballViews(), {}, Reporter::silent()).mesh;
  const auto scene = RayScene<Space>::ofTriangles(mesh.positions, mesh.triangles);
  const auto told = silhouetteConsistency(mesh, views);
  for (std::size_t i = 0; i < views.size(); ++i) {
    double both = 0, either = 0, inside = 0;
    for (int y = 0; y < 300; ++y)
      for (int x = 0; x < 300; ++x) {
        const bool object = views[i].mask.at(x, y) >= 128;
        const bool hit = scene.intersect(*views[i].camera.ray({x + 0.5, y + 0.5})).hit();
        both += object && hit, either += object || hit, inside += object;
      }
    EXPECT_NEAR(told[i].iou, both / either, 1e-4);  // 4 pixels of 40000 on the outline
    EXPECT_NEAR(told[i].covered, both / inside, 1e-4);
  }
}

}  // namespace
}  // namespace srf
