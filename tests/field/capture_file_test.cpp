#include "field/capture_file.h"

#include <gtest/gtest.h>

#include <nlohmann/json.hpp>

#include "base/files.h"
#include "base/json.h"
#include "base/numeric.h"
#include "tests/support/test_support.h"

namespace srf {
namespace {

namespace fs = std::filesystem;

Json identityPose(double z = 3) {
  return {{1, 0, 0, 0}, {0, 1, 0, 0}, {0, 0, 1, z}, {0, 0, 0, 1}};
}

/// Two views under two lights.
Json sample() {
  Json root = Json::parse(R"({
    "camera_model": "OPENCV", "w": 64, "h": 48, "fl_x": 100, "fl_y": 101, "cx": 32, "cy": 24, "k1": 0.01,
    "lights": [{"name": "A", "type": "directional", "direction": [0, 0, 2], "irradiance": [1, 2, 3]},
               {"name": "B", "type": "point", "position": [0, 1, 2], "intensity": [4, 4, 4]}], "frames": []})");
  for (const char* view : {"v0", "v1"})
    for (const char* light : {"A", "B"})
      root["frames"].push_back({{"file_path", std::string(view) + light + ".exr"},
                                {"mask_path", std::string(view) + ".png"},
                                {"view", view},
                                {"light", light},
                                {"transform_matrix", identityPose(view == std::string("v0") ? 3 : 4)}});
  return root;
}

class CaptureFile : public testing::Test {
 protected:
  Capture read(const Json& root) const {
    writeTextFile(folder_ / "transforms.json", root.dump());
    return readCapture(folder_.path());
  }
  void expectRefused(const Json& root, const std::vector<std::string>& parts) const {
    try {
      read(root);
      ADD_FAILURE() << "accepted; expected an error with " << parts.front();
    } catch (const Error& e) {
      EXPECT_EQ(e.kind(), ErrorKind::bad_input);
      EXPECT_NE(std::string(e.what()).find("transforms.json"), std::string::npos) << e.what();
      for (const auto& part : parts) EXPECT_NE(std::string(e.what()).find(part), std::string::npos) << e.what();
    }
  }
  test::TemporaryFolder folder_;
};

TEST_F(CaptureFile, ViewsLightsAndPhotosAreRead) {
  const Capture c = read(sample());
  ASSERT_EQ(c.views.size(), 2u);
  ASSERT_EQ(c.lights.size(), 2u);
  EXPECT_EQ(c.views[1].name, "v1");
  EXPECT_EQ(c.views[1].photos.size(), 2u);
  EXPECT_EQ(c.views[1].photos[1].light->value, 1u);
  EXPECT_EQ(c.views[1].photos[1].file, folder_ / "v1B.exr");
  EXPECT_EQ(c.views[1].mask_file, folder_ / "v1.png");
  EXPECT_EQ(c.lights[0].direction.raw(), (Vec3{0, 0, 1}));
  EXPECT_EQ(c.lights[0].strength, (Vec3{1, 2, 3}));
  EXPECT_EQ(c.lights[1].kind, LightKind::point);
  EXPECT_EQ(c.views[0].camera.lens.k1, 0.01);
  EXPECT_EQ(c.views[0].camera.lens.model, CameraModel::opencv);
  EXPECT_EQ(c.integer_transfer, Transfer::srgb);
  EXPECT_FALSE(c.bounds);
}

TEST_F(CaptureFile, OpenGlCameraAtPlusZLooksAtTheOrigin) {
  const auto camera = read(sample()).views[0].camera;
  EXPECT_EQ(camera.center().raw(), (Vec3{0, 0, 3}));
  EXPECT_EQ(camera.forward().raw(), (Vec3{0, 0, -1}));
  const auto up = camera.project(Point<AcquisitionSpace>(0.1, 0.2, 0));
  ASSERT_TRUE(up);
  EXPECT_GT(up->pixel.x, 32);  // x to the right, y upwards in the picture
  EXPECT_LT(up->pixel.y, 24);
}

TEST_F(CaptureFile, AFramesOwnIntrinsicsWin) {
  Json root = sample();
  for (int f : {2, 3}) root["frames"][f].update({{"fl_x", 200}, {"k1", 0}, {"w", 32}});
  const Capture c = read(root);
  EXPECT_EQ(c.views[0].camera.lens.fl_x, 100);
  EXPECT_EQ(c.views[1].camera.lens.fl_x, 200);
  EXPECT_EQ(c.views[1].camera.lens.k1, 0);
  EXPECT_EQ(c.views[1].camera.lens.width, 32);
  EXPECT_EQ(c.views[1].camera.lens.height, 48);
}

TEST_F(CaptureFile, NerfstyleSetIsACaptureOfOneUnknownLight) {
  // As the Blender sets are: an angle, no sizes, no extensions, many poses.
  writePng(folder_ / "r_0.png", Image8(20, 10, 3));
  writePng(folder_ / "r_1.png", Image8(20, 10, 3));
  Json root{{"camera_angle_x", 0.6911112070083618}, {"aabb_scale", 4}, {"frames", Json::array()}};
  for (int i = 0; i < 2; ++i)
    root["frames"].push_back(
        {{"file_path", "./r_" + std::to_string(i)}, {"rotation", 0.01}, {"transform_matrix", identityPose(3 + i)}});
  writeTextFile(folder_ / "transforms_train.json", root.dump());
  const Capture c = readCapture(folder_ / "transforms_train.json");
  ASSERT_EQ(c.views.size(), 2u);
  EXPECT_TRUE(c.unknownIllumination());
  EXPECT_EQ(c.lights[0].name, "captured");
  EXPECT_EQ(c.views[0].name, "r_0");
  EXPECT_EQ(c.views[0].photos[0].file, folder_ / "r_0.png");
  EXPECT_EQ(c.views[0].photos[0].light, LightId{0});
  const Intrinsics& lens = c.views[0].camera.lens;
  EXPECT_EQ(lens.width, 20);
  EXPECT_EQ(lens.height, 10);
  EXPECT_NEAR(2 * std::atan(0.5 * 20 / lens.fl_x), 0.6911112070083618, 1e-15);
  EXPECT_EQ(lens.fl_y, lens.fl_x);
  EXPECT_EQ(lens.cx, 10);
  EXPECT_EQ(lens.model, CameraModel::pinhole);
}

TEST_F(CaptureFile, KeysOfOtherToolsAreAccepted) {
  Json root = sample();
  root["applied_transform"] = {{1, 0, 0, 0}, {0, 1, 0, 0}, {0, 0, 1, 0}};
  for (const char* key : {"aabb_scale", "ply_file_path", "orientation_override", "scale", "offset", "train_filenames",
                          "camera_angle_x", "camera_angle_y", "n_extra_learnable_dims"})
    root[key] = 1;
  for (const char* key : {"sharpness", "colmap_im_id", "depth_file_path"}) root["frames"][0][key] = 1;
  EXPECT_EQ(read(root).views.size(), 2u);
}

TEST_F(CaptureFile, WithoutNamesFramesOfEqualPoseAreOneView) {
  Json root = sample();
  for (Json& frame : root["frames"]) frame.erase("view");
  const Capture c = read(root);
  ASSERT_EQ(c.views.size(), 2u);
  EXPECT_EQ(c.views[0].photos.size(), 2u);
  EXPECT_EQ(c.views[0].name, "v0A");
}

TEST_F(CaptureFile, AFrameWithoutALightIsASilhouetteAlone) {
  Json root = sample();
  root["frames"][3].erase("light");
  root["frames"][3]["view"] = "v2";
  const Capture c = read(root);
  ASSERT_EQ(c.views.size(), 3u);
  EXPECT_FALSE(c.views[2].photos[0].light);
}

TEST_F(CaptureFile, PointLightsOfFramesAreSharedWhereEqual) {
  Json root = sample();
  root.erase("lights");
  for (int f = 0; f < 4; ++f) {
    root["frames"][f].erase("light");
    root["frames"][f]["pl_pos"] = {0, f % 2, 2};
    if (f % 2) root["frames"][f]["pl_intensity"] = 5;
  }
  const Capture c = read(root);
  ASSERT_EQ(c.lights.size(), 2u);
  EXPECT_EQ(c.lights[1].position.raw(), (Vec3{0, 1, 2}));
  EXPECT_EQ(c.lights[1].strength, (Vec3{5, 5, 5}));
  EXPECT_EQ(c.lights[0].strength, (Vec3{1, 1, 1}));
  EXPECT_EQ(c.views[1].photos[1].light->value, 1u);
}

TEST_F(CaptureFile, ColourSpaceTellsWhatIntegersMean) {
  Json root = sample();
  root["color_space"] = "lin_rec709";
  EXPECT_EQ(read(root).integer_transfer, Transfer::linear);
  root["color_space"] = "srgb";
  EXPECT_EQ(read(root).integer_transfer, Transfer::srgb);
  root["color_space"] = "ACEScg";
  expectRefused(root, {"/color_space", "ACEScg", "lin_rec709"});
}

TEST_F(CaptureFile, BoundsAreRead) {
  Json root = sample();
  root["aabb"] = {{-1, -2, -3}, {1, 2, 3}};
  EXPECT_EQ(read(root).bounds->min, (Vec3{-1, -2, -3}));
  root["aabb"] = {{-1, -2, -3}, {1, -2, 3}};
  expectRefused(root, {"/aabb"});
}

TEST_F(CaptureFile, PoseOfFewDigitsBecomesARotation) {
  Json root = sample();
  const double c = 0.8660, s = 0.5;
  for (int f : {0, 1})
    root["frames"][f]["transform_matrix"] = {{c, 0, s, 1}, {0, 1, 0, 2}, {-s, 0, c, 3}, {0, 0, 0, 1}};
  const Mat3 r = read(root).views[0].camera.pose.rotation().raw();
  const Mat3 product = r.transposed() * r;
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) EXPECT_NEAR(product.row[i][j], i == j, 1e-15);
  EXPECT_NEAR(r.row[0][0], std::cos(radians(30)), 1e-4);
}

TEST_F(CaptureFile, RejectsPosesThatAreNotRigid) {
  const auto with = [](const Json& matrix) {
    Json root = sample();
    root["frames"][2]["transform_matrix"] = matrix;
    return root;
  };
  const std::string where = "/frames/2/transform_matrix";
  expectRefused(with({{1, 0, 0, 0}, {0, 0, 0, 0}, {0, 0, 1, 3}, {0, 0, 0, 1}}), {where, "singular"});
  expectRefused(with({{2, 0, 0, 0}, {0, 2, 0, 0}, {0, 0, 2, 3}, {0, 0, 0, 1}}), {where, "scales by 2"});
  expectRefused(with({{-1, 0, 0, 0}, {0, 1, 0, 0}, {0, 0, 1, 3}, {0, 0, 0, 1}}), {where, "mirrors"});
  expectRefused(with({{1, 0.1, 0, 0}, {0, 1, 0, 0}, {0, 0, 1, 3}, {0, 0, 0, 1}}), {where, "not a rotation"});
  expectRefused(with({{1, 0, 0, 0}, {0, 1, 0, 0}, {0, 0, 1, 3}, {0, 0, 0, 2}}), {where + "/3", "[0, 0, 0, 1]"});
  expectRefused(with({{1, 0, 0}, {0, 1, 0}, {0, 0, 1}}), {where + "/0", "4 numbers"});
  expectRefused(with({1, 2}), {where, "4x4"});
}

TEST_F(CaptureFile, RejectsWhatIsMissingOrOfTheWrongType) {
  Json root = sample();
  root["frames"][1].erase("transform_matrix");
  expectRefused(root, {"/frames/1", "'transform_matrix' is missing"});
  root = sample();
  root["frames"][1].erase("file_path");
  expectRefused(root, {"/frames/1", "'file_path' is missing"});
  root = sample();
  root.erase("frames");
  expectRefused(root, {"'frames' is missing"});
  root = sample();
  root["frames"] = Json::array();
  expectRefused(root, {"/frames", "is empty"});
  root = sample();
  root.erase("fl_x");
  root.erase("fl_y");
  expectRefused(root, {"/frames/0", "focal length"});
  root = sample();
  root["w"] = 0;
  expectRefused(root, {"/w", "found 0"});
  root = sample();
  root["fl_x"] = -3;
  expectRefused(root, {"/fl_x", "-3", "above 0"});
  root = sample();
  root["camera_model"] = "EQUIRECTANGULAR";
  expectRefused(root, {"/camera_model", "EQUIRECTANGULAR", "PINHOLE"});
  root = sample();
  root["k4"] = 0.5;
  expectRefused(root, {"/k4", "OPENCV"});
  expectRefused(Json::array({1}), {"expected an object"});
}

TEST_F(CaptureFile, RejectsUnknownKeysNamingTheNearest) {
  Json root = sample();
  root["frames"][3]["mask_pth"] = "x.png";
  expectRefused(root, {"/frames/3/mask_pth", "did you mean 'mask_path'"});
  root = sample();
  root["ligths"] = 1;
  expectRefused(root, {"/ligths", "did you mean 'lights'"});
  root = sample();
  root["lights"][0]["iradiance"] = 1;
  expectRefused(root, {"/lights/0/iradiance", "did you mean 'irradiance'"});
}

TEST_F(CaptureFile, RejectsLightsThatCannotShine) {
  Json root = sample();
  root["lights"][0]["direction"] = {0, 0, 0};
  expectRefused(root, {"/lights/0/direction", "length"});
  root = sample();
  root["lights"][0]["irradiance"] = {-1, 0, 0};
  expectRefused(root, {"/lights/0/irradiance"});
  root = sample();
  root["lights"][1]["name"] = "A";
  expectRefused(root, {"/lights/1/name", "twice"});
  root = sample();
  root["lights"][1]["direction"] = {0, 0, 1};
  expectRefused(root, {"/lights/1/direction", "point"});
  root = sample();
  root["lights"][0]["type"] = "sun";
  expectRefused(root, {"/lights/0/type", "sun", "directional"});
  root = sample();
  root["frames"][0]["light"] = "AA";
  expectRefused(root, {"/frames/0/light", "'AA'", "did you mean 'A'"});
  root = sample();
  root["lights"].push_back(root["lights"][0]);
  root["lights"][2]["name"] = "idle";
  expectRefused(root, {"/lights/2", "'idle'", "no frames"});
}

TEST_F(CaptureFile, RejectsViewsThatContradictThemselves) {
  Json root = sample();
  root["frames"][1]["transform_matrix"] = identityPose(3.1);
  expectRefused(root, {"/frames/1", "another pose", "'v0'"});
  root = sample();
  root["frames"][1]["light"] = "A";
  expectRefused(root, {"/frames/1", "second photograph", "'v0'", "'A'"});
  root = sample();
  root["frames"][1]["mask_path"] = "other.png";
  expectRefused(root, {"/frames/1/mask_path", "one mask"});
}

TEST_F(CaptureFile, RejectsPathsWithoutAFileBeside) {
  Json root = sample();
  root["frames"][0]["file_path"] = "nothing";
  expectRefused(root, {"/frames/0/file_path", "nothing", ".png"});
}

TEST_F(CaptureFile, WhatIsWrittenIsReadBackToTheBit) {
  Json root = sample();
  root["units"] = "mm";
  root["aabb"] = {{-1, -2, -3}, {1, 2, 3.5}};
  root["lights"][0]["direction"] = {0.1, -0.7, 0.3};
  const Mat3 r = rotationAbout(normalize(Vector<AcquisitionSpace>(1, 2, 3))->raw(), 1.1);
  for (int f : {2, 3}) {
    Json rows = Json::array();
    for (int i = 0; i < 3; ++i) rows.push_back({r.row[i][0], r.row[i][1], r.row[i][2], 0.1 * i});
    rows.push_back({0, 0, 0, 1});
    root["frames"][f].update({{"transform_matrix", rows}, {"skew", 0.25}});
  }
  const Capture a = read(root);
  const test::TemporaryFolder other;
  writeCapture(other / "deep", a);
  const Capture b = readCapture(other / "deep");
  EXPECT_EQ(b.units, "mm");
  EXPECT_EQ(b.bounds->max, a.bounds->max);
  EXPECT_EQ(b.lights[0].direction, a.lights[0].direction);
  ASSERT_EQ(b.views.size(), a.views.size());
  for (std::size_t v = 0; v < a.views.size(); ++v) {
    EXPECT_EQ(b.views[v].name, a.views[v].name);
    EXPECT_EQ(b.views[v].camera.lens, a.views[v].camera.lens);
    EXPECT_EQ(b.views[v].camera.pose.rotation().raw(), a.views[v].camera.pose.rotation().raw());
    EXPECT_EQ(b.views[v].camera.pose.origin(), a.views[v].camera.pose.origin());
    EXPECT_EQ(fs::weakly_canonical(b.views[v].photos[1].file), fs::weakly_canonical(a.views[v].photos[1].file));
    EXPECT_EQ(b.views[v].photos[1].light, a.views[v].photos[1].light);
  }
}

TEST_F(CaptureFile, ThousandsOfFramesAreRead) {
  SRF_REQUIRE_DATA(data, "capsule/capture");
  const Capture c = readCapture(data);
  EXPECT_EQ(c.views.size(), 48u);
  EXPECT_EQ(c.lights.size(), 64u);
  for (const CaptureView& view : c.views) EXPECT_EQ(view.photos.size(), 64u);
}

}  // namespace
}  // namespace srf
