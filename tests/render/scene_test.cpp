#include "render/scene.h"

#include <gtest/gtest.h>

#include "base/error.h"
#include "base/files.h"
#include "base/numeric.h"
#include "render/light_set.h"
#include "tests/model/tiny_gltf.h"
#include "tests/support/test_support.h"

namespace srf {
namespace {

const std::string kCamera = R"("camera": {"w": 64, "h": 48, "vfov": 40,
  "look_at": {"eye": [0, -3, 0], "target": [0, 0, 0], "up": [0, 0, 1]}})";
const std::string kLights = R"("lights": [{"type": "directional", "direction": [0, 0, 2], "irradiance": [1, 2, 3]}])";

class SceneTest : public testing::Test {
 protected:
  Scene read(const std::string& keys, const std::vector<std::string>& overrides = {}) {
    const auto file = folder_ / "scene.json";
    writeTextFile(file, "{" + keys + "}");
    return readScene(file, overrides, Reporter::silent());
  }
  /// The message of the refusal; empty where the scene is taken.
  std::string refusal(const std::string& keys, const std::vector<std::string>& overrides = {}) {
    try {
      read(keys, overrides);
    } catch (const Error& e) {
      EXPECT_NE(e.kind(), ErrorKind::failed);
      return e.what();
    }
    return "";
  }
  test::TemporaryFolder folder_;
};

#define EXPECT_REFUSED(message, ...)                                    \
  for (const std::string& part : std::vector<std::string>{__VA_ARGS__}) \
  EXPECT_NE(std::string(message).find(part), std::string::npos) << "'" << message << "' does not say " << part

TEST_F(SceneTest, DefaultsAreThoseOfTheFormat) {
  const Scene scene = read(kCamera + "," + kLights);
  EXPECT_TRUE(scene.srf.empty());
  EXPECT_EQ(scene.frames, std::vector<int>{0});
  EXPECT_EQ(scene.fps, 24);
  EXPECT_EQ(scene.samples, 1);
  EXPECT_EQ(scene.accuracy.views, 4);
  EXPECT_EQ(scene.accuracy.lights, 4);
  EXPECT_EQ(scene.accuracy.frame, FrameMode::bisector);
  EXPECT_EQ(scene.accuracy.min_distance, 1e-3);
  EXPECT_TRUE(scene.deformation.constant());
}

TEST_F(SceneTest, EveryKeyArrives) {
  writeTextFile(folder_ / "sky.exr", "only its presence is asked for here");
  const Scene scene =
      read(kCamera + R"(, "srf": "x.srf", "frames": "3-5", "fps": 30, "output": "a.####.exr", "samples": 4,
    "interpolation": "plain", "effects": {"shadows": "captured"},
    "accuracy": {"views": 6, "lights": 5, "frame": "polar", "light_sharing": 0, "min_distance": 0.01,
                 "shading": "sparse"},
    "deformation": [{"type": "twist", "axis": [0, 0, 1], "degrees_per_unit": {"keys": [[0, 0], [9, 90]]}}],
    "lights": [
      {"type": "point", "position": {"keys": [[0, [0, 0, 1]], [10, [0, 0, 3]]]}, "intensity": [1, 1, 1]},
      {"type": "environment", "map": "sky.exr", "rotation": {"keys": [[0, 0], [10, 90]]}, "samples": 16},
      {"type": "captured", "light": "L3", "scale": 0.5}])");
  EXPECT_EQ(scene.srf, folder_ / "x.srf");
  EXPECT_EQ(scene.frames, (std::vector<int>{3, 4, 5}));
  EXPECT_EQ(scene.fps, 30);
  EXPECT_EQ(scene.output, "a.####.exr");
  EXPECT_EQ(scene.samples, 4);
  EXPECT_EQ(scene.accuracy.views, 6);
  EXPECT_EQ(scene.accuracy.lights, 5);
  EXPECT_EQ(scene.accuracy.frame, FrameMode::polar);
  EXPECT_EQ(scene.accuracy.light_sharing, 0);
  EXPECT_EQ(scene.accuracy.min_distance, 0.01);
  EXPECT_EQ(scene.accuracy.shading, Shading::sparse);
  EXPECT_EQ(read(kCamera + "," + kLights + R"(, "accuracy": {"shading": "sparser"})").accuracy.shading,
            Shading::sparser);
  EXPECT_FALSE(scene.deformation.constant());
  ASSERT_EQ(scene.lights.size(), 3u);
  EXPECT_EQ(std::get<PointLight>(scene.lights[0]).position.at(5), (Vec3{0, 0, 2}));
  const auto& environment = std::get<EnvironmentLight>(scene.lights[1]);
  EXPECT_EQ(environment.map, folder_ / "sky.exr");
  EXPECT_EQ(environment.rotation.at(5), 45);
  EXPECT_EQ(environment.samples, 16);
  EXPECT_EQ(std::get<CapturedLight>(scene.lights[2]).light, "L3");
  EXPECT_EQ(std::get<CapturedLight>(scene.lights[2]).scale.at(0), 0.5);
}

TEST_F(SceneTest, DirectionsBecomeUnitVectors) {
  const Scene scene = read(kCamera + R"(, "lights": [{"type": "directional", "irradiance": [1, 1, 1],
    "direction": {"keys": [[0, [0, 0, 5]], [2, [0.1, 0, 0]]]}}])");
  const auto& light = std::get<DirectionalLight>(scene.lights[0]);
  EXPECT_EQ(light.direction.at(0), (Vec3{0, 0, 1}));
  EXPECT_EQ(light.direction.at(1), (Vec3{0.5, 0, 0.5})) << "keys of different lengths count alike";
}

TEST_F(SceneTest, RefusalsNameThePlaceAndTheMend) {
  const std::string both = kCamera + "," + kLights;
  EXPECT_REFUSED(refusal(kLights), "scene.json", "'camera' is missing");
  EXPECT_REFUSED(refusal(kCamera), "'lights' is missing");
  EXPECT_REFUSED(refusal(both + R"(, "sampels": 2)"), "/sampels", "'samples'");
  EXPECT_REFUSED(refusal(both + R"(, "samples": 0)"), "/samples", "from 1");
  EXPECT_REFUSED(refusal(both + R"(, "interpolation": "guide")"), "/interpolation", "'guided'");
  EXPECT_REFUSED(refusal(both + R"(, "interpolation": "guided", "effects": {"shadows": "both"})"), "/effects/shadows",
                 "plain interpolation", "\"deformed\"");
  EXPECT_REFUSED(refusal(both + R"(, "interpolation": "model", "effects": {"shadows": "both"})"), "/effects/shadows",
                 "plain interpolation", "\"deformed\"");
  EXPECT_REFUSED(refusal(both + R"(, "effects": {"matte": 1})"), "/effects/matte", "true or false");
  EXPECT_REFUSED(refusal(both + R"(, "effects": {"ground": {}})"), "/effects/ground", "'height'");
  EXPECT_REFUSED(refusal(both + R"(, "effects": {"ground": {"height": 0, "albedo": [0, 2, 0]}})"),
                 "/effects/ground/albedo/1", "from 0 to 1");
  EXPECT_REFUSED(refusal(both + R"(, "effects": {"motion_blur": {"shutter": -1}})"), "/effects/motion_blur/shutter",
                 "from 0");
  EXPECT_REFUSED(refusal(both + R"(, "effects": {"depth_of_field": {"aperture": 1}})"), "/effects/depth_of_field",
                 "'focus'");
  EXPECT_REFUSED(refusal(both + R"(, "effects": {"mate": true})"), "/effects/mate", "'matte'");
  EXPECT_REFUSED(refusal(both + R"(, "accuracy": {"shadow_rays": -1})"), "/accuracy/shadow_rays", "from 0");
  EXPECT_REFUSED(refusal(both + R"(, "accuracy": {"views": 0})"), "/accuracy/views", "from 1");
  EXPECT_REFUSED(refusal(both + R"(, "accuracy": {"shading": "half"})"), "/accuracy/shading", "'sparse'");
  EXPECT_REFUSED(refusal(both + R"(, "accuracy": {"min_distance": 0})"), "/accuracy/min_distance");
  EXPECT_REFUSED(refusal(both + R"(, "frames": "5-3")"), "/frames", "backwards");
  EXPECT_REFUSED(refusal(both + R"(, "frames": 1.5)"), "/frames", "whole number");
  EXPECT_REFUSED(refusal(both + R"(, "frames": [1, 2])"), "/frames", "string");
  const auto light = [&](const std::string& text) { return refusal(kCamera + R"(, "lights": [)" + text + "]"); };
  EXPECT_REFUSED(light(R"({"type": "directional", "direction": [0, 0, 0], "irradiance": [1, 1, 1]})"),
                 "/lights/0/direction", "length 0");
  EXPECT_REFUSED(light(R"({"type": "directional", "direction": {"keys": [[0, [1, 0, 0]], [4, [0, 0, 0]]]},
                           "irradiance": [1, 1, 1]})"),
                 "/lights/0/direction/keys/1/1", "length 0");
  EXPECT_REFUSED(light(R"({"type": "directional", "direction": [0, 0, 1], "irradiance": [1, -1, 1]})"),
                 "/lights/0/irradiance/1: found -1, expected a number of at least 0");
  EXPECT_REFUSED(light(R"({"type": "point", "position": [0, 0, 1],
                           "intensity": {"keys": [[0, [1, 1, 1]], [4, [0, 0, -2]]]}})"),
                 "/lights/0/intensity/keys/1/1/2: found -2");
  EXPECT_REFUSED(light(R"({"type": "captured", "scale": -0.5})"), "/lights/0/scale: found -0.5, expected",
                 "at least 0");
  EXPECT_REFUSED(light(R"({"type": "spot"})"), "/lights/0/type", "'environment'");
  EXPECT_REFUSED(light(R"({"type": "point", "position": [0, 0], "intensity": [1, 1, 1]})"), "/lights/0/position");
  EXPECT_REFUSED(light(R"({"type": "environment", "map": "missing.exr"})"), "/lights/0/map", "missing.exr");
  EXPECT_REFUSED(refusal(both + R"(, "deformation": [{"type": "skin", "file": "missing.glb"}])"),
                 "scene.json: /deformation/0/file", "missing.glb", "does not exist");
}

TEST_F(SceneTest, CamerasThatSeeNothingAreRefused) {
  const auto camera = [&](const std::string& text) { return R"("camera": {)" + text + "}," + kLights; };
  EXPECT_REFUSED(refusal(camera(R"("w": 9, "h": 9)")), "/camera", "look_at", "transform_matrix");
  EXPECT_REFUSED(refusal(camera(R"("w": 9, "h": 9, "vfov": 180,
    "look_at": {"eye": [0, 0, 1], "target": [0, 0, 0], "up": [1, 0, 0]})")),
                 "/camera/vfov", "180");
  EXPECT_REFUSED(refusal(camera(R"("w": 9, "h": 9, "vfov": 30, "fl_x": 9,
    "transform_matrix": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 3], [0, 0, 0, 1]],
    "look_at": {"eye": [0, 0, 1], "target": [0, 0, 0], "up": [1, 0, 0]})")),
                 "scene.json: /camera: has look_at and transform_matrix", "one of the two");
  EXPECT_REFUSED(refusal(camera(R"("w": 9, "h": 9, "gltf": {"file": "a.glb"},
    "look_at": {"eye": [0, 0, 1], "target": [0, 0, 0], "up": [1, 0, 0]})")),
                 "/camera: has look_at and gltf", "one of the two");
  EXPECT_REFUSED(refusal(camera(R"("w": 9, "h": 9, "vfov": 30, "cx": 4,
    "look_at": {"eye": [0, 0, 1], "target": [0, 0, 0], "up": [1, 0, 0]})")),
                 "/camera/cx: belongs to transform_matrix", "vfov beside look_at");
  const auto lookAtRefusal = [&](const std::string& eye, const std::string& up) -> std::string {
    const Scene scene = read(camera(R"("w": 9, "h": 9, "vfov": 30, "look_at": {"eye": )" + eye +
                                    R"(, "target": [0, 0, 0], "up": )" + up + "}"));
    try {
      scene.cameraAt(7);
    } catch (const Error& e) {
      return e.what();
    }
    return "";
  };
  EXPECT_EQ(lookAtRefusal("[0, 1, 0]", "[0, 0, 1]"), "");
  EXPECT_REFUSED(lookAtRefusal("[0, 0, 0]", "[0, 0, 1]"), "/camera/look_at", "same point", "frame 7");
  EXPECT_REFUSED(lookAtRefusal("[0, 0, 4]", "[0, 0, 1]"), "/camera/look_at", "parallel", "frame 7");
  EXPECT_REFUSED(lookAtRefusal(R"({"keys": [[0, [0, 0, 4]], [14, [0, 0, -4]]]})", "[0, 1, 0]"), "same point");
}

TEST_F(SceneTest, LookAtAndMatrixDescribeTheSameCamera) {
  const Scene look_at = read(kCamera + "," + kLights);
  // OpenGL's camera at (0, -3, 0): right +x, up +z, backwards -y.
  const Scene matrix = read(R"("camera": {"w": 64, "h": 48, "fl_x": 65.939458, "fl_y": 65.939458, "cx": 32, "cy": 24,
    "transform_matrix": [[1, 0, 0, 0], [0, 0, -1, -3], [0, 1, 0, 0], [0, 0, 0, 1]]},)" +
                            kLights);
  for (const Vec3& p : {Vec3{0.2, 0.1, 0.4}, Vec3{-0.5, 0.3, -0.2}}) {
    const auto a = look_at.cameraAt(0).project(Point<ObjectSpace>(p)),
               b = matrix.cameraAt(0).project(Point<ObjectSpace>(p));
    ASSERT_TRUE(a && b);
    EXPECT_NEAR(a->pixel.x, b->pixel.x, 1e-5);  // fl_x has six digits behind the point
    EXPECT_NEAR(a->pixel.y, b->pixel.y, 1e-5);
    EXPECT_GT((a->pixel.x - 32) * p.x, 0);
    EXPECT_LT((a->pixel.y - 24) * p.z, 0) << "+z is upwards in the picture";
  }
}

TEST_F(SceneTest, AMatrixCameraTakesAnAngleAsAFrameOfACaptureDoes) {
  const Scene scene = read(R"("camera": {"w": 64, "h": 48, "camera_angle_x": 1.5707963267948966,
    "transform_matrix": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 3], [0, 0, 0, 1]]},)" +
                           kLights);
  EXPECT_NEAR(scene.cameraAt(0).lens.fl_x, 32, 1e-9);
}
TEST_F(SceneTest, AMatrixCameraTakesALens) {
  const Scene scene = read(R"("camera": {"camera_model": "OPENCV", "w": 64, "h": 48, "fl_x": 60, "fl_y": 61, "cx": 30,
    "cy": 25, "k1": -0.1, "p2": 0.01, "transform_matrix": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 3], [0, 0, 0, 1]]},)" +
                           kLights);
  const Intrinsics lens = scene.cameraAt(0).lens;
  EXPECT_EQ(lens.model, CameraModel::opencv);
  EXPECT_EQ(lens.k1, -0.1);
  EXPECT_EQ(lens.p2, 0.01);
  EXPECT_EQ(lens.fl_y, 61);
}

TEST_F(SceneTest, OverridesAreValidatedLikeTheFile) {
  const std::string both = kCamera + "," + kLights;
  EXPECT_EQ(read(both, {"/accuracy/views=7"}).accuracy.views, 7);
  EXPECT_EQ(read(both, {"/frames=2-4", "/frames=1-2"}).frames, (std::vector<int>{1, 2}));
  EXPECT_EQ(read(both, {"/lights/0/irradiance=[4, 5, 6]"}).lights.size(), 1u);
  EXPECT_REFUSED(refusal(both, {"/accuracy/vews=7"}), "/accuracy/vews", "'views'");
  EXPECT_REFUSED(refusal(both, {"/samples=many"}), "/samples", "number");
}

TEST_F(SceneTest, TheHashKnowsWhatAPictureDependsOn) {
  const std::string both = kCamera + "," + kLights;
  const auto hash = read(both).content_hash;
  EXPECT_EQ(read(both + R"(, "frames": "0-9", "output": "b.####.exr", "srf": "y.srf")").content_hash, hash);
  EXPECT_NE(read(both, {"/samples=2"}).content_hash, hash);
  EXPECT_NE(read(both, {"/lights/0/irradiance/0=1.0000001"}).content_hash, hash);
}

TEST(Frames, GrammarOfRangesStepsAndLists) {
  using Frames = std::vector<int>;
  EXPECT_EQ(parseFrames("3", ""), Frames{3});
  EXPECT_EQ(parseFrames("0-3", ""), (Frames{0, 1, 2, 3}));
  EXPECT_EQ(parseFrames("0-7x3", ""), (Frames{0, 3, 6}));
  EXPECT_EQ(parseFrames("5,1, 2-4x2", ""), (Frames{5, 1, 2, 4}));
  EXPECT_EQ(parseFrames("-3--1", ""), (Frames{-3, -2, -1}));
  EXPECT_EQ(parseFrames("-1-1", ""), (Frames{-1, 0, 1}));
  for (const char* wrong : {"", "a", "1-", "-", "1,,2", "1,", "3-1", "1-5x0", "1-5x-1", "1x2", "1 2", "1.5",
                            "0-99999999", "99999999999999999999"})
    EXPECT_THROW(parseFrames(wrong, "--frames"), Error) << wrong;
}

TEST(Frames, AFrameNamedTwiceIsRenderedOnce) {
  EXPECT_EQ(parseFrames("5,0-6x2,5,4-5", ""), (std::vector<int>{5, 0, 2, 4, 6}));
}

TEST(Frames, NumbersStandInTheFilesName) {
  EXPECT_EQ(frameFile("a/b.####.exr", 7), "a/b.0007.exr");
  EXPECT_EQ(frameFile("a/b.##.exr", 123), "a/b.123.exr");
  EXPECT_EQ(frameFile("a#1/b.###.exr", 1), "a#1/b.001.exr");
  EXPECT_EQ(frameFile("b.%04d.exr", 12), "b.0012.exr");
  EXPECT_EQ(frameFile("b.exr", 12), "b.0012.exr");
  EXPECT_EQ(frameFile("b.####.exr", -5), "b.-0005.exr");
}

// --- Cameras and lights of a glTF -----------------------------------------------------------------------------------

// Node 0 a camera 2 up the file's y that slides along its x; node 1 a lamp, node 2 a sun turned to shine along the
// file's -x, node 3 a spot.
std::string stageFile(const char* camera = R"({"type": "perspective", "perspective": {"yfov": 0.5}})") {
  test::TinyGltf tiny;
  tiny.json["cameras"] = {Json::parse(camera)};
  tiny.json["nodes"] = Json::parse(R"([{"camera": 0, "name": "eye", "translation": [0, 2, 0], "scale": [3, 3, 3]},
    {"translation": [1, 2, 3], "extensions": {"KHR_lights_punctual": {"light": 0}}},
    {"rotation": [0, 0.7071067811865476, 0, 0.7071067811865476], "extensions": {"KHR_lights_punctual": {"light": 1}}}])");
  tiny.json["extensions"] = Json::parse(R"({"KHR_lights_punctual": {"lights": [
    {"type": "point", "name": "lamp", "intensity": 100, "color": [1, 0.5, 0]}, {"type": "directional", "name": "sun"}]}})");
  tiny.animate(0, "translation", "LINEAR", {0, 1}, {0, 2, 0, 6, 2, 0});
  return tiny.text();
}

TEST_F(SceneTest, TheCameraOfAGltfIsThatCameraOverTime) {
  writeTextFile(folder_ / "stage.gltf", stageFile());
  const Scene scene =
      read(R"("fps": 30, "camera": {"w": 64, "h": 48, "gltf": {"file": "stage.gltf", "name": "eye"}},)" + kLights);
  const auto camera = scene.cameraAt(15);  // half a second
  EXPECT_LE(distance(camera.center(), Point<ObjectSpace>(3, 0, 2)), 1e-12);
  // The file's -z is our +y, its +y our +z: what lies above the middle is up in the picture.
  const auto above = camera.project(Point<ObjectSpace>(3, 4, 2 + 4 * std::tan(0.25)));
  ASSERT_TRUE(above);
  EXPECT_NEAR(above->pixel.x, 32, 1e-9);
  EXPECT_NEAR(above->pixel.y, 0, 1e-9);
  EXPECT_GT(camera.project(Point<ObjectSpace>(4, 4, 2))->pixel.x, 32);

  writeTextFile(folder_ / "flat.gltf",
                stageFile(R"({"type": "orthographic", "orthographic": {"ymag": 3, "xmag": 1}})"));
  const auto flat = read(R"("camera": {"w": 64, "h": 48, "gltf": {"file": "flat.gltf"}},)" + kLights).cameraAt(0);
  EXPECT_NEAR(flat.project(Point<ObjectSpace>(0, 9, 2 + 3))->pixel.y, 0, 1e-9);
}

TEST_F(SceneTest, TheLightsOfAGltfShineAndWhatTheyHoldIsHashed) {
  writeTextFile(folder_ / "stage.gltf", stageFile());
  const std::string keys = kCamera + R"(, "lights": [{"type": "gltf", "file": "stage.gltf", "scale": 0.1}])";
  const Scene scene = read(keys);
  SrfManifest field;
  field.lights = {{}, {}};
  const FrameLights lights = LightSet(scene, field, Reporter::silent()).at(0);
  ASSERT_EQ(lights.near_lights.size(), 1u);
  EXPECT_EQ(lights.near_lights[0].position, Point<ObjectSpace>(1, -3, 2));
  EXPECT_LE(length(lights.near_lights[0].intensity - Vec3{10, 5, 0}), 1e-12);
  ASSERT_EQ(lights.distant.size(), 1u);
  EXPECT_LE(length(lights.distant[0].direction.raw() - Vec3{1, 0, 0}), 1e-12);
  EXPECT_LE(length(lights.distant[0].irradiance - Vec3{0.1, 0.1, 0.1}), 1e-12);
  const Scene lamp = read(kCamera + R"(, "lights": [{"type": "gltf", "file": "stage.gltf", "name": "lamp"}])");
  EXPECT_TRUE(LightSet(lamp, field, Reporter::silent()).at(0).distant.empty());

  std::string brighter = stageFile();
  brighter.replace(brighter.find("100"), 3, "200");
  writeTextFile(folder_ / "stage.gltf", brighter);
  EXPECT_NE(read(keys).content_hash, scene.content_hash);
}

TEST_F(SceneTest, WhatAGltfDoesNotHoldIsRefused) {
  writeTextFile(folder_ / "stage.gltf", stageFile());
  EXPECT_REFUSED(refusal(R"("camera": {"w": 64, "h": 48, "gltf": {"file": "stage.gltf", "name": "eys"}},)" + kLights),
                 "/camera/gltf/name", "'eye'");
  EXPECT_REFUSED(refusal(R"("camera": {"w": 64, "h": 48, "gltf": {"file": "none.gltf"}},)" + kLights),
                 "scene.json: /camera/gltf/file", "none.gltf");
  EXPECT_REFUSED(refusal(R"("camera": {"w": 64, "gltf": {"file": "stage.gltf"}},)" + kLights), "/camera", "h");
  EXPECT_REFUSED(refusal(kCamera + R"(, "lights": [{"type": "gltf", "file": "stage.gltf", "scale": -1}])"),
                 "/lights/0/scale: found -1", "at least 0");
  std::string negative = stageFile();
  negative.replace(negative.find("100"), 3, "-10");
  writeTextFile(folder_ / "negative.gltf", negative);
  EXPECT_REFUSED(refusal(kCamera + R"(, "lights": [{"type": "gltf", "file": "negative.gltf"}])"), "/lights/0", "'lamp'",
                 "below 0");
  std::string spot = stageFile();
  spot.replace(spot.find("directional"), 11, "spot");
  writeTextFile(folder_ / "spot.gltf", spot);
  EXPECT_REFUSED(refusal(kCamera + R"(, "lights": [{"type": "gltf", "file": "spot.gltf"}])"), "/lights/0", "'sun'",
                 "'spot'", "point or directional");
}

}  // namespace
}  // namespace srf
