#include "model/skinning.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <random>

#include "base/mesh_io.h"
#include "model/deformed_model.h"
#include "model/gltf_export.h"
#include "model/gltf_pose.h"
#include "tests/model/test_shapes.h"
#include "tests/support/test_support.h"

namespace srf {
namespace {

constexpr double kFps = 24;
constexpr double kFloat = 1e-6;  // positions of size 1 through a file of floats, and a transform or two

/// The mesh as a glTF would hold it, at node 0.
Gltf gltfOf(const AcquisitionMesh& mesh) {
  Gltf gltf;
  gltf.file = "made.glb";
  GltfMesh made{"made"};
  for (const auto& p : mesh.positions) made.positions.push_back(gltfFromObject(p.raw()));
  made.triangles = mesh.triangles;
  for (std::size_t i = 0; i < mesh.positions.size(); ++i) made.srf_index.push_back(static_cast<double>(i));
  gltf.meshes = {made};
  gltf.nodes.push_back({"holder"});
  gltf.nodes[0].mesh = 0;
  gltf.order = {0};
  return gltf;
}
/// Every corner of every triangle a vertex of its own, in another order: what flat shading makes of it.
void splitApart(GltfMesh& mesh) {
  std::vector<std::uint32_t> order(3 * mesh.triangles.size());
  for (std::uint32_t i = 0; i < order.size(); ++i) order[i] = i;
  std::shuffle(order.begin(), order.end(), std::mt19937(1));
  GltfMesh split = mesh;
  split.positions.assign(order.size(), {});
  split.srf_index.assign(order.size(), 0);
  for (std::uint32_t i = 0; i < order.size(); ++i) {
    const std::uint32_t from = mesh.triangles[i / 3][i % 3];
    split.positions[order[i]] = mesh.positions[from];
    split.srf_index[order[i]] = mesh.srf_index[from];
    split.triangles[i / 3][i % 3] = order[i];
  }
  mesh = std::move(split);
}
/// Drives node 0 from one value to another over a second.
void animate(Gltf& gltf, int node, GltfPath path, std::vector<double> from, const std::vector<double>& to) {
  GltfChannel channel{node, path, GltfInterpolation::linear, static_cast<int>(from.size()), {0, 1}, std::move(from)};
  channel.values.insert(channel.values.end(), to.begin(), to.end());
  gltf.animations.resize(1);
  gltf.animations[0].channels.push_back(std::move(channel));
}
/// Two joints along z of object space (y of the file), the upper at height `height`, weights by a smooth step between
/// `low` and `high`: a bend by turning node 2.
void bend(Gltf& gltf, double low, double high, double height) {
  GltfMesh& mesh = gltf.meshes[0];
  mesh.influences = 2;
  for (const Vec3& p : mesh.positions) {
    const double upper = smoothstep(low, high, p.y);
    mesh.joints.insert(mesh.joints.end(), {0, 1});
    mesh.joint_weights.insert(mesh.joint_weights.end(), {1 - upper, upper});
  }
  gltf.nodes.resize(3);
  gltf.nodes[2].translation = {0, height, 0};
  gltf.nodes[2].parent = 1;
  gltf.order = {0, 1, 2};
  gltf.skins = {{{1, 2}, {{Mat3{}, {}}, {Mat3{}, {0, -height, 0}}}}};
  gltf.nodes[0].skin = 0;
  animate(gltf, 2, GltfPath::rotation, {0, 0, 0, 1}, {std::sin(0.5), 0, 0, std::cos(0.5)});  // 1 radian
}

std::unique_ptr<const VertexMotion> motionOf(Gltf gltf, const AcquisitionMesh& rest, bool proxy = false,
                                             bool loop = false) {
  SkinSource source;
  source.gltf = std::make_shared<const Gltf>(std::move(gltf));
  source.animation = source.gltf->animations.empty() ? nullptr : &source.gltf->animations[0];
  source.proxy = proxy;
  source.loop = loop;
  source.where = "scene.json: /deformation/0";
  return skinMotion(source, rest, kFps, Reporter::silent());
}
template <class Call>
std::string refusal(const Call& call) {
  try {
    call();
  } catch (const Error& e) {
    return e.what();
  }
  return "";
}
double worstApart(const std::vector<Point<ObjectSpace>>& a, const std::vector<Point<ObjectSpace>>& b) {
  EXPECT_EQ(a.size(), b.size());
  double worst = 0;
  for (std::size_t i = 0; i < std::min(a.size(), b.size()); ++i) worst = std::max(worst, distance(a[i], b[i]));
  return worst;
}
std::vector<Point<ObjectSpace>> asObject(const std::vector<Point<AcquisitionSpace>>& points) {
  std::vector<Point<ObjectSpace>> same;
  for (const auto& p : points) same.emplace_back(p.raw());
  return same;
}

TEST(Skinning, AnExportedMeshComesBackWhereItWas) {
  const AcquisitionMesh rest = test::torus(40, 20);
  const test::TemporaryFolder folder;
  exportRestMesh(rest, folder / "rest.glb");
  const Gltf gltf = readGltf(folder / "rest.glb");
  EXPECT_EQ(gltf.meshes[0].triangles, rest.triangles);
  EXPECT_LE(worstApart(motionOf(gltf, rest)->at(5).positions, asObject(rest.positions)), kFloat);
  exportRestMesh(rest, folder / "rest.ply");
  EXPECT_EQ(readMesh(folder / "rest.ply").positions, rest.positions);
  EXPECT_NE(refusal([&] { exportRestMesh(rest, folder / "rest.stl"); }).find(".glb or .ply"), std::string::npos);
}

TEST(Skinning, SplitAndShuffledVerticesAreFoundByEachCarrier) {
  const AcquisitionMesh rest = test::torus(40, 20);
  Gltf gltf = gltfOf(rest);
  splitApart(gltf.meshes[0]);
  animate(gltf, 0, GltfPath::translation, {0, 0, 0}, {0, 24, 0});
  std::vector<Point<ObjectSpace>> expected;
  for (const auto& p : rest.positions) expected.emplace_back(p.raw() + Vec3{0, 0, 3});  // frame 3: 3 / 24 of the way
  GltfMesh& mesh = gltf.meshes[0];
  EXPECT_LE(worstApart(motionOf(gltf, rest)->at(3).positions, expected), 1e-12);
  mesh.texture_index = std::exchange(mesh.srf_index, {});
  EXPECT_LE(worstApart(motionOf(gltf, rest)->at(3).positions, expected), 1e-12);
  // Texture coordinates of another meaning are no carrier: then the place counts.
  for (double& u : mesh.texture_index) u = 0.25;
  EXPECT_LE(worstApart(motionOf(gltf, rest)->at(3).positions, expected), 1e-12);
  mesh.texture_index.clear();
  EXPECT_LE(worstApart(motionOf(gltf, rest)->at(3).positions, expected), 1e-12);
}

TEST(Skinning, TheIndexHoldsWhereTheRestWasMovedAway) {
  const AcquisitionMesh rest = test::torus(20, 10);
  Gltf gltf = gltfOf(rest);
  gltf.nodes[0].translation = {5, 0, 0};
  const auto moved = motionOf(gltf, rest)->at(0);
  EXPECT_LE(distance(moved.positions[7], Point<ObjectSpace>(rest.positions[7].raw() + Vec3{5, 0, 0})), 1e-12);
}

TEST(Skinning, ALoopBeginsAnewAfterItsLastKey) {
  const AcquisitionMesh rest = test::torus(20, 10);
  Gltf gltf = gltfOf(rest);
  animate(gltf, 0, GltfPath::translation, {0, 0, 0}, {24, 0, 0});  // a unit a frame
  const auto once = motionOf(gltf, rest), loop = motionOf(gltf, rest, false, true);
  const auto x = [&](const VertexMotion& motion, double frame) {
    return motion.at(frame).positions[0].raw().x - rest.positions[0].raw().x;
  };
  EXPECT_NEAR(x(*once, 29), 24, 1e-9);
  EXPECT_NEAR(x(*loop, 29), 5, 1e-9);
  EXPECT_NEAR(x(*loop, -1), 23, 1e-9);
  EXPECT_NEAR(x(*loop, 24), 0, 1e-9);
}

TEST(Skinning, WhatDoesNotFitIsRefusedWithTheVertex) {
  const AcquisitionMesh rest = test::torus(20, 10);
  const auto expect = [&](const std::function<void(Gltf&)>& harm, const std::vector<std::string>& said) {
    Gltf gltf = gltfOf(rest);
    harm(gltf);
    const std::string what = refusal([&] { motionOf(gltf, rest); });
    for (const std::string& part : said) EXPECT_NE(what.find(part), std::string::npos) << part << " in: " << what;
  };
  expect([](Gltf& g) { g.meshes[0].srf_index[17] = 200; },
         {"made.glb", "_SRF_INDEX", "vertex 17", "carries 200", "0 to 199"});
  expect([](Gltf& g) { g.meshes[0].srf_index[17] = 12.5; }, {"vertex 17", "carries 12.5"});
  expect([](Gltf& g) { g.meshes[0].srf_index[17] = 18; }, {"vertex 17 of the model is carried by none"});
  expect(
      [](Gltf& g) {
        g.meshes[0].srf_index.clear();
        g.meshes[0].positions[17].x += 0.01;
      },
      {"vertex 17 of the model's 200", "the nearest of the glTF's 200 vertices is 17", "0.01", "no _SRF_INDEX",
       "proxy"});
  expect(
      [](Gltf& g) {
        g.meshes[0].texture_index = std::exchange(g.meshes[0].srf_index, {});
        g.meshes[0].texture_index[3] = 0.5;
        for (Vec3& p : g.meshes[0].positions) p.x += 1;
      },
      {"by TEXCOORD_1, vertex 3 of the glTF's mesh carries 0.5"});
  expect([](Gltf& g) { g.meshes[0] = {}; }, {"no vertices"});
}

TEST(Skinning, CopiesThatMoveApartAreNamedWithTheirFrame) {
  const AcquisitionMesh rest = test::torus(20, 10);
  Gltf gltf = gltfOf(rest);
  splitApart(gltf.meshes[0]);
  const auto& index = gltf.meshes[0].srf_index;
  const auto torn = std::find(index.begin(), index.end(), 42.0) - index.begin();
  gltf.meshes[0].targets = {std::vector<Vec3>(index.size())};
  gltf.meshes[0].targets[0][static_cast<std::size_t>(torn)] = {0, 0, 1};
  gltf.nodes[0].weights = {0};
  animate(gltf, 0, GltfPath::weights, {0}, {1});
  const auto motion = motionOf(gltf, rest);
  EXPECT_NO_THROW(motion->at(0));
  const std::string what = refusal([&] { motion->at(12); });
  EXPECT_NE(what.find("frame 12: vertex 42 of the model is torn"), std::string::npos) << what;
  EXPECT_NE(what.find("0.5 apart"), std::string::npos) << what;
}

TEST(Skinning, MirroredNodesMirrorAndAMirroredRestDoesNot) {
  const AcquisitionMesh rest = test::torus(20, 10);
  Gltf gltf = gltfOf(rest);
  animate(gltf, 0, GltfPath::scale, {1, 1, 1}, {-1, 1, 1});
  auto motion = motionOf(gltf, rest);
  for (const auto side : motion->at(24).handedness) ASSERT_EQ(side, -1);
  for (const auto side : motion->at(0).handedness) ASSERT_EQ(side, 1);
  // The same mesh bound mirrored, and standing upright again through its node: nothing is mirrored against rest.
  gltf.animations.clear();
  for (Vec3& p : gltf.meshes[0].positions) p.x = -p.x;
  gltf.nodes[0].scale = {-1, 1, 1};
  motion = motionOf(gltf, rest);
  for (const auto side : motion->at(0).handedness) ASSERT_EQ(side, 1);
}

TEST(Skinning, ARigidNodeTurnsTheModelAsAMapOfSpaceDoes) {
  for (const ModelKind kind : {ModelKind::mesh, ModelKind::surfels}) {
    ModelOptions options;
    options.kind = kind;
    options.surfels = 2000;
    const DeformableModel model =
        buildModel(test::torus(60, 30), "test", 0, test::fieldAround(2), options, Reporter::silent());
    Gltf gltf = gltfOf(model.restMesh());
    // A quarter turn about the file's y is one about z; a mirror in x on top.
    gltf.nodes[0].rotation = {std::sqrt(0.5), 0, std::sqrt(0.5), 0};
    animate(gltf, 0, GltfPath::scale, {1, 1, 1}, {-1, 1, 1});
    const MovedVertices moved = motionOf(gltf, model.restMesh())->at(24);
    const auto psi =
        AnimatedDeformation::parse(
            parseJson(R"([{"type": "affine", "matrix": [[0,-1,0,0],[-1,0,0,0],[0,0,1,0],[0,0,0,1]]}])", "x"), ".",
            Reporter::silent())
            .at(0);
    DeformedModel by_skin(model), by_map(model);
    by_skin.deform(Deformation(), &moved);
    by_map.deform(psi);
    EXPECT_EQ(by_skin.statistics().mirrored, model.size());
    for (std::size_t i = 0; i < model.size(); ++i) {
      ASSERT_LE(distance(by_skin.positions()[i], by_map.positions()[i]), 1e-6) << i;  // float barycentrics
      ASSERT_LE(length(by_skin.tangents()[i].u - by_map.tangents()[i].u), 1e-6) << i;
      ASSERT_LE(length(by_skin.tangents()[i].v - by_map.tangents()[i].v), 1e-6) << i;
    }
  }
}

// --- Proxy ----------------------------------------------------------------------------------------------------------

TEST(SkinningProxy, ASimilarityIsCarriedOverExactly) {
  const AcquisitionMesh coarse = test::sphere(4);
  AcquisitionMesh fine = test::sphere(16);
  for (auto& p : fine.positions) p = Point<AcquisitionSpace>(1.03 * p.raw());  // not on the proxy, outside it
  Gltf gltf = gltfOf(coarse);
  gltf.meshes[0].srf_index.clear();
  animate(gltf, 0, GltfPath::rotation, {0, 0, 0, 1}, {0, std::sin(0.5), 0, std::cos(0.5)});
  animate(gltf, 0, GltfPath::scale, {1, 1, 1}, {2, 2, 2});
  animate(gltf, 0, GltfPath::translation, {0, 0, 0}, {3, 4, 5});
  const MovedVertices moved = motionOf(gltf, fine, true)->at(24);
  std::vector<Point<ObjectSpace>> expected;
  const Mat3 turn = rotationAbout({0, 0, 1}, 1);
  for (const auto& p : fine.positions) expected.emplace_back(2 * (turn * p.raw()) + Vec3{3, -5, 4});
  EXPECT_LE(worstApart(moved.positions, expected), 1e-12);
  for (const auto side : moved.handedness) ASSERT_EQ(side, 1);
}

TEST(SkinningProxy, AFineModelFollowsTheBendOfItsProxy) {
  const AcquisitionMesh fine = test::sphere(24);
  Gltf exact = gltfOf(fine);
  bend(exact, -0.6, 0.6, 0);
  const auto expected = motionOf(exact, fine)->at(24).positions;
  double before = 1;
  for (const int cells : {6, 12, 24}) {
    Gltf coarse = gltfOf(test::sphere(cells));
    splitApart(coarse.meshes[0]);  // the seams are welded
    coarse.meshes[0].srf_index.clear();
    bend(coarse, -0.6, 0.6, 0);
    const auto moved = motionOf(coarse, fine, true)->at(24);
    double sum = 0;
    for (std::size_t i = 0; i < expected.size(); ++i) sum += square(distance(moved.positions[i], expected[i]));
    const double rms = std::sqrt(sum / static_cast<double>(expected.size()));
    // At most h^2 / 2 times the largest second derivative of the blend (6 / 1.2^2 radians at radius 1), h the spacing
    // of the proxy: 0.26, 0.13. Halving the spacing does better than halving the error.
    EXPECT_LE(worstApart(moved.positions, expected), 0.5 * square(1.57 / cells) * 4.2) << cells;
    EXPECT_LE(rms, 0.5 * before) << cells;
    before = rms;
    // No vertex leaves its neighbours: edges are stretched as the exact ones, not torn.
    double worst = 0;
    for (const Triangle& t : fine.triangles)
      for (int k = 0; k < 3; ++k) {
        const auto a = t[k], b = t[(k + 1) % 3];
        worst = std::max(
            worst, std::fabs(distance(moved.positions[a], moved.positions[b]) - distance(expected[a], expected[b])) /
                       distance(fine.positions[a], fine.positions[b]));
      }
    EXPECT_LE(worst, 0.5) << cells;
  }
}

TEST(SkinningProxy, AWallFollowsItsOwnSideAndNotTheOneBehind) {
  // Two walls back to back, 0.05 apart, vertices 0.2 apart; only the front one moves.
  AcquisitionMesh walls;
  for (int side = 0; side < 2; ++side)
    for (int i = 0; i <= 10; ++i)
      for (int j = 0; j <= 10; ++j) walls.positions.emplace_back(0.2 * i, 0.05 * side, 0.2 * j);
  for (std::uint32_t side = 0; side < 2; ++side)
    for (std::uint32_t i = 0; i < 10; ++i)
      for (std::uint32_t j = 0; j < 10; ++j) {
        const std::uint32_t a = side * 121 + i * 11 + j, b = a + 11, c = a + 12, d = a + 1;
        if (side == 0)
          walls.triangles.insert(walls.triangles.end(), {{a, b, c}, {a, c, d}});  // faces -y
        else
          walls.triangles.insert(walls.triangles.end(), {{a, c, b}, {a, d, c}});
      }
  Gltf gltf = gltfOf(walls);
  gltf.meshes[0].srf_index.clear();
  gltf.meshes[0].targets = {std::vector<Vec3>(walls.positions.size())};
  for (std::size_t i = 0; i < 121; ++i) gltf.meshes[0].targets[0][i] = gltfFromObject({0, -1, 0});
  gltf.nodes[0].weights = {0};
  animate(gltf, 0, GltfPath::weights, {0}, {1});
  const MovedVertices moved = motionOf(gltf, walls, true)->at(24);
  for (std::size_t i = 0; i < 242; ++i) ASSERT_NEAR(moved.positions[i].raw().y, i < 121 ? -1 : 0.05, 1e-3) << i;
}

TEST(SkinningProxy, ProxiesWithoutASurfaceAreRefused) {
  Gltf gltf = gltfOf(test::sphere(4));
  gltf.meshes[0].triangles.clear();
  EXPECT_NE(refusal([&] { motionOf(gltf, test::sphere(4), true); }).find("no triangles"), std::string::npos);
  gltf.meshes[0].triangles = {{0, 0, 1}};
  EXPECT_NE(refusal([&] { motionOf(gltf, test::sphere(4), true); }).find("no triangle of an area"), std::string::npos);
}

}  // namespace
}  // namespace srf
