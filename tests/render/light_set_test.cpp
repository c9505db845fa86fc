#include "render/light_set.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <random>

#include "base/error.h"
#include "base/image_io.h"
#include "base/numeric.h"
#include "tests/support/hard_case.h"
#include "tests/support/test_support.h"

namespace srf {
namespace {

// Orientation as formats.md has it, written apart from the code under test: left edge -x, centre +x, a quarter to the
// left of the centre +y, top +z.
Vec3 directionOf(double u, double v) {
  const double azimuth = kPi * (1 - 2 * u), polar = kPi * v;
  return {std::sin(polar) * std::cos(azimuth), std::sin(polar) * std::sin(azimuth), std::cos(polar)};
}
double solidAngle(int y, int width, int height) {
  return 2 * kPi / width * (std::cos(kPi * y / height) - std::cos(kPi * (y + 1) / height));
}
template <class Radiance>
ImageF makeMap(int width, int height, const Radiance& radiance) {
  ImageF map(width, height, 3);
  for (int y = 0; y < height; ++y)
    for (int x = 0; x < width; ++x) {
      const Vec3 value = radiance(directionOf((x + 0.5) / width, (y + 0.5) / height));
      for (int c = 0; c < 3; ++c) map.at(x, y, c) = static_cast<float>(value[c]);
    }
  return map;
}
Vec3 unit(const Vec3& a) {
  return a / length(a);
}
Vec3 integral(const ImageF& map) {
  Vec3 sum;
  for (int y = 0; y < map.height(); ++y)
    for (int x = 0; x < map.width(); ++x)
      for (int c = 0; c < 3; ++c)
        if (std::isfinite(map.at(x, y, c)))
          sum[c] += solidAngle(y, map.width(), map.height()) * std::fmax(0, map.at(x, y, c));
  return sum;
}
Vec3 total(const EnvironmentSamples& samples) {
  Vec3 sum;
  for (const DistantLight& light : samples.lights) sum += light.irradiance;
  return sum;
}

const Vec3 kSun = unit({0.5, 0.3, 0.81});
Vec3 softSky(const Vec3& d) {
  return (0.25 + 2.75 * std::pow(std::fmax(0, 0.6 * d.z + 0.8 * d.x), 3)) * Vec3{0.8, 0.9, 1};
}
Vec3 sunny(const Vec3& d) {
  return dot(d, kSun) > std::cos(radians(0.5)) ? Vec3{1.2e4, 1e4, 0.8e4} : (0.5 + 0.5 * d.z) * Vec3{0.4, 0.6, 1};
}
Vec3 sevenLamps(const Vec3& d) {
  for (int i = 0; i < 7; ++i)
    if (dot(d, directionOf((i + 0.4) / 7, 0.15 + 0.1 * i)) > std::cos(radians(4))) return {36, 30.0 + i, 20};
  return {0.1, 0.1, 0.1};
}

TEST(EnvironmentLights, FaceTheDirectionsOfTheFormat) {
  const struct {
    double u, v;
    Vec3 direction;
  } cases[] = {{0.5, 0.5, {1, 0, 0}}, {0.25, 0.5, {0, 1, 0}}, {0.75, 0.5, {0, -1, 0}},
               {0, 0.5, {-1, 0, 0}},  {0.3, 0, {0, 0, 1}},    {0.6, 1, {0, 0, -1}}};
  constexpr int kWidth = 64, kHeight = 32;
  for (const auto& c : cases) {
    ImageF map(kWidth, kHeight, 3);
    const int x = std::min(kWidth - 1, static_cast<int>(c.u * kWidth));
    const int y = std::min(kHeight - 1, static_cast<int>(c.v * kHeight));
    map.at(x, y, 0) = 2;
    for (const int samples : {0, 1, 5}) {
      const EnvironmentSamples found = sampleEnvironment(map, samples);
      ASSERT_EQ(found.lights.size(), 1u);
      // Half a texel is 2.8 degrees either way.
      EXPECT_LT(degrees(angleBetweenUnit(found.lights[0].direction.raw(), c.direction)), 4.1);
      EXPECT_NEAR(found.lights[0].irradiance.x, 2 * solidAngle(y, kWidth, kHeight), 1e-15);
      EXPECT_EQ(found.lights[0].irradiance.y, 0);
    }
  }
}

TEST(EnvironmentLights, KeepTheEnergyOfEveryChannel) {
  ImageF spike = makeMap(64, 32, softSky);
  spike.at(40, 9, 1) = 1e5f;                                // one texel of sun
  for (int x = 0; x < 64; ++x) spike.at(x, 31, 2) = 500.f;  // a bright row at the pole
  test::Largest off;
  for (const ImageF& map : {spike, makeMap(128, 64, sunny), makeMap(96, 48, sevenLamps)})
    for (const int samples : {0, 1, 2, 64, 100, 256, 1000000}) {
      const Vec3 expected = integral(map), found = total(sampleEnvironment(map, samples));
      for (int c = 0; c < 3; ++c) off.add(std::fabs(found[c] / expected[c] - 1));
    }
  test::recordHardCase(35, "a texel of 1e5, a bright row at the pole; 1 to all lights: energy lost or gained, relative",
                       off.value, test::atMost(1e-6));
}

TEST(EnvironmentLights, AreAsManyAsAskedForWhereTheMapHasThem) {
  EXPECT_EQ(sampleEnvironment(makeMap(64, 32, softSky), 100).lights.size(), 100u);
  EXPECT_EQ(sampleEnvironment(makeMap(64, 32, softSky), 0).lights.size(), 64u * 32u);
  EXPECT_TRUE(sampleEnvironment(ImageF(64, 32, 3), 100).lights.empty());
  EXPECT_EQ(sampleEnvironment(ImageF(1, 1, 3, 1.f), 1).lights.size(), 1u);
  EXPECT_EQ(sampleEnvironment(ImageF(1, 1, 3, 1.f), 100).lights.size(), 100u);
}

/// Relative rms error of the irradiance over normals, against the sum over all texels.
double diffuseError(const ImageF& map, int samples) {
  const EnvironmentSamples all = sampleEnvironment(map, 0), few = sampleEnvironment(map, samples);
  std::mt19937 random(5);
  std::normal_distribution<double> normal;
  double squared_error = 0, squared = 0;
  for (int i = 0; i < 100; ++i) {
    const Vec3 n = unit({normal(random), normal(random), normal(random)});
    const auto irradiance = [&](const EnvironmentSamples& s) {
      double sum = 0;
      for (const DistantLight& light : s.lights)
        sum += std::fmax(0, dot(light.direction.raw(), n)) * light.irradiance.y;
      return sum;
    };
    const double exact = irradiance(all);
    squared_error += square(irradiance(few) - exact);
    squared += exact * exact;
  }
  return std::sqrt(squared_error / squared);
}

TEST(EnvironmentLights, SixtyFourLightADiffuseSurfaceWithinOnePercent) {
  EXPECT_LT(diffuseError(makeMap(256, 128, softSky), 64), 0.01);
  EXPECT_LT(diffuseError(makeMap(256, 128, sevenLamps), 64), 0.01);
  EXPECT_LT(diffuseError(makeMap(512, 256, sunny), 64), 0.01);
}

TEST(EnvironmentLights, OfACapturedMapLightADiffuseSurfaceWithinOnePercent) {
  SRF_REQUIRE_DATA(folder, "envmaps");
  for (const char* name : {"studio.exr", "forest.exr"})
    EXPECT_LT(diffuseError(readImage(folder / name).pixels, 64), 0.01) << name;
}

TEST(EnvironmentLights, OfAConstantMapAreSpreadEvenly) {
  const EnvironmentSamples found = sampleEnvironment(makeMap(128, 64, [](const Vec3&) { return Vec3{1, 1, 1}; }), 256);
  ASSERT_EQ(found.lights.size(), 256u);
  double least_angle = kPi, most_energy = 0;
  for (std::size_t i = 0; i < 256; ++i) {
    most_energy = std::fmax(most_energy, found.lights[i].irradiance.x);
    for (std::size_t j = 0; j < i; ++j)
      least_angle = std::fmin(least_angle, angleBetween(found.lights[i].direction, found.lights[j].direction));
  }
  // A square of 4 pi / 256 is 12.7 degrees wide. Cuts in two leave cells that differ by a factor of two in area and in
  // width: 4 degrees apart and three mean energies are beyond that.
  EXPECT_GT(degrees(least_angle), 4);
  EXPECT_LT(most_energy, 3 * 4 * kPi / 256);
  EXPECT_LT(diffuseError(makeMap(128, 64, [](const Vec3&) { return Vec3{1, 1, 1}; }), 256), 0.003);
}

TEST(EnvironmentLights, OfACoarseMapAreConstantOverItsTexels) {
  ImageF even(1, 1, 3, 2.f), coarse(8, 4, 3), fine(512, 256, 3);
  for (int c = 0; c < 3; ++c) coarse.at(5, 1, c) = coarse.at(2, 3, c) = 3;
  for (int y = 0; y < 256; ++y)
    for (int x = 0; x < 512; ++x) fine.at(x, y, 1) = coarse.at(x / 64, y / 64, 1);
  for (const int samples : {0, 256})
    for (const Vec3& normal : {Vec3{0, 0, 1}, Vec3{1, 0, 0}, unit({-1, 2, 0.5})}) {
      const auto irradiance = [&](const ImageF& map) {
        double sum = 0;
        for (const DistantLight& light : sampleEnvironment(map, samples).lights)
          sum += std::fmax(0, dot(light.direction.raw(), normal)) * light.irradiance.y;
        return sum;
      };
      EXPECT_NEAR(irradiance(even), 2 * kPi, 0.02 * kPi);
      EXPECT_NEAR(irradiance(coarse), irradiance(fine), 0.01 * irradiance(fine));
    }
  EXPECT_EQ(sampleEnvironment(even, 0).lights.size(), mostEnvironmentLights(1, 1));
  EXPECT_EQ(sampleEnvironment(fine, 0).lights.size(), mostEnvironmentLights(512, 256) / 16);
  coarse.at(0, 0, 0) = -1;
  EXPECT_EQ(sampleEnvironment(coarse, 0).unusable_texels, 1u);
}

TEST(EnvironmentLights, UnusableTexelsCountAsBlackAndAreCounted) {
  ImageF map = makeMap(64, 32, softSky), clean = map;
  const float bad[] = {-1, std::numeric_limits<float>::quiet_NaN(), std::numeric_limits<float>::infinity(),
                       -std::numeric_limits<float>::infinity()};
  for (int i = 0; i < 4; ++i) map.at(10 + i, 12, i % 3) = bad[i], clean.at(10 + i, 12, i % 3) = 0;
  const EnvironmentSamples found = sampleEnvironment(map, 64), expected = sampleEnvironment(clean, 64);
  EXPECT_EQ(found.unusable_texels, 4u);
  EXPECT_EQ(expected.unusable_texels, 0u);
  ASSERT_EQ(found.lights.size(), expected.lights.size());
  for (std::size_t i = 0; i < found.lights.size(); ++i) {
    EXPECT_EQ(found.lights[i].direction, expected.lights[i].direction);
    EXPECT_EQ(found.lights[i].irradiance, expected.lights[i].irradiance);
  }
}

SrfManifest fieldWith(std::vector<CaptureLight> lights) {
  SrfManifest field;
  field.lights = std::move(lights);
  return field;
}
const SrfManifest kField = fieldWith({{.name = "L000"}, {.name = "L001"}});
const SrfManifest kUnknown = fieldWith({{.name = "captured", .kind = LightKind::captured}});

Scene sceneWith(std::vector<SceneLight> lights) {
  Scene scene;
  scene.file = "scene.json";
  scene.lights = std::move(lights);
  return scene;
}
std::string refusal(const Scene& scene, const SrfManifest& field) {
  try {
    LightSet(scene, field, Reporter::silent()).at(1);
  } catch (const Error& e) {
    return e.what();
  }
  return "";
}
const Animated<Vec3> kWhite{Vec3{1, 1, 1}};

TEST(LightSet, EnvironmentTurnsCounterClockwiseAboutZ) {
  const test::TemporaryFolder folder;
  ImageF map(64, 32, 3);
  map.at(32, 16, 0) = 1;  // about +x
  writeExr(folder / "map.exr", map);
  const Scene scene = sceneWith(
      {EnvironmentLight{folder / "map.exr", 90.0, Animated<double>({{0, 1}, {2, 5}}, KeyInterpolation::linear), 8}});
  const FrameLights lights = LightSet(scene, kField, Reporter::silent()).at(1);
  ASSERT_EQ(lights.distant.size(), 1u);
  EXPECT_LT(degrees(angleBetweenUnit(lights.distant[0].direction.raw(), {0, 1, 0})), 4.1);
  EXPECT_NEAR(lights.distant[0].irradiance.x, 3 * solidAngle(16, 64, 32), 1e-12);
}

TEST(LightSet, GivesAllKindsTogetherAndMoving) {
  const Scene scene = sceneWith(
      {PointLight{Animated<Vec3>({{0, {0, 0, 1}}, {2, {0, 0, 3}}}, KeyInterpolation::linear), kWhite},
       DirectionalLight{Animated<Vec3>({{0, {0, 0, 1}}, {2, {0, 1, 0}}}, KeyInterpolation::linear), Vec3{1, 2, 3}},
       CapturedLight{"L001", 0.5}});
  const LightSet set(scene, kField, Reporter::silent());
  const FrameLights lights = set.at(1);
  ASSERT_EQ(lights.near_lights.size(), 1u);
  EXPECT_EQ(lights.near_lights[0].position.raw(), (Vec3{0, 0, 2}));
  ASSERT_EQ(lights.distant.size(), 1u);
  EXPECT_NEAR(length(lights.distant[0].direction.raw()), 1, 1e-15);
  EXPECT_NEAR(lights.distant[0].direction.raw().y, std::sqrt(0.5), 1e-15);
  EXPECT_EQ(lights.distant[0].irradiance, (Vec3{1, 2, 3}));
  ASSERT_EQ(lights.rest.size(), 1u);
  EXPECT_EQ(lights.rest[0].light, LightId{1});
  EXPECT_EQ(lights.rest[0].scale, 0.5);
}

TEST(LightSet, AStrengthWhoseCubicKeysPassBelow0Is0There) {
  // Catmull-Rom from 0 to 0 has the slope of what follows at its end, so it dips.
  const auto rising = [](auto zero, auto one) {
    return Animated<decltype(zero)>({{0, zero}, {2, zero}, {4, one}}, KeyInterpolation::cubic);
  };
  const auto scale = rising(0.0, 1.0);
  ASSERT_LT(scale.at(1), 0);
  const Animated<Vec3> strength = rising(Vec3{}, Vec3{1, 1, 1});
  const FrameLights lights =
      LightSet(
          sceneWith({PointLight{kWhite, strength}, DirectionalLight{kWhite, strength}, CapturedLight{"L001", scale}}),
          kField, Reporter::silent())
          .at(1);
  EXPECT_EQ(lights.near_lights[0].intensity, Vec3{});
  EXPECT_EQ(lights.distant[0].irradiance, Vec3{});
  EXPECT_EQ(lights.rest[0].scale, 0);
}

TEST(LightSet, RefusesLightsThatTheFieldDoesNotHave) {
  EXPECT_EQ(refusal(sceneWith({CapturedLight{"L001", 1.0}}), kField), "");
  EXPECT_EQ(refusal(sceneWith({CapturedLight{"", 1.0}}), kUnknown), "");
  EXPECT_EQ(refusal(sceneWith({CapturedLight{"captured", 1.0}}), kUnknown), "");
  const std::string unknown = refusal(sceneWith({CapturedLight{"L01", 1.0}}), kField);
  EXPECT_NE(unknown.find("scene.json: /lights/0/light"), std::string::npos) << unknown;
  EXPECT_NE(unknown.find("did you mean 'L0"), std::string::npos) << unknown;
  EXPECT_NE(refusal(sceneWith({CapturedLight{"", 1.0}}), kField).find("L000, L001"), std::string::npos);
  const std::string other = refusal(sceneWith({CapturedLight{"", 1.0}, PointLight{kWhite, kWhite}}), kUnknown);
  EXPECT_NE(other.find("/lights/1"), std::string::npos) << other;
  EXPECT_NE(other.find("unknown illumination"), std::string::npos) << other;
}

TEST(LightSet, RefusesADirectionThatVanishesBetweenKeys) {
  const Scene scene = sceneWith(
      {DirectionalLight{Animated<Vec3>({{0, {0, 0, 1}}, {2, {0, 0, -1}}}, KeyInterpolation::linear), kWhite}});
  EXPECT_NE(refusal(scene, kField).find("/lights/0/direction"), std::string::npos);
}

TEST(LightSet, WarnsOfASceneWithoutALight) {
  Reporter reporter(ProgressMode::none, LogLevel::error);
  const Scene dark = sceneWith({});
  EXPECT_TRUE(LightSet(dark, kField, reporter).at(0).distant.empty());
  ASSERT_EQ(reporter.warnings().size(), 1u);
  EXPECT_NE(reporter.warnings()[0].find("scene.json: /lights: is empty"), std::string::npos);
}

TEST(LightSet, WarnsOfUnusableTexels) {
  const test::TemporaryFolder folder;
  ImageF map(8, 4, 3, 1.f);
  map.at(2, 2, 1) = -1;
  writeExr(folder / "map.exr", map);
  Reporter reporter(ProgressMode::none, LogLevel::error);
  const Scene scene = sceneWith({EnvironmentLight{folder / "map.exr", 0.0, 1.0, 8}});
  const LightSet set(scene, kField, reporter);
  ASSERT_EQ(reporter.warnings().size(), 1u);
  EXPECT_NE(reporter.warnings()[0].find("map.exr: 1 texels"), std::string::npos);
  EXPECT_EQ(reporter.counters().at("environment.unusable_texels"), 1u);
}

}  // namespace
}  // namespace srf
