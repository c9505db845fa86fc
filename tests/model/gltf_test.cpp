#include <gtest/gtest.h>

#include <cstdlib>
#include <fstream>
#include <map>
#include <random>
#include <sstream>

#include "base/error.h"
#include "base/files.h"
#include "base/numeric.h"
#include "model/gltf_pose.h"
#include "tests/model/tiny_gltf.h"
#include "tests/support/test_support.h"

namespace srf {
namespace {

using test::TinyGltf;

Gltf readText(const std::string& text) {
  const test::TemporaryFolder folder;
  writeTextFile(folder / "tiny.gltf", text);
  return readGltf(folder / "tiny.gltf");
}
Gltf read(const TinyGltf& tiny) {
  return readText(tiny.text());
}
std::string refusal(const std::string& text) {
  try {
    readText(text);
  } catch (const Error& e) {
    return e.what();
  }
  return "";
}
std::vector<Vec3> posedAt(const Gltf& gltf, double seconds) {
  const GltfAnimation* animation = gltf.animation("", "test");
  return posedMesh(gltf, gltf.meshNode("", "test"), poseAt(gltf, animation, seconds)).positions;
}
double apart(const Vec3& a, const Vec3& b) {
  return length(a - b);
}

// --- What an independent program computes ---------------------------------------------------------------------------

TEST(Gltf, SampleAssetsMoveAsAnIndependentReaderComputes) {
  SRF_REQUIRE_DATA(data, "animated");
  const char* full = std::getenv("SRF_GLTF_REFERENCE");
  std::ifstream table(full ? std::filesystem::path(full) : test::sourceFolder() / "tests/model/gltf_reference.csv");
  std::string line;
  std::map<std::string, Gltf> files;
  std::string posed_key;
  std::vector<Vec3> posed;
  std::map<std::string, double> worst;  // of each file, in parts of its size
  std::map<std::string, double> size;
  std::set<std::string> instants;
  while (std::getline(table, line)) {
    if (line.starts_with('#') || line.starts_with("file,")) continue;
    std::istringstream row(line);
    std::string file, animation, seconds, cell;
    std::getline(row, file, ','), std::getline(row, animation, ','), std::getline(row, seconds, ',');
    double number[4];
    for (double& n : number) {
      std::getline(row, cell, ',');
      n = std::stod(cell);
    }
    if (!files.count(file)) {
      files.emplace(file, readGltf(data / file));
      Box<ObjectSpace> box;
      for (const Vec3& p :
           posedMesh(files.at(file), files.at(file).meshNode("", "test"), poseAt(files.at(file), nullptr, 0)).positions)
        box.extend(Point<ObjectSpace>(p));
      size[file] = box.diameter();
    }
    const Gltf& gltf = files.at(file);
    if (posed_key != file + animation + seconds) {
      posed_key = file + animation + seconds;
      instants.insert(posed_key);
      posed = posedMesh(gltf, gltf.meshNode("", "test"),
                        poseAt(gltf, gltf.animation(animation, "test"), std::stod(seconds)))
                  .positions;
    }
    const Vec3 expected{number[1], number[2], number[3]};
    const double off = apart(objectFromGltf(posed.at(static_cast<std::size_t>(number[0]))), expected);
    worst[file] = std::max(worst[file], off / size[file]);
  }
  EXPECT_EQ(files.size(), 5u);
  EXPECT_EQ(instants.size(), 9u * 20u);  // animations x times
  // Both compute in double from the same floats; the table has 8 digits.
  for (const auto& [file, off] : worst) {
    EXPECT_LE(off, 1e-7) << file;
    RecordProperty(file, std::to_string(off));
  }
}

// --- Interpolation --------------------------------------------------------------------------------------------------

TEST(Gltf, StepLinearAndCubicFollowTheirFormulas) {
  for (const std::string way : {"STEP", "LINEAR", "CUBICSPLINE"}) {
    TinyGltf tiny = TinyGltf::triangle();
    std::vector<float> values{1, 0, 0, 5, 0, 0};
    if (way == "CUBICSPLINE") values = {9, 9, 9, 1, 0, 0, 2, 0, 0, /**/ -4, 0, 0, 5, 0, 0, 9, 9, 9};
    tiny.animate(0, "translation", way, {1, 3}, values);
    const Gltf gltf = read(tiny);
    const auto x = [&](double t) { return posedAt(gltf, t)[0].x; };
    EXPECT_EQ(x(0), 1) << way;  // holds before and after
    EXPECT_EQ(x(1), 1) << way;
    EXPECT_EQ(x(3), 5) << way;
    EXPECT_EQ(x(4), 5) << way;
    // Hermite at t = 1/4 over h = 2: 27/32 a + h 9/64 ma + 5/32 b - h 3/64 mb.
    const double expected = way == "STEP"     ? 1
                            : way == "LINEAR" ? 2
                                              : 27.0 / 32 + 2 * 9.0 / 64 * 2 + 5.0 / 32 * 5 + 2 * 3.0 / 64 * 4;
    EXPECT_NEAR(x(1.5), expected, 1e-12) << way;
  }
}

TEST(Gltf, RotationsTakeTheShorterArcAtEvenSpeed) {
  TinyGltf tiny = TinyGltf::triangle();
  const float c = std::sqrt(0.5f);
  // 0 to 90 degrees about z, the second key negated: the same rotation on the other side of the sphere.
  tiny.animate(0, "rotation", "LINEAR", {0, 1}, {0, 0, 0, 1, 0, 0, -c, -c});
  const Gltf gltf = read(tiny);
  for (const double t : {0.0, 0.1, 0.3, 0.5, 0.9, 1.0}) {
    const Vec3 p = posedAt(gltf, t)[1];
    EXPECT_LE(apart(p, {std::cos(t * kPi / 2), std::sin(t * kPi / 2), 0}), 1e-7) << t;
  }
}

TEST(Gltf, MorphTargetsAddUpWithTheirAnimatedWeights) {
  TinyGltf tiny = TinyGltf::triangle();
  const int up = tiny.floats("VEC3", {0, 0, 1, 0, 0, 1, 0, 0, 1}),
            out = tiny.floats("VEC3", {0, 0, 0, 1, 0, 0, 0, 0, 0});
  tiny.json["meshes"][0]["primitives"][0]["targets"] = {{{"POSITION", up}}, {{"POSITION", out}}};
  tiny.json["meshes"][0]["weights"] = {0.5, 0};
  EXPECT_EQ(posedAt(read(tiny), 0)[1], (Vec3{1, 0, 0.5}));
  tiny.animate(0, "weights", "LINEAR", {0, 1}, {1, 0, 0, 2});
  EXPECT_EQ(posedAt(read(tiny), 0)[1], (Vec3{1, 0, 1}));
  EXPECT_EQ(posedAt(read(tiny), 0.5)[1], (Vec3{2, 0, 0.5}));
}

TEST(Gltf, SkinFollowsItsJointsAndNotItsOwnNode) {
  TinyGltf tiny = TinyGltf::skinned();
  tiny.json["nodes"][0]["translation"] = {7, 7, 7};  // without effect on a skinned mesh
  tiny.json["nodes"][1]["translation"] = {0, 0, 3};
  const float c = std::sqrt(0.5f);
  tiny.animate(2, "rotation", "LINEAR", {0, 1}, {0, 0, 0, 1, 0, 0, c, c});
  const Gltf gltf = read(tiny);
  EXPECT_LE(apart(posedAt(gltf, 0)[1], {1, 0, 3}), 1e-12);
  // The third vertex is the joint's own place: turning leaves it there. Moved off it, it turns.
  EXPECT_LE(apart(posedAt(gltf, 1)[2], {0, 1, 3}), 1e-7);
  TinyGltf further = tiny;
  const float far[3] = {0, 2, 0};
  std::memcpy(&further.bytes[6 * sizeof(float)], far, sizeof far);
  EXPECT_LE(apart(posedAt(read(further), 1)[2], {-1, 1, 3}), 1e-6);
}

TEST(Gltf, NormalizedStridedAndSparseAccessorsAreRead) {
  TinyGltf tiny = TinyGltf::skinned();
  Json& attributes = tiny.json["meshes"][0]["primitives"][0]["attributes"];
  // Weights as bytes that sum to 254: made to sum to 1.
  const int weights = tiny.add<std::uint8_t>("VEC4", 5121, {254, 0, 0, 0, 127, 127, 0, 0, 254, 0, 0, 0});
  tiny.json["accessors"][weights]["normalized"] = true;
  attributes["WEIGHTS_0"] = weights;
  // Positions 20 bytes apart.
  std::vector<float> spread;
  for (const float x : {0.f, 1.f, 0.f}) spread.insert(spread.end(), {x, 0, 0, -1, -1});
  attributes["POSITION"] = tiny.floats("VEC3", spread);
  tiny.json["accessors"].back()["count"] = 3;
  tiny.json["bufferViews"].back()["byteStride"] = 20;
  // The third is put right by a sparse accessor.
  const int where = tiny.view(std::vector<std::uint16_t>{2}), what = tiny.view(std::vector<float>{0, 1, 0});
  tiny.json["accessors"].back()["sparse"] = {
      {"count", 1}, {"indices", {{"bufferView", where}, {"componentType", 5123}}}, {"values", {{"bufferView", what}}}};
  tiny.animate(1, "translation", "STEP", {0}, {0, 0, 4});
  const auto p = posedAt(read(tiny), 0);
  EXPECT_LE(apart(p[1], {1, 0, 4}), 1e-12);
  EXPECT_LE(apart(p[2], {0, 1, 4}), 1e-12);
}

TEST(Gltf, SeveralPrimitivesAreOneMeshAndStripsTurn) {
  TinyGltf tiny = TinyGltf::triangle();
  Json& primitives = tiny.json["meshes"][0]["primitives"];
  const int quad = tiny.floats("VEC3", {0, 0, 0, 1, 0, 0, 0, 1, 0, 1, 1, 0});
  primitives.push_back({{"attributes", {{"POSITION", quad}}}, {"mode", 5}});
  primitives.push_back({{"attributes", {{"POSITION", quad}}},
                        {"indices", tiny.add<std::uint8_t>("SCALAR", 5121, {0, 1, 3, 2})},
                        {"mode", 6}});
  const GltfMesh mesh = read(tiny).meshes[0];
  ASSERT_EQ(mesh.positions.size(), 11u);
  ASSERT_EQ(mesh.triangles.size(), 5u);
  for (const auto& [a, b, c] : mesh.triangles)  // all seen counter-clockwise from +z
    EXPECT_GT(cross(mesh.positions[b] - mesh.positions[a], mesh.positions[c] - mesh.positions[a]).z, 0);
}

TEST(Gltf, BinaryAndTextFilesHoldTheSame) {
  TinyGltf tiny = TinyGltf::skinned();
  tiny.animate(2, "translation", "LINEAR", {0, 2}, {0, 1, 0, 4, 1, 0});
  const test::TemporaryFolder folder;
  const auto bytes = tiny.binary();
  writeBinaryFile(folder / "tiny.glb", bytes.data(), bytes.size());
  // And with its buffer in a file beside it, whose name has a space.
  writeBinaryFile(folder / "the data.bin", tiny.bytes.data(), tiny.bytes.size());
  Json beside = tiny.json;
  beside["buffers"] = {{{"byteLength", tiny.bytes.size()}, {"uri", "the%20data.bin"}}};
  writeTextFile(folder / "beside.gltf", beside.dump());
  const auto expected = posedAt(read(tiny), 1);
  EXPECT_EQ(posedAt(readGltf(folder / "tiny.glb"), 1), expected);
  EXPECT_EQ(posedAt(readGltf(folder / "beside.gltf"), 1), expected);
}

TEST(Gltf, NamesChooseAndWrongOnesAreListed) {
  TinyGltf tiny = TinyGltf::triangle();
  tiny.json["nodes"].push_back({{"name", "second"}, {"mesh", 0}});
  tiny.animate(0, "translation", "STEP", {0}, {0, 0, 0});
  tiny.animate(0, "translation", "STEP", {0}, {0, 0, 1});
  tiny.json["animations"][0]["name"] = "walk";
  tiny.json["animations"][1]["name"] = "run";
  const Gltf gltf = read(tiny);
  EXPECT_EQ(gltf.meshNode("second", "x"), 1);
  EXPECT_EQ(gltf.animation("run", "x"), &gltf.animations[1]);
  const auto what = [](const auto& call) -> std::string {
    try {
      call();
    } catch (const Error& e) {
      return e.what();
    }
    return "";
  };
  EXPECT_NE(what([&] { gltf.animation("", "x"); }).find("'walk', 'run'"), std::string::npos);
  EXPECT_NE(what([&] { gltf.animation("wakl", "x"); }).find("did you mean 'walk'"), std::string::npos);
  EXPECT_NE(what([&] { gltf.meshNode("part", "x"); }).find("fits 2"), std::string::npos);
  EXPECT_NE(what([&] { gltf.cameraNode("", "x"); }).find("no camera"), std::string::npos);
}

// --- Hostile files --------------------------------------------------------------------------------------------------

TEST(GltfHostile, EachFaultIsRefusedWhereItStands) {
  const auto expect = [](const std::function<void(TinyGltf&)>& harm, const std::string& where,
                         const std::string& what) {
    TinyGltf tiny = TinyGltf::skinned();
    tiny.animate(1, "translation", "LINEAR", {0, 1}, {0, 0, 0, 1, 0, 0});
    tiny.json["meshes"][0]["primitives"][0]["indices"] = tiny.add<std::uint16_t>("SCALAR", 5123, {0, 1, 2});
    harm(tiny);
    const std::string said = refusal(tiny.text());
    EXPECT_NE(said.find(where), std::string::npos) << "expected " << where << ", said: " << said;
    EXPECT_NE(said.find(what), std::string::npos) << "expected " << what << ", said: " << said;
  };
  // Accessors 0 POSITION, 1 JOINTS_0, 2 WEIGHTS_0, 3 MAT4, 4 times, 5 values, 6 indices; each with its own view.
  using T = TinyGltf;
  expect([](T& t) { t.json["asset"]["version"] = "1.0"; }, "/asset/version", "expected 2.0");
  expect([](T& t) { t.json["extensionsRequired"] = {"KHR_draco_mesh_compression"}; }, "/extensionsRequired/0",
         "does not read");
  expect([](T& t) { t.json["accessors"][0]["count"] = 4; }, "/accessors/0", "beyond the end of its buffer view");
  expect([](T& t) { t.json["accessors"][0]["count"] = -1; }, "/accessors/0/count", "-1");
  expect([](T& t) { t.json["accessors"][0]["count"] = 1e18; }, "/accessors/0/count", "");
  expect([](T& t) { t.json["accessors"][0]["count"] = 2147483647; }, "/accessors/0/count", "simplify");
  expect(
      [](T& t) {
        t.json["accessors"][0].erase("bufferView");
        t.json["accessors"][0]["count"] = 100000000;
      },
      "/accessors/0/count", "simplify");
  expect([](T& t) { t.json["accessors"][0]["byteOffset"] = 4; }, "/accessors/0", "beyond the end");
  expect([](T& t) { t.json["accessors"][0]["byteOffset"] = 9223372036854775807; }, "/accessors/0", "beyond the end");
  expect([](T& t) { t.json["accessors"][0]["componentType"] = 5124; }, "/accessors/0/componentType", "5124");
  expect([](T& t) { t.json["accessors"][0]["type"] = "VEC2"; }, "/accessors/0/type", "expected VEC3");
  expect([](T& t) { t.json["accessors"][0]["bufferView"] = 99; }, "/accessors/0/bufferView", "99");
  expect([](T& t) { t.json["bufferViews"][0]["byteLength"] = 1e9; }, "/bufferViews/0", "");
  expect([](T& t) { t.json["bufferViews"][0]["byteLength"] = 1000000; }, "/bufferViews/0", "beyond its buffer");
  expect([](T& t) { t.json["bufferViews"][0]["byteOffset"] = 9223372036854775807; }, "/bufferViews/0", "beyond its");
  expect([](T& t) { t.json["bufferViews"][0]["byteStride"] = 8; }, "/bufferViews/0/byteStride", "at least the 12");
  expect([](T& t) { t.json["bufferViews"][0]["byteStride"] = 0; }, "/bufferViews/0/byteStride", "0");
  expect([](T& t) { t.json["bufferViews"][0]["buffer"] = 1; }, "/bufferViews/0/buffer", "1");
  expect(
      [](T& t) {
        t.json["accessors"][6]["componentType"] = 5126;
        t.json["accessors"][6]["count"] = 1;
      },
      "/accessors/6/componentType", "whole");
  expect([](T& t) { t.json["accessors"][1]["count"] = 2; }, "JOINTS_0", "POSITION has 3");
  expect(
      [](T& t) {
        const float nan = NAN;
        std::memcpy(&t.bytes[0], &nan, 4);
      },
      "/accessors/0", "not finite");
  const auto sparse = [](T& t, std::uint16_t index) {
    const int where = t.view(std::vector<std::uint16_t>{index}), values = t.view(std::vector<float>{0, 0, 0});
    t.json["accessors"][0]["sparse"] = {{"count", 1},
                                        {"indices", {{"bufferView", where}, {"componentType", 5123}}},
                                        {"values", {{"bufferView", values}}}};
  };
  expect([&](T& t) { sparse(t, 3); }, "/accessors/0/sparse/indices", "has 3 elements");
  expect(
      [&](T& t) {
        sparse(t, 0);
        t.json["accessors"][0]["sparse"]["count"] = 2;
      },
      "/sparse", "beyond the end");
  expect([](T& t) { t.bytes[t.bytes.size() - 2] = std::byte{9}; }, "/accessors/6", "has 3 vertices");
  // Nodes.
  expect([](T& t) { t.json["nodes"][2]["children"] = {1}; }, "/nodes", "own descendants");
  expect([](T& t) { t.json["nodes"][0]["children"] = {0}; }, "/nodes", "own descendants");
  expect([](T& t) { t.json["nodes"][0]["children"] = {2}; }, "/nodes/1/children/0", "already the child of node 0");
  expect([](T& t) { t.json["nodes"][0]["children"] = {99}; }, "/nodes/0/children/0", "99");
  expect([](T& t) { t.json["nodes"][0]["mesh"] = 1; }, "/nodes/0/mesh", "1");
  expect([](T& t) { t.json["nodes"][0]["rotation"] = {0, 0, 0, 0}; }, "/nodes/0/rotation", "length 0");
  expect([](T& t) { t.json["nodes"][0]["matrix"] = {1, 0, 0, 1, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1}; },
         "/nodes/0/matrix", "last row");
  // Skins.
  expect([](T& t) { t.json["skins"][0]["joints"] = {1}; }, "/nodes/0/skin", "follows joint 1, the skin has 1");
  expect([](T& t) { t.json["skins"][0]["joints"] = {1, 2, 0}; }, "/skins/0/inverseBindMatrices", "2 matrices for 3");
  expect([](T& t) { t.json["skins"][0]["joints"] = {1, 3}; }, "/skins/0/joints/1", "3");
  // Animations.
  expect(
      [](T& t) {
        const float back[2] = {1, 1};
        std::memcpy(&t.bytes[t.json["bufferViews"][4]["byteOffset"]], back, 8);
      },
      "/accessors/4", "times must rise");
  expect([](T& t) { t.json["animations"][0]["samplers"][0]["interpolation"] = "CUBICSPLINE"; },
         "/animations/0/samplers/0/output", "expected 18");
  expect([](T& t) { t.json["animations"][0]["samplers"][0]["interpolation"] = "cubic"; }, "/interpolation", "'STEP'");
  expect([](T& t) { t.json["animations"][0]["channels"][0]["sampler"] = 5; }, "/channels/0/sampler", "5");
  expect([](T& t) { t.json["animations"][0]["channels"][0]["target"]["node"] = 5; }, "/target/node", "5");
  expect([](T& t) { t.json["animations"][0]["channels"][0]["target"]["path"] = "weights"; }, "/target/node", "morph");
  expect([](T& t) { t.json["animations"][0]["channels"].push_back(t.json["animations"][0]["channels"][0]); },
         "/channels/1/target", "twice");
  expect([](T& t) { t.json["nodes"][1]["matrix"] = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1}; }, "/target/node",
         "matrix");
}

TEST(GltfHostile, BuffersComeFromBesideTheFileAlone) {
  for (const std::string uri : {"/dev/zero", "/etc/passwd", "http://example.org/a.bin", "file:///etc/passwd",
                                "missing.bin", "data:;base64,@@@@", "data:text/plain,abc", "%00", "."}) {
    TinyGltf tiny;
    tiny.json["buffers"] = {{{"byteLength", 4}, {"uri", uri}}};
    EXPECT_NE(refusal(tiny.text()).find("/buffers/0/uri"), std::string::npos) << uri << ": " << refusal(tiny.text());
  }
}

TEST(GltfHostile, DeepChainsOfNodesNeedNoStack) {
  TinyGltf tiny = TinyGltf::triangle();
  constexpr int kDeep = 20000;
  for (int i = 0; i < kDeep; ++i)
    tiny.json["nodes"][i]["children"] = {i + 1}, tiny.json["nodes"].push_back({{"translation", {0, 0, 1}}});
  const Gltf gltf = read(tiny);
  EXPECT_EQ(poseAt(gltf, nullptr, 0).world[kDeep].translation.z, kDeep);
}

TEST(GltfHostile, DamagedFilesEndInAnErrorOrAResult) {
  TinyGltf tiny = TinyGltf::skinned();
  tiny.animate(2, "rotation", "CUBICSPLINE", {0, 1}, std::vector<float>(24, 0.5f));
  const std::vector<std::byte> whole = tiny.binary();
  const test::TemporaryFolder folder;
  std::mt19937 random(7);
  int refused = 0;
  constexpr int kTries = 800;
  for (int i = 0; i < kTries; ++i) {
    std::vector<std::byte> bytes = whole;
    if (i % 4 == 0) bytes.resize(random() % bytes.size());
    for (unsigned k = 0; !bytes.empty() && k < 1 + random() % 4; ++k) {
      std::byte& hit = bytes[random() % bytes.size()];
      // In the text digits become other digits: what parses and lies.
      hit = hit >= std::byte{'0'} && hit <= std::byte{'9'} ? static_cast<std::byte>('0' + random() % 10)
                                                           : static_cast<std::byte>(random() % 256);
    }
    std::ofstream(folder / "hit.glb", std::ios::binary)  // without the wait for the disk
        .write(reinterpret_cast<const char*>(bytes.data()), static_cast<std::streamsize>(bytes.size()));
    try {
      const Gltf gltf = readGltf(folder / "hit.glb");
      for (std::size_t n = 0; n < gltf.nodes.size(); ++n)
        for (const double t : {-1.0, 0.3, 5.0})
          if (gltf.nodes[n].mesh >= 0)
            posedMesh(gltf, static_cast<int>(n),
                      poseAt(gltf, gltf.animations.empty() ? nullptr : &gltf.animations[0], t));
    } catch (const Error&) {
      ++refused;
    }
  }
  EXPECT_GT(refused, kTries / 4);
  EXPECT_LT(refused, kTries);
}

}  // namespace
}  // namespace srf
