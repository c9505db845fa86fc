#include "acquire/light_calibration.h"

#include <gtest/gtest.h>

#include <functional>

#include "base/error.h"
#include "base/files.h"
#include "base/image_io.h"
#include "base/numeric.h"
#include "tests/acquire/ball_pictures.h"
#include "tests/support/test_support.h"

namespace srf {
namespace {

void expectRefused(const std::function<void()>& call, const std::string& words) {
  const std::string text = test::messageOf(call);
  EXPECT_NE(text.find(words), std::string::npos) << "'" << text << "' should say '" << words << "'";
}

TEST(LightCalibration, AMattBallGivesItsLightAndTheStrayLight) {
  for (const bool orthographic : {false, true}) {
    const Intrinsics lens = orthographic ? test::orthographicLens(160, 120, 80) : pinholeFromFov(160, 120, 40);
    const Ball ball{Point<CameraSpace>(0.2, -0.1, orthographic ? 0 : 2.5), 0.5};
    for (int i = 0; i < 5; ++i) {
      const double z = -0.95 + 0.25 * i, r = std::sqrt(1 - z * z);
      const Vec3 light{r * std::cos(2.0 * i), r * std::sin(2.0 * i), z};
      test::BallPicture picture{lens, ball, 0.01, 1, 0.003, static_cast<std::uint64_t>(i + 1)};
      const ImageF image = test::ballPicture(
          picture, [&](const Vec3&, const Vec3& n, const Vec3&) { return 0.4 * std::max(0.0, dot(n, light)) + 0.02; });
      const auto fit = fitLambertBall(image, lens, *outlineOfBall(lens, ball), {.stray = true});
      ASSERT_TRUE(fit) << i;
      const double off = angleBetweenUnit(fit->direction.raw(), light);
      EXPECT_LT(degrees(off), 0.2) << i;
      EXPECT_LT(off, 5 * fit->sigma) << i;
      EXPECT_NEAR(fit->level.y, 0.4, 0.004) << i;
      EXPECT_NEAR(fit->stray.y, 0.02, 0.002) << i;
    }
  }
  const Intrinsics lens = pinholeFromFov(160, 120, 40);
  EXPECT_FALSE(fitLambertBall(ImageF(160, 120, 1), lens, outlineFromCircle(lens, {{80, 60}, 30})));
}

TEST(LightCalibration, SaturatedPixelsOfAMattBallAreLeftOut) {
  const Intrinsics lens = test::orthographicLens(160, 120, 80);
  const Ball ball{Point<CameraSpace>(0, 0, 0), 0.6};
  const Vec3 light = Vec3{0.5, -0.3, -0.8} / length(Vec3{0.5, -0.3, -0.8});
  const test::BallPicture picture{lens, ball, 0, 1};
  const ImageF image = test::ballPicture(picture, [&](const Vec3&, const Vec3& n, const Vec3&) {
    return std::min(1.0, 1.2 * std::max(0.0, dot(n, light)));
  });
  const auto off = [&](double white) {
    const auto fit = fitLambertBall(image, lens, *outlineOfBall(lens, ball), {.white = white});
    return degrees(angleBetweenUnit(fit->direction.raw(), light));
  };
  EXPECT_LT(off(1.0), 0.01);
  EXPECT_GT(off(INFINITY), 0.1) << "the check can fail";
}

TEST(LightCalibration, LpFilesComeBackAsTheyWere) {
  const test::TemporaryFolder folder;
  std::vector<LpLight> lights;
  for (int i = 0; i < 20; ++i) {
    const Vec3 d{std::sin(i), std::cos(1.7 * i), 0.3 + i};
    lights.push_back({"a picture " + std::to_string(i) + ".jpg", d / length(d)});
  }
  writeLp(folder / "x.lp", lights);
  const auto back = readLp(folder / "x.lp");
  ASSERT_EQ(back.size(), lights.size());
  for (std::size_t i = 0; i < back.size(); ++i) {
    EXPECT_EQ(back[i].file, lights[i].file);
    EXPECT_LT(length(back[i].direction - lights[i].direction), 1e-15);
    EXPECT_LT(length(toLpFrame(fromLpFrame(back[i].direction)) - back[i].direction), 1e-300);
  }
}

TEST(LightCalibration, LpFilesSeenInTheWildAreRead) {
  const test::TemporaryFolder folder;
  writeTextFile(folder / "x.lp",
                "\xEF\xBB\xBF"
                "2\r\nC:\\my shots\\a b.jpg\t0,6 0 0,8\r\n\r\nb.jpg 0 0 2\r\n");
  const auto lights = readLp(folder / "x.lp");
  ASSERT_EQ(lights.size(), 2u);
  EXPECT_EQ(lights[0].file, "C:\\my shots\\a b.jpg");
  EXPECT_NEAR(lights[0].direction.x, 0.6, 1e-12);
  EXPECT_FALSE(lights[0].normalised_here);
  EXPECT_TRUE(lights[1].normalised_here);
  EXPECT_EQ(lights[1].direction.z, 1);
}

TEST(LightCalibration, BrokenLpFilesAreRefusedByLine) {
  const test::TemporaryFolder folder;
  const auto with = [&](const std::string& text) {
    writeTextFile(folder / "x.lp", text);
    return test::messageOf([&] { readLp(folder / "x.lp"); });
  };
  EXPECT_NE(with("").find("is empty"), std::string::npos);
  EXPECT_NE(with("3\na 0 0 1\n").find("says 3 lights and has 1"), std::string::npos);
  EXPECT_NE(with("a 0 0 1\n").find("line 1"), std::string::npos);
  EXPECT_NE(with("1\na 0 1\n").find("line 2: has 3 words"), std::string::npos);
  EXPECT_NE(with("1\na 0 x 1\n").find("has 'x'"), std::string::npos);
  EXPECT_NE(with("1\na 0 0 0\n").find("no length"), std::string::npos);
  EXPECT_NE(with("1\na nan 0 1\n").find("'nan'"), std::string::npos);
}

TEST(LightCalibration, DomesAreReadFromBothKindsOfFile) {
  const test::TemporaryFolder folder;
  Camera<AcquisitionSpace> camera;
  camera.pose =
      *lookAt(Point<AcquisitionSpace>(0, -3, 0), Point<AcquisitionSpace>(0, 0, 0), Vector<AcquisitionSpace>(0, 0, 1));
  writeTextFile(folder / "own.json",
                R"({"lights": [{"name": "a", "type": "point", "position": [0, 0, 2], "intensity": [4, 4, 4]}]})");
  const auto own = readDome(folder / "own.json", camera);
  ASSERT_EQ(own.size(), 1u);
  EXPECT_EQ(own[0].kind, LightKind::point);
  // z of the .dome is towards the camera, which stands at -y; y is up.
  writeTextFile(folder / "x.dome", R"({"lightConfiguration": "directional", "directions": [{"x": 0, "y": 0, "z": 1},
    {"x": 0, "y": 2, "z": 0}], "ledAdjust": [{"r": 1, "g": 1, "b": 1}, {"r": 2, "g": 1, "b": 0.5}]})");
  const auto dome = readDome(folder / "x.dome", camera);
  ASSERT_EQ(dome.size(), 2u);
  EXPECT_LT(length(dome[0].direction.raw() - Vec3{0, -1, 0}), 1e-12);
  EXPECT_LT(length(dome[1].direction.raw() - Vec3{0, 0, 1}), 1e-12);
  EXPECT_EQ(dome[1].strength, (Vec3{0.5, 1, 2}));
  writeTextFile(folder / "x.dome", R"({"lightConfiguration": "lights3d", "directions": []})");
  expectRefused([&] { readDome(folder / "x.dome", camera); }, "no stated unit");
  writeTextFile(folder / "x.dome", "{}");
  expectRefused([&] { readDome(folder / "x.dome", camera); }, "neither");
}

TEST(LightCalibration, AWhiteTargetGivesIrradianceAndIntensity) {
  // A target of reflectance 0.8 tilted by 30 degrees, under an irradiance of 3 and under a point light of intensity 12
  // at distance 2: both give pi L / (rho cos) = 3.
  WhiteTarget target;
  target.reflectance = {0.8, 0.8, 0.4};
  target.normal = *normalize(Vector<AcquisitionSpace>(0, std::sin(radians(30)), std::cos(radians(30))));
  target.position = Point<AcquisitionSpace>(1, 2, 3);
  CaptureLight light;
  light.name = "L";
  light.direction = Direction<AcquisitionSpace>::fromUnit({0, 0, 1});
  const double radiance = 0.8 * 3 * std::cos(radians(30)) / kPi;
  ImageF image(40, 30, 3, static_cast<float>(radiance));
  for (int y = 0; y < 30; ++y)
    for (int x = 0; x < 40; ++x) image.at(x, y, 2) = static_cast<float>(radiance / 2);
  Image8 region(40, 30, 1);
  for (int y = 10; y < 20; ++y)
    for (int x = 10; x < 30; ++x) region.at(x, y) = 255;
  image.at(0, 0) = NAN;  // outside the target
  const Vec3 irradiance = strengthFromWhite(light, meanRadiance(image, region), target);
  EXPECT_LT(length(irradiance - Vec3{3, 3, 3}), 1e-5);
  light.kind = LightKind::point;
  light.position = Point<AcquisitionSpace>(1, 2, 5);
  const Vec3 intensity = strengthFromWhite(light, meanRadiance(image, region), target);
  EXPECT_LT(length(intensity - Vec3{12, 12, 12}), 1e-4);
  EXPECT_LT(length(light.irradianceAt(target.position) - Vec3{1, 1, 1} / 4), 1e-12) << "intensity / d^2";

  light.position = Point<AcquisitionSpace>(1, 2, 1);
  expectRefused([&] { strengthFromWhite(light, {1, 1, 1}, target); }, "150 degrees off");
  for (int x = 10; x < 30; ++x) image.at(x, 12, 1) = 1;
  expectRefused([&] { meanRadiance(image, region, 1.0); }, "20 of 200 pixels are saturated");
}

TEST(LightCalibration, StrengthsComeFromATableByName) {
  const test::TemporaryFolder folder;
  std::vector<CaptureLight> lights(2);
  lights[0].name = "7", lights[1].name = "lamp";
  writeTextFile(folder / "t.csv", "light,r,g,b\nlamp,1,2,3\n7,4,5,6\n");
  setStrengths(lights, folder / "t.csv");
  EXPECT_EQ(lights[0].strength, (Vec3{4, 5, 6}));
  EXPECT_EQ(lights[1].strength, (Vec3{1, 2, 3}));
  writeTextFile(folder / "t.csv", "lamp,2\n7,1/2\n");
  setStrengths(lights, folder / "t.csv");
  EXPECT_EQ(lights[0].strength, (Vec3{0.5, 0.5, 0.5}));
  writeTextFile(folder / "t.csv", "lamp,2\n7,1\nlampe,3\n");
  expectRefused([&] { setStrengths(lights, folder / "t.csv"); }, "is 'lamp' meant?");
  writeTextFile(folder / "t.csv", "lamp,2\n");
  expectRefused([&] { setStrengths(lights, folder / "t.csv"); }, "no row for light '7'");
  writeTextFile(folder / "t.csv", "lamp,2\n7,0\n");
  expectRefused([&] { setStrengths(lights, folder / "t.csv"); }, "not above 0");
}

}  // namespace
}  // namespace srf
