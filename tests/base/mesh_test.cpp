#include "base/mesh.h"

#include <gtest/gtest.h>

#include <bit>
#include <cstring>
#include <fstream>
#include <random>

#include "base/error.h"
#include "base/files.h"
#include "base/mesh_io.h"
#include "base/numeric.h"
#include "tests/support/hard_case.h"
#include "tests/support/test_support.h"

namespace srf {
namespace {

using Point3 = Point<AcquisitionSpace>;

// The unit cube with its low corner at `low`: vertex i lies at the bits of i.
AcquisitionMesh cube(const Vec3& low = {}) {
  AcquisitionMesh mesh;
  for (int i = 0; i < 8; ++i)
    mesh.positions.emplace_back(low + Vec3{1.0 * (i & 1), 1.0 * (i >> 1 & 1), 1.0 * (i >> 2)});
  mesh.triangles = {{0, 2, 1}, {1, 2, 3}, {4, 5, 6}, {5, 7, 6}, {0, 1, 4}, {1, 5, 4},
                    {2, 6, 3}, {3, 6, 7}, {0, 4, 2}, {2, 4, 6}, {1, 3, 5}, {3, 7, 5}};
  return mesh;
}

// A torus of n x n quads about z; the radius of its tube wobbles by `noise`.
AcquisitionMesh torus(std::uint32_t n, double noise = 0) {
  AcquisitionMesh mesh;
  std::mt19937 random(5);
  for (std::uint32_t j = 0; j < n; ++j)
    for (std::uint32_t i = 0; i < n; ++i) {
      const double s = 2 * kPi * i / n, t = 2 * kPi * j / n;
      const double tube = 0.4 + noise * std::uniform_real_distribution(-1.0, 1.0)(random);
      const double r = 1 + tube * std::cos(t);
      mesh.positions.emplace_back(r * std::cos(s), r * std::sin(s), tube * std::sin(t));
      const std::uint32_t a = j * n + i, b = j * n + (i + 1) % n, c = (j + 1) % n * n + i,
                          d = (j + 1) % n * n + (i + 1) % n;
      mesh.triangles.push_back({a, b, d});
      mesh.triangles.push_back({a, d, c});
    }
  return mesh;
}

void append(AcquisitionMesh& mesh, const AcquisitionMesh& more, const std::vector<std::uint32_t>& as) {
  mesh.positions.insert(mesh.positions.end(), more.positions.begin(), more.positions.end());
  for (Triangle t : more.triangles) {
    for (std::uint32_t& v : t) v = as[v];
    mesh.triangles.push_back(t);
  }
}

TEST(Mesh, CubeIsClosedWithItsVolumeAndArea) {
  const MeshTopology topology = meshTopology(cube());
  EXPECT_TRUE(topology.closed && topology.manifold && topology.oriented);
  EXPECT_EQ(topology.components, 1);
  EXPECT_EQ(topology.euler_characteristic, 2);
  EXPECT_DOUBLE_EQ(meshArea(cube()), 6);
  EXPECT_DOUBLE_EQ(meshVolume(cube()), 1);
  EXPECT_DOUBLE_EQ(meshVolume(cube({1e6, -1e6, 1e6})), 1) << "the volume loses digits far from the origin";
}

TEST(Mesh, TorusHasGenusOne) {
  EXPECT_EQ(meshTopology(torus(12)).euler_characteristic, 0);
}

TEST(Mesh, AMissingTriangleOpensTheMesh) {
  AcquisitionMesh mesh = cube();
  mesh.triangles.pop_back();
  EXPECT_FALSE(meshTopology(mesh).closed);
  EXPECT_TRUE(meshTopology(mesh).manifold && meshTopology(mesh).oriented);
  EXPECT_FALSE(meshTopology(AcquisitionMesh{}).closed);
}

TEST(Mesh, ATurnedTriangleBreaksTheOrientation) {
  AcquisitionMesh mesh = cube();
  std::swap(mesh.triangles[3][0], mesh.triangles[3][1]);
  EXPECT_FALSE(meshTopology(mesh).oriented);
  EXPECT_TRUE(meshTopology(mesh).closed);
}

TEST(Mesh, ThreeTrianglesAtAnEdgeAndTwoFansAtAVertexAreNotManifold) {
  AcquisitionMesh fin = cube();
  fin.positions.emplace_back(2, 2, 2);
  fin.triangles.push_back({1, 3, 8});
  EXPECT_FALSE(meshTopology(fin).manifold);

  AcquisitionMesh touching = cube();  // a second cube that shares vertex 7
  append(touching, cube({1, 1, 1}), {7, 9, 10, 11, 12, 13, 14, 15});
  EXPECT_TRUE(meshTopology(touching).closed);
  EXPECT_FALSE(meshTopology(touching).manifold);

  AcquisitionMesh apart = cube();
  append(apart, cube({3, 3, 3}), {8, 9, 10, 11, 12, 13, 14, 15});
  EXPECT_TRUE(meshTopology(apart).manifold);
  EXPECT_EQ(meshTopology(apart).components, 2);
  const auto component = vertexComponents(apart);
  EXPECT_EQ(component[3], 0u);
  EXPECT_EQ(component[12], 1u);
}

TEST(Mesh, NormalsDoNotDependOnHowFacesAreSplit) {
  const auto normals = vertexNormals(cube());
  for (int i = 0; i < 8; ++i) {
    const Vec3 outward = (1 / std::sqrt(3.0)) * Vec3{i & 1 ? 1.0 : -1.0, i & 2 ? 1.0 : -1.0, i & 4 ? 1.0 : -1.0};
    EXPECT_LT(angleBetweenUnit(normals[i].raw(), outward), 1e-12) << "vertex " << i;
  }
}

TEST(Mesh, NormalOfAVertexWithoutAreaIsUp) {
  AcquisitionMesh mesh;
  mesh.positions = {Point3(0, 0, 0), Point3(1, 0, 0), Point3(2, 0, 0)};
  mesh.triangles = {{0, 1, 2}};
  EXPECT_EQ(vertexNormals(mesh)[1].raw(), (Vec3{0, 0, 1}));
}

TEST(Mesh, CleaningDropsWhatNoRayCanMeet) {
  AcquisitionMesh mesh = cube();
  mesh.positions.emplace_back(5, 5, 5);        // 8: unused
  mesh.positions.emplace_back(NAN, 0, 0);      // 9
  mesh.positions.emplace_back(0.5, 0.0, 0.0);  // 10: on the edge 0 1
  mesh.triangles.insert(mesh.triangles.begin(), {0, 1, 9});
  mesh.triangles.push_back({0, 1, 10});
  mesh.triangles.push_back({2, 2, 3});
  mesh.triangles.push_back({2, 1, 0});  // the first of the cube, turned
  mesh.normals.assign(mesh.positions.size(), {});
  const MeshRepair repair = cleanMesh(mesh);
  EXPECT_EQ(repair.not_finite, 1u);
  EXPECT_EQ(repair.degenerate, 2u);
  EXPECT_EQ(repair.duplicate, 1u);
  EXPECT_EQ(repair.unused_vertices, 3u);
  EXPECT_EQ(mesh.positions.size(), 8u);
  EXPECT_EQ(mesh.normals.size(), 8u);
  EXPECT_DOUBLE_EQ(meshVolume(mesh), 1);
  test::recordHardCase(26, "zero-area, duplicate, turned and NaN triangles: faults missed or invented by the report",
                       std::fabs(repair.not_finite - 1.0) + std::fabs(repair.degenerate - 2.0) +
                           std::fabs(repair.duplicate - 1.0) + std::fabs(repair.unused_vertices - 3.0),
                       test::atMost(0));
}

TEST(Mesh, SmoothingTakesNoiseOffAndKeepsTheVolume) {
  const AcquisitionMesh rough = torus(96, 0.01), exact = torus(96);
  const AcquisitionMesh smooth = smoothed(rough, 10);
  const auto roughness = [&](const AcquisitionMesh& mesh) {
    const auto normals = vertexNormals(mesh), true_normals = vertexNormals(exact);
    double sum = 0;
    for (std::size_t i = 0; i < normals.size(); ++i) sum += square(angleBetween(normals[i], true_normals[i]));
    return std::sqrt(sum / static_cast<double>(normals.size()));
  };
  EXPECT_LT(roughness(smooth), 0.5 * roughness(rough));
  EXPECT_NEAR(meshVolume(smooth) / meshVolume(exact), 1, 0.005);
  EXPECT_EQ(smooth.positions[0], smoothed(rough, 10).positions[0]);
}

// --- Files -----------------------------------------------------------------------------------------------------------

AcquisitionMesh readText(const test::TemporaryFolder& folder, const std::string& name, const std::string& text) {
  writeTextFile(folder / name, text);
  return readMesh(folder / name);
}

template <class T>
void put(std::string& bytes, T value, bool big_endian) {
  char raw[sizeof(T)];
  std::memcpy(raw, &value, sizeof(T));
  if (big_endian == (std::endian::native == std::endian::little)) std::reverse(raw, raw + sizeof(T));
  bytes.append(raw, sizeof(T));
}

TEST(MeshFiles, PlyComesBackBitByBit) {
  const test::TemporaryFolder folder;
  AcquisitionMesh mesh = torus(9);
  mesh.normals = vertexNormals(mesh);
  std::vector<float> extra(mesh.positions.size(), 2.5f);
  writePly(folder / "a.ply", mesh, {{"radius", extra}});
  const AcquisitionMesh back = readMesh(folder / "a.ply");
  EXPECT_EQ(back.positions, mesh.positions);
  EXPECT_EQ(back.triangles, mesh.triangles);
  ASSERT_EQ(back.normals.size(), mesh.normals.size());
  for (std::size_t i = 0; i < mesh.normals.size(); ++i)
    EXPECT_LT(angleBetween(back.normals[i], mesh.normals[i]), 1e-7);  // stored as float
}

TEST(MeshFiles, PlyTakesAnyOrderTypeAndEndianness) {
  const test::TemporaryFolder folder;
  for (const bool big : {false, true}) {
    // Other elements first and last, other properties between, counts and indices of other types, a quadrangle.
    std::string ply =
        std::string("ply\r\nformat binary_") + (big ? "big" : "little") +
        "_endian 1.0\r\ncomment by hand\r\nelement camera 1\r\nproperty double f\r\nelement vertex 4\r\n"
        "property uchar red\r\nproperty float z\r\nproperty list uchar short tags\r\nproperty double x\r\n"
        "property short y\r\nelement face 2\r\nproperty char flag\r\nproperty list ushort uint vertex_index\r\n"
        "end_header\r\n";
    put(ply, 1.0, big);
    for (int i = 0; i < 4; ++i) {
      put<std::uint8_t>(ply, 255, big);
      put<float>(ply, 0.25f * i, big);
      put<std::uint8_t>(ply, 2, big), put<std::int16_t>(ply, -1, big), put<std::int16_t>(ply, 7, big);
      put<double>(ply, 0.1 * i, big);
      put<std::int16_t>(ply, static_cast<std::int16_t>(-300 * i), big);
    }
    put<std::int8_t>(ply, 1, big), put<std::uint16_t>(ply, 4, big);
    for (std::uint32_t v : {3u, 2u, 1u, 0u}) put(ply, v, big);
    put<std::int8_t>(ply, 1, big), put<std::uint16_t>(ply, 3, big);
    for (std::uint32_t v : {0u, 1u, 3u}) put(ply, v, big);
    const AcquisitionMesh mesh = readText(folder, "a.ply", ply);
    ASSERT_EQ(mesh.positions.size(), 4u);
    EXPECT_EQ(mesh.positions[3], Point3(0.1 * 3, -900, 0.75));
    EXPECT_EQ(mesh.triangles, (std::vector<Triangle>{{3, 2, 1}, {3, 1, 0}, {0, 1, 3}}));
    EXPECT_TRUE(mesh.normals.empty());
  }
}

TEST(MeshFiles, AsciiPlyStripsTurnEverySecondTriangle) {
  const test::TemporaryFolder folder;
  const AcquisitionMesh mesh =
      readText(folder, "a.ply",
               "ply\nformat ascii 1.0\nelement vertex 5\nproperty float x\nproperty float y\nproperty float z\n"
               "element tristrips 1\nproperty list int int vertex_indices\nend_header\n"
               "0 0 0 \n1 0 0\n0 1 0\n+1 1e0 0\n0 2 -0.5\n9 0 1 2 3 -1 2 3 4 -1\n");
  EXPECT_EQ(mesh.triangles, (std::vector<Triangle>{{0, 1, 2}, {2, 1, 3}, {2, 3, 4}}));
  EXPECT_EQ(mesh.positions[4], Point3(0, 2, -0.5));
}

TEST(MeshFiles, PointCloudHasNoTriangles) {
  const test::TemporaryFolder folder;
  AcquisitionMesh cloud{cube().positions, {}, {}};
  cloud.normals.assign(8, Direction<AcquisitionSpace>::fromUnit({0, -1, 0}));
  writePly(folder / "a.ply", cloud);
  const AcquisitionMesh back = readMesh(folder / "a.ply");
  EXPECT_TRUE(back.triangles.empty());
  EXPECT_EQ(back.positions, cloud.positions);
  EXPECT_EQ(back.normals, cloud.normals);
}

TEST(MeshFiles, ObjTakesEveryFormOfIndex) {
  const test::TemporaryFolder folder;
  const std::string head = "# cube side\no a b\nv 0 0 0\nv 1 0 0 1.0\nv 1 1 0 0.5 0.5 0.5\nv 0 1 0\nvt 0 0\nvn 0 0 2\n";
  const std::vector<Triangle> quad{{0, 1, 2}, {0, 2, 3}};
  EXPECT_EQ(readText(folder, "a.obj", head + "f 1 2 3 4\n").triangles, quad);
  EXPECT_EQ(readText(folder, "a.obj", head + "f 1/1 2/1 3/1 4/1 # end\r\n").triangles, quad);
  EXPECT_TRUE(readText(folder, "a.obj", head + "f 1/1 2/1 3/1 4/1\n").normals.empty());
  for (const char* face : {"f 1//1 2//1 3//1 4//1", "f 1/1/1 2/1/1 3/1/1 4/1/-1", "f -4//-1 -3//-1 -2//-1 -1//-1"}) {
    const AcquisitionMesh mesh = readText(folder, "a.OBJ", head + face);
    EXPECT_EQ(mesh.triangles, quad) << face;
    ASSERT_EQ(mesh.normals.size(), 4u) << face;
    EXPECT_EQ(mesh.normals[3].raw(), (Vec3{0, 0, 1})) << face;
  }
}

TEST(MeshFiles, ObjKeepsTheOrderOfVerticesWhereNormalsDiffer) {
  const test::TemporaryFolder folder;
  const AcquisitionMesh mesh = readText(folder, "a.obj",
                                        "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nvn 0 0 1\nvn 0 1 0\n"
                                        "f 1//1 2//1 3//1\nf 1//2 4//2 2//2\n");
  ASSERT_EQ(mesh.positions.size(), 4u);
  EXPECT_NEAR(dot(mesh.normals[0].raw(), Vec3{0, std::sqrt(0.5), std::sqrt(0.5)}), 1, 1e-12);
  EXPECT_EQ(mesh.normals[3].raw(), (Vec3{0, 1, 0}));
}

TEST(MeshFiles, HostileFilesEndInAnErrorThatNamesTheFile) {
  const test::TemporaryFolder folder;
  const std::string xyz = "property float x\nproperty float y\nproperty float z\n";
  const std::string ascii = "ply\nformat ascii 1.0\n";
  const std::pair<const char*, std::string> files[] = {
      {"a.ply", ""},
      {"a.ply", "plx\n"},
      {"a.ply", "ply\n"},
      {"a.ply", "ply\nformat ascii 1.0\nelement vertex 1\n" + xyz + "0 0 0\n"},
      {"a.ply", "ply\nelement vertex 0\n" + xyz + "end_header\n"},
      {"a.ply", "ply\nformat zip 1.0\nend_header\n"},
      {"a.ply", ascii + "end_header\n"},
      {"a.ply", ascii + "element vertex -1\n" + xyz + "end_header\n"},
      {"a.ply", ascii + "element vertex 1\nproperty float x\nproperty float y\nend_header\n0 0\n"},
      {"a.ply", ascii + "element vertex 1\nproperty half x\nend_header\n0\n"},
      {"a.ply", ascii + "property float x\nend_header\n"},
      {"a.ply", ascii + "element vertex 2\n" + xyz + "end_header\n0 0 0\n0 0\n"},
      {"a.ply", ascii + "element vertex 1\n" + xyz + "end_header\n0 zero 0\n"},
      {"a.ply", ascii + "element vertex 99999999999999\n" + xyz + "end_header\n0 0 0\n"},
      {"a.ply", "ply\nformat binary_little_endian 1.0\nelement vertex 4000000000\n" + xyz + "end_header\nabc"},
      {"a.ply", ascii + "element vertex 1\n" + xyz +
                    "element face 1\nproperty list int int vertex_indices\nend_header\n"
                    "0 0 0\n3 0 0 1\n"},
      {"a.ply", ascii + "element vertex 1\n" + xyz +
                    "element face 1\nproperty list int int vertex_indices\nend_header\n"
                    "0 0 0\n3 0 0 -1\n"},
      {"a.ply", ascii + "element vertex 1\n" + xyz +
                    "element face 1\nproperty list int int vertex_indices\nend_header\n"
                    "0 0 0\n-3 0 0 0\n"},
      {"a.ply", ascii + "element vertex 1\n" + xyz +
                    "element face 1\nproperty list double double vertex_indices\n"
                    "end_header\n0 0 0\ninf 0 0 0\n"},
      {"a.ply", ascii + "element vertex 1\n" + xyz + "element face 5\nend_header\n0 0 0\n"},
      {"a.obj", ""},
      {"a.obj", "v 1 2\n"},
      {"a.obj", "v 1 2 x\n"},
      {"a.obj", "v 0 0 0\nf 1 1\n"},
      {"a.obj", "v 0 0 0\nf 1 1 0\n"},
      {"a.obj", "v 0 0 0\nf 1 1 2\n"},
      {"a.obj", "v 0 0 0\nf 1 1 -2\n"},
      {"a.obj", "v 0 0 0\nf 1//1 1//1 1//1\n"},
      {"a.obj", "v 0 0 0\nf 1/a/ /1 //\n"},
      {"a.obj", "v 0 0 0\nf 99999999999999999999 1 1\n"},
      {"a.stl", "solid\n"},
  };
  for (const auto& [name, text] : files) {
    writeTextFile(folder / name, text);
    try {
      readMesh(folder / name);
      ADD_FAILURE() << "accepted: " << text;
    } catch (const Error& error) {
      EXPECT_EQ(error.kind(), ErrorKind::bad_input);
      EXPECT_NE(std::string(error.what()).find(name), std::string::npos) << error.what();
    }
  }
  EXPECT_THROW(readMesh(folder / "missing.ply"), Error);
}

// Without the wait for the disk of writeTextFile, or of a file system that flushes truncated files.
void writeQuickly(const std::filesystem::path& file, const std::string& text) {
  std::filesystem::remove(file);
  std::ofstream(file, std::ios::binary) << text;
}

TEST(MeshFiles, DamagedPlyNeverCrashes) {
  const test::TemporaryFolder folder;
  writePly(folder / "a.ply", cube());
  const std::string whole = readTextFile(folder / "a.ply");
  for (std::size_t size = 0; size < whole.size(); ++size) {
    writeQuickly(folder / "b.ply", whole.substr(0, size));
    EXPECT_THROW(readMesh(folder / "b.ply"), Error) << size << " of " << whole.size() << " bytes";
  }
  std::mt19937 random(11);
  for (int i = 0; i < 1000; ++i) {
    std::string damaged = whole;
    for (int k = 0; k < 1 + i % 4; ++k) damaged[random() % damaged.size()] = static_cast<char>(random());
    writeQuickly(folder / "b.ply", damaged);
    try {
      readMesh(folder / "b.ply");
    } catch (const Error&) {}
  }
}

TEST(MeshFiles, SharedScansAreRead) {
  SRF_REQUIRE_DATA(igea, "scans/igea.ply");
  SRF_REQUIRE_DATA(bunny, "scans/stanford-bunny.obj");
  SRF_REQUIRE_DATA(capsule, "capsule/capture/model.ply");
  const AcquisitionMesh head = readMesh(igea);
  EXPECT_EQ(head.positions.size(), 134345u);
  const MeshTopology topology = meshTopology(head);  // a strip read wrongly is not oriented
  EXPECT_TRUE(topology.closed && topology.manifold && topology.oriented);
  EXPECT_GT(meshVolume(head), 0);
  EXPECT_EQ(readMesh(bunny).triangles.size(), 69451u);
  const AcquisitionMesh scan = readMesh(capsule);
  EXPECT_EQ(scan.triangles.size(), 97792u);
  ASSERT_EQ(scan.normals.size(), scan.positions.size());
  const auto normals = vertexNormals(scan);
  double worst = 0;
  for (const Triangle& t : scan.triangles) worst = std::max(worst, angleBetween(normals[t[0]], scan.normals[t[0]]));
  EXPECT_LT(degrees(worst), 3);
}

}  // namespace
}  // namespace srf
