#include "acquire/shape_import.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <random>

#include "base/error.h"
#include "base/files.h"
#include "base/mesh_io.h"
#include "base/numeric.h"
#include "tests/support/test_support.h"

namespace srf {
namespace {

using Point3 = Point<AcquisitionSpace>;
using Direction3 = Direction<AcquisitionSpace>;

Box<AcquisitionSpace> boxOf(const Vec3& center, const Vec3& half) {
  Box<AcquisitionSpace> box;
  box.extend(Point3(center - half));
  box.extend(Point3(center + half));
  return box;
}

// The largest angle between a triangle's plane and the normals of its corners, degrees.
double worstNormal(const AcquisitionMesh& mesh) {
  double worst = 0;
  for (const Triangle& t : mesh.triangles) {
    const auto plane =
        normalize(cross(mesh.positions[t[1]] - mesh.positions[t[0]], mesh.positions[t[2]] - mesh.positions[t[0]]));
    for (const std::uint32_t v : t) worst = std::max(worst, degrees(angleBetween(*plane, mesh.normals[v])));
  }
  return worst;
}

TEST(ParametricShape, SphereIsExact) {
  const Vec3 center{10, -20, 30};
  const auto shape = parametricShape("sphere", boxOf(center, {2, 2.02, 1.98}), Reporter::silent());
  ASSERT_TRUE(shape);
  EXPECT_NEAR(shape->positional_error, 0.02, 1e-12);
  for (std::size_t i = 0; i < shape->mesh.positions.size(); ++i) {
    const Vec3 p = shape->mesh.positions[i].raw() - center;
    ASSERT_NEAR(length(p), 2, 1e-13);
    ASSERT_LT(angleBetweenUnit(p / length(p), shape->mesh.normals[i].raw()), 1e-14);
  }
  const MeshTopology topology = meshTopology(shape->mesh);
  EXPECT_TRUE(topology.closed && topology.manifold && topology.oriented);
  EXPECT_EQ(topology.euler_characteristic, 2);
  EXPECT_NEAR(meshVolume(shape->mesh) / (4.0 / 3 * kPi * 8), 1, 5e-4);
}

TEST(ParametricShape, ABoxThatIsNoCubeHoldsAnEllipsoid) {
  const Vec3 half{1, 2, 3};
  const auto shape = parametricShape("sphere", boxOf({}, half), Reporter::silent());
  ASSERT_TRUE(shape);
  for (std::size_t i = 0; i < shape->mesh.positions.size(); ++i) {
    const Vec3 unit = shape->mesh.positions[i].raw() / half;
    ASSERT_NEAR(length(unit), 1, 1e-13);
    const Vec3 gradient = unit / half;
    ASSERT_LT(angleBetweenUnit(gradient / length(gradient), shape->mesh.normals[i].raw()), 1e-13);
  }
}

TEST(ParametricShape, EveryShapeFillsItsBoxAndFacesOutwards) {
  for (const char* name : {"sphere", "box", "cylinder", "plane", "torus"}) {
    SCOPED_TRACE(name);
    const Box<AcquisitionSpace> box = boxOf({1, 2, 3}, {2, 2, 0.7});
    const auto shape = parametricShape(name, box, Reporter::silent());
    ASSERT_TRUE(shape);
    const AcquisitionMesh& mesh = shape->mesh;
    EXPECT_GT(mesh.triangles.size(), 50000u);
    EXPECT_LT(mesh.triangles.size(), 130000u);
    EXPECT_LT(worstNormal(mesh), 3.5);  // the torus's facets across its tube span 360 / 160 degrees
    for (int k = 0; k < 3; ++k) {
      if (std::string(name) == "plane" && k == 2) continue;
      EXPECT_NEAR(mesh.bounds().min[k], box.min[k], 1e-3);
      EXPECT_NEAR(mesh.bounds().max[k], box.max[k], 1e-3);
    }
    EXPECT_GE(meshVolume(mesh), 0);
  }
  EXPECT_FALSE(parametricShape("teapot", boxOf({}, {1, 1, 1}), Reporter::silent()));
  EXPECT_THROW(parametricShape("sphere", Box<AcquisitionSpace>{}, Reporter::silent()), Error);
  EXPECT_THROW(parametricShape("box", boxOf({}, {1, 0, 1}), Reporter::silent()), Error);
}

TEST(ParametricShape, PlaneLiesInTheMiddleAndFacesUp) {
  const auto shape = parametricShape("plane", boxOf({0, 0, 5}, {1, 2, 0.5}), Reporter::silent());
  for (std::size_t i = 0; i < shape->mesh.positions.size(); ++i) {
    ASSERT_EQ(shape->mesh.positions[i].raw().z, 5);
    ASSERT_EQ(shape->mesh.normals[i].raw(), (Vec3{0, 0, 1}));
  }
}

TEST(ParametricShape, CylinderStandsAlongTheOddAxis) {
  const struct {
    Vec3 half;
    int axis;
  } cases[] = {{{1, 1, 3}, 2}, {{3, 1, 1}, 0}, {{1, 3, 1.01}, 1}, {{2, 0.5, 2}, 1}, {{1, 1, 1}, 2}};
  for (const auto& [half, axis] : cases) {
    const auto shape = parametricShape("cylinder", boxOf({}, half), Reporter::silent());
    ASSERT_TRUE(shape);
    bool flat_cap = false;
    for (const auto& n : shape->mesh.normals) flat_cap |= n.raw()[axis] == 1;
    EXPECT_TRUE(flat_cap);
    const Vec3 area{half.y * half.z, half.z * half.x, half.x * half.y};
    EXPECT_NEAR(meshVolume(shape->mesh) / (kPi * area[axis] * 2 * half[axis]), 1, 1e-3);
  }
}

TEST(ParametricShape, TorusHasGenusOne) {
  const auto shape = parametricShape("torus", boxOf({}, {0.5, 2, 2}), Reporter::silent());
  const MeshTopology topology = meshTopology(shape->mesh);
  EXPECT_TRUE(topology.closed && topology.manifold && topology.oriented);
  EXPECT_EQ(topology.euler_characteristic, 0);
  EXPECT_NEAR(meshVolume(shape->mesh) / (2 * kPi * kPi * 1.5 * 0.25), 1, 2e-3);
  EXPECT_NEAR(shape->positional_error, 0, 1e-12);
}

// --- Meshes
// ------------------------------------------------------------------------------------------------------------

// Triangles of a sphere that share no vertices; every third is turned, the first is there twice.
AcquisitionMesh sphereSoup(const Vec3& center = {5, 0, 0}) {
  const AcquisitionMesh sphere = parametricShape("sphere", boxOf(center, {1, 1, 1}), Reporter::silent())->mesh;
  AcquisitionMesh soup;
  for (std::size_t i = 0; i < sphere.triangles.size(); ++i) {
    Triangle t = sphere.triangles[i];
    if (i % 3 == 0) std::swap(t[0], t[1]);
    Triangle own;
    for (int k = 0; k < 3; ++k) {
      own[k] = static_cast<std::uint32_t>(soup.positions.size());
      soup.positions.push_back(sphere.positions[t[k]]);
    }
    soup.triangles.push_back(own);
  }
  soup.triangles.push_back(soup.triangles[0]);
  return soup;
}

TEST(ImportedMesh, ASoupOfTurnedTrianglesBecomesAClosedSurface) {
  const test::TemporaryFolder folder;
  writePly(folder / "soup.ply", sphereSoup());
  const ImportedShape shape = importShape(folder / "soup.ply", Reporter::silent());
  const MeshTopology topology = meshTopology(shape.mesh);
  EXPECT_TRUE(topology.closed && topology.manifold && topology.oriented);
  EXPECT_EQ(topology.components, 1);
  EXPECT_NEAR(meshVolume(shape.mesh) / (4.0 / 3 * kPi), 1, 1e-3);
  EXPECT_LT(worstNormal(shape.mesh), 2);
  EXPECT_LT(shape.positional_error, 1e-6);
}

// As coordinates of a country's survey are: floats would not hold them, and the file does not.
TEST(ImportedMesh, FarFromTheOriginVerticesOfDoublePrecisionStayApart) {
  const test::TemporaryFolder folder;
  writePly(folder / "soup.ply", sphereSoup({523000.5, 5.27e6, 400}));
  const ImportedShape shape = importShape(folder / "soup.ply", Reporter::silent());
  const MeshTopology topology = meshTopology(shape.mesh);
  EXPECT_TRUE(topology.closed && topology.manifold && topology.oriented);
  EXPECT_NEAR(meshVolume(shape.mesh) / (4.0 / 3 * kPi), 1, 1e-3);
  EXPECT_LT(worstNormal(shape.mesh), 2);
  EXPECT_LT(shape.positional_error, 1e-6);
}

TEST(ImportedMesh, AnInsideOutSurfaceIsTurnedWithItsNormals) {
  const test::TemporaryFolder folder;
  AcquisitionMesh mesh = parametricShape("sphere", boxOf({}, {1, 1, 1}), Reporter::silent())->mesh;
  for (Triangle& t : mesh.triangles) std::swap(t[0], t[1]);
  for (auto& n : mesh.normals) n = -n;
  writePly(folder / "a.ply", mesh);
  const ImportedShape shape = importShape(folder / "a.ply", Reporter::silent());
  EXPECT_GT(meshVolume(shape.mesh), 4);
  EXPECT_LT(worstNormal(shape.mesh), 2);
}

TEST(ImportedMesh, NormalsTellTheOutsideOfAnOpenSurface) {
  const test::TemporaryFolder folder;
  AcquisitionMesh mesh = parametricShape("plane", boxOf({}, {1, 1, 0}), Reporter::silent())->mesh;
  for (std::size_t i = 0; i < mesh.triangles.size(); i += 2) std::swap(mesh.triangles[i][0], mesh.triangles[i][1]);
  for (auto& n : mesh.normals) n = Direction3::fromUnit({0, 0, -1});
  writePly(folder / "a.ply", mesh);
  Reporter reporter(ProgressMode::none, LogLevel::error);
  const ImportedShape shape = importShape(folder / "a.ply", reporter);
  EXPECT_LT(worstNormal(shape.mesh), 1e-6);
  EXPECT_EQ(shape.mesh.normals[0].raw().z, -1);
  ASSERT_EQ(reporter.warnings().size(), 1u);
  EXPECT_NE(reporter.warnings()[0].find("1 holes or seams with 720 border edges"), std::string::npos)
      << reporter.warnings()[0];
}

TEST(ImportedMesh, NormalsAtSharpEdgesStayApart) {
  const test::TemporaryFolder folder;
  writePly(folder / "a.ply", parametricShape("box", boxOf({}, {1, 1, 1}), Reporter::silent())->mesh);
  EXPECT_LT(worstNormal(importShape(folder / "a.ply", Reporter::silent()).mesh), 1e-4);
}

TEST(ImportedMesh, ScansKeepTheirShape) {
  SRF_REQUIRE_DATA(capsule, "capsule/capture/model.ply");
  SRF_REQUIRE_DATA(bunny, "scans/stanford-bunny.obj");
  const AcquisitionMesh file = readMesh(capsule);
  const ImportedShape shape = importShape(capsule, Reporter::silent());
  EXPECT_EQ(shape.mesh.triangles.size(), file.triangles.size());
  EXPECT_TRUE(meshTopology(shape.mesh).closed) << "the texture seam is not joined";
  EXPECT_NEAR(meshVolume(shape.mesh), meshVolume(file), 1e-6);
  EXPECT_LT(worstNormal(shape.mesh), 3);

  Reporter reporter(ProgressMode::none, LogLevel::error);
  const ImportedShape rabbit = importShape(bunny, reporter);
  EXPECT_EQ(rabbit.mesh.triangles.size(), 69451u);
  EXPECT_GT(meshVolume(rabbit.mesh), 7e-4);
  ASSERT_EQ(reporter.warnings().size(), 1u);
  EXPECT_NE(reporter.warnings()[0].find("5 holes"), std::string::npos) << reporter.warnings()[0];
}

// --- Point clouds
// --------------------------------------------------------------------------------------------------------

constexpr double kNoise = 0.01;

// Points of a unit sphere about (2, 0, 0), displaced along the normal.
AcquisitionMesh noisySphere(int count, bool with_normals) {
  std::mt19937 random(3);
  std::normal_distribution<double> normal;
  AcquisitionMesh cloud;
  for (int i = 0; i < count; ++i) {
    const auto n = *normalize(Vector<AcquisitionSpace>(normal(random), normal(random), normal(random)));
    cloud.positions.push_back(Point3(2, 0, 0) + (1 + kNoise * normal(random)) * n);
    if (with_normals) cloud.normals.push_back(n);
  }
  return cloud;
}

void expectUnitSphere(const ImportedShape& shape) {
  const MeshTopology topology = meshTopology(shape.mesh);
  EXPECT_TRUE(topology.closed && topology.manifold && topology.oriented);
  EXPECT_EQ(topology.euler_characteristic, 2);
  std::vector<double> off;
  double normal_sum = 0;
  for (std::size_t i = 0; i < shape.mesh.positions.size(); ++i) {
    const Vec3 p = shape.mesh.positions[i].raw() - Vec3{2, 0, 0};
    off.push_back(std::fabs(length(p) - 1));
    normal_sum += degrees(angleBetweenUnit(p / length(p), shape.mesh.normals[i].raw()));
  }
  std::sort(off.begin(), off.end());
  EXPECT_LT(off[off.size() * 95 / 100], 3 * kNoise);
  EXPECT_LT(off.back(), 6 * kNoise);
  EXPECT_LT(normal_sum / static_cast<double>(off.size()), 6);
  EXPECT_GT(shape.positional_error, 0);
  EXPECT_LT(shape.positional_error, 0.05);
}

TEST(ImportedPoints, NoisyOrientedPointsGiveTheSphere) {
  const test::TemporaryFolder folder;
  writePly(folder / "points.ply", noisySphere(5000, true));
  expectUnitSphere(importShape(folder / "points.ply", Reporter::silent()));
}

TEST(ImportedPoints, NormalsAreFoundAndOutliersDropped) {
  const test::TemporaryFolder folder;
  AcquisitionMesh cloud = noisySphere(5000, false);
  std::mt19937 random(4);
  std::uniform_real_distribution<double> far(-3, 3);
  for (int i = 0; i < 25; ++i) {
    const Point3 p(2 + far(random), far(random), far(random));
    if (std::fabs(distance(p, Point3(2, 0, 0)) - 1) > 0.3) cloud.positions.push_back(p);
  }
  cloud.positions.emplace_back(NAN, 0, 0);
  writePly(folder / "points.ply", cloud);
  Reporter reporter(ProgressMode::none, LogLevel::error);
  expectUnitSphere(importShape(folder / "points.ply", reporter));
  EXPECT_GE(reporter.counters()["shape.points_dropped"], 15u);
}

TEST(ImportedPoints, TooFewOrFlatPointsAreRefused) {
  const test::TemporaryFolder folder;
  AcquisitionMesh few = noisySphere(20, true), flat = noisySphere(500, true), same = noisySphere(500, true);
  for (auto& p : flat.positions) p = Point3(p.raw().x, p.raw().y, 0);
  for (auto& p : same.positions) p = Point3(1, 2, 3);
  for (const auto& cloud : {few, flat, same}) {
    writePly(folder / "points.ply", cloud);
    EXPECT_THROW(importShape(folder / "points.ply", Reporter::silent()), Error);
  }
}

}  // namespace
}  // namespace srf
