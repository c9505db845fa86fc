#include "render/guided_interpolation.h"

#include <gtest/gtest.h>

#include "base/numeric.h"
#include "base/parallel.h"
#include "render/frame_renderer.h"
#include "tests/support/glossy_sphere.h"
#include "tests/support/test_support.h"

namespace srf {
namespace {

using test::fitOf;
using test::glossy;

/// What no model of the kind can express: a pattern of the surface that comes and goes with view and light.
Vec3 oddity(const Vec3& n, const Vec3& l, const Vec3& v) {
  return std::max(0.0, dot(n, l)) * (0.1 + 0.1 * std::sin(9 * n.x + 3 * l.y + 2 * v.z)) * Vec3{1, 0.5, 0.2};
}

Camera<ObjectSpace> cameraFrom(const Vec3& eye, int size = 48) {
  Camera<ObjectSpace> camera;
  camera.lens = pinholeFromFov(size, size, 36);
  camera.pose = *lookAt(Point<ObjectSpace>(eye), Point<ObjectSpace>(), Vector<ObjectSpace>(0, 0, 1));
  return camera;
}

Frame renderWith(const test::FormulaField& field, const ReflectanceFit* fit, const Camera<ObjectSpace>& camera,
                 const FrameLights& lights, Shadows shadows = Shadows::captured, std::size_t memory = 1 << 30,
                 bool model_alone = false) {
  FrameSettings settings;
  settings.model_alone = model_alone;
  settings.fit = fit;
  settings.shadows = shadows;
  settings.memory_bytes = memory;
  settings.accuracy.light_sharing = 0;
  const DeformedModel deformed(field.model);
  FrameRenderer renderer(field.folder, field.manifest, field.model, settings, Reporter::silent());
  return renderer.render(camera, deformed, lights);
}

DistantLight sun(const Vec3& direction, const Vec3& irradiance = {1, 1, 1}) {
  return {*normalize(Vector<ObjectSpace>(direction)), irradiance};
}

/// PSNR in dB against a formula, away from the rim.
double psnr(const Frame& frame, const Camera<ObjectSpace>& camera, const FrameLights& lights,
            const test::ReflectanceFormula& formula) {
  double error = 0, peak = 0;
  int count = 0;
  for (int y = 0; y < frame.rgba.height(); ++y)
    for (int x = 0; x < frame.rgba.width(); ++x) {
      const auto ray = camera.ray({x + 0.5, y + 0.5});
      const Vec3 o = ray->origin.raw(), d = ray->direction.raw();
      const double b = dot(o, d), root = b * b - (dot(o, o) - 1);
      if (root < 0.05) continue;
      const Vec3 p = o + (-b - std::sqrt(root)) * d;
      Vec3 expected;
      for (const DistantLight& light : lights.distant)
        expected += formula(p, light.direction.raw(), -d) * light.irradiance;
      for (const NearLight& light : lights.near_lights) {
        const Vec3 to = light.position.raw() - p;
        expected += formula(p, to / length(to), -d) * (light.intensity / dot(to, to));
      }
      for (int c = 0; c < 3; ++c) {
        error += square(frame.rgba.at(x, y, c) - expected[c]);
        peak = std::max(peak, expected[c]);
        ++count;
      }
    }
  return 10 * std::log10(square(peak) * count / error);
}

class GuidedInterpolationTest : public ::testing::Test {
 protected:
  static void SetUpTestSuite() {
    folder_ = new test::TemporaryFolder;
    exact_ = new test::FormulaField(test::makeSphereField(folder_->path() / "exact.srf", {}, glossy));
    odd_ = new test::FormulaField(test::makeSphereField(
        folder_->path() / "odd.srf", {},
        [](const Vec3& n, const Vec3& l, const Vec3& v) { return glossy(n, l, v) + oddity(n, l, v); }));
  }
  static void TearDownTestSuite() { delete exact_, delete odd_, delete folder_; }
  static test::TemporaryFolder* folder_;
  static test::FormulaField *exact_, *odd_;
};
test::TemporaryFolder* GuidedInterpolationTest::folder_;
test::FormulaField *GuidedInterpolationTest::exact_, *GuidedInterpolationTest::odd_;

TEST_F(GuidedInterpolationTest, WhereTheModelIsTheTruthAnyLightAndViewShowIt) {
  const ReflectanceFit fit = fitOf(*exact_, 1);
  const auto camera = cameraFrom({3, -4, 1});
  FrameLights one, near, sky;
  one.distant = {sun({1, -1, 0.7})};
  near.near_lights = {{Point<ObjectSpace>(1.5, -1.5, 1), {2, 3, 4}}};
  ImageF map(64, 32, 3);
  for (int y = 0; y < 32; ++y)
    for (int x = 0; x < 64; ++x)
      for (int c = 0; c < 3; ++c) map.at(x, y, c) = static_cast<float>(1 + 0.8 * std::sin(0.3 * x + 0.2 * y * (c + 1)));
  sky.distant = sampleEnvironment(map, 256).lights;
  for (const FrameLights& lights : {one, near, sky}) {
    const double guided = psnr(renderWith(*exact_, &fit, camera, lights), camera, lights, glossy);
    const double plain = psnr(renderWith(*exact_, nullptr, camera, lights), camera, lights, glossy);
    // What is left is the sampling of the highlight by photographs of 64 x 64.
    EXPECT_GT(guided, 44);
    EXPECT_GT(guided, plain + 14);
  }
}

TEST_F(GuidedInterpolationTest, CapturedViewAndLightAreThePhotographWhateverTheModelSays) {
  ReflectanceFit fit = fitOf(*odd_, 1);
  for (FittedPoint& point : fit.points) {
    point.reflectance.alpha_x = point.reflectance.alpha_y = 0.4f;  // wrong
    // So is this: it bends thirty times as much as the sphere.
    const Vec3 n{point.reflectance.normal[0], point.reflectance.normal[1], point.reflectance.normal[2]};
    const Vec3 u{point.reflectance.tangent[0], point.reflectance.tangent[1], point.reflectance.tangent[2]};
    point.turn = symmetricInPlane(30, 0, 30, u, cross(n, u));
  }
  const auto& captured = odd_->manifest.views[5].camera;
  Camera<ObjectSpace> camera;
  camera.lens = captured.lens;
  camera.pose = Rigid<ObjectSpace, CameraSpace>(Orthogonal<ObjectSpace, CameraSpace>(captured.pose.rotation().raw()),
                                                Point<ObjectSpace>(captured.center().raw()));
  FrameLights lights;
  lights.distant = {sun(odd_->manifest.lights[9].direction.raw())};
  const auto truth = [](const Vec3& n, const Vec3& l, const Vec3& v) { return glossy(n, l, v) + oddity(n, l, v); };
  for (const Shadows shadows : {Shadows::captured, Shadows::deformed})
    EXPECT_GT(psnr(renderWith(*odd_, &fit, camera, lights, shadows), camera, lights, truth), 45);
}

TEST_F(GuidedInterpolationTest, WhatTheModelLacksIsInterpolatedFromThePhotographs) {
  const ReflectanceFit fit = fitOf(*odd_, 1);
  const auto camera = cameraFrom({3, -4, 1});
  FrameLights lights;
  lights.distant = {sun({1, -1, 0.7})};
  const auto truth = [](const Vec3& n, const Vec3& l, const Vec3& v) { return glossy(n, l, v) + oddity(n, l, v); };
  const double guided = psnr(renderWith(*odd_, &fit, camera, lights), camera, lights, truth);
  const double model = psnr(renderWith(*exact_, &fit, camera, lights), camera, lights, truth);
  const double plain = psnr(renderWith(*odd_, nullptr, camera, lights), camera, lights, truth);
  EXPECT_GT(guided, plain + 3);
  EXPECT_GT(guided, model + 8);
}

// Photographs that err the more, the more aslant they see the surface: seen by their views' roots of n.v, as plain
// interpolation has them, they would give 13 dB.
TEST_F(GuidedInterpolationTest, SlantedViewsCountLittleForWhatTheModelLacks) {
  const test::TemporaryFolder folder;
  const test::FormulaField field =
      test::makeSphereField(folder / "slanted.srf", {}, [](const Vec3& n, const Vec3& l, const Vec3& v) {
        return glossy(n, l, v) + std::max(0.0, dot(n, l)) * std::pow(1 - dot(n, v), 3) * Vec3{1, 1, 1};
      });
  const ReflectanceFit fit = fitOf(field, 1);
  const auto camera = cameraFrom({3, -4, 1});
  FrameLights lights;
  lights.distant = {sun({1, -1, 0.7})};
  EXPECT_GT(psnr(renderWith(field, &fit, camera, lights), camera, lights, glossy), 15);
}

// What the model lacks under lights that reach a point is no part of what lies in its shadow, where photographs under
// lights that do not reach it either tell all: the same from all sides here.
TEST_F(GuidedInterpolationTest, InShadowTheLightsThatDoNotReachThePointCount) {
  const test::TemporaryFolder folder;
  const auto truth = [](const Vec3& n, const Vec3& l, const Vec3& v) {
    return dot(n, l) > 0 ? glossy(n, l, v) + dot(n, l) * Vec3{1, 1, 1} : Vec3{0.1, 0.1, 0.1};
  };
  const test::FormulaField field = test::makeSphereField(folder / "indirect.srf", {}, truth);
  ReflectanceFit fit = fitOf(field, 1);
  for (FittedPoint& point : fit.points) point.indirect_shadow = 1;
  const auto camera = cameraFrom({3, -4, 1});
  FrameLights lights;
  lights.distant = {sun({-2.5, 4, -1})};
  // By the differences under all lights, 49 dB.
  EXPECT_GT(psnr(renderWith(field, &fit, camera, lights), camera, lights, truth), 55);
}

TEST_F(GuidedInterpolationTest, TheModelAloneNeedsNeitherPhotographsNorAnOpenGate) {
  const auto camera = cameraFrom({3, -4, 1});
  FrameLights lights;
  lights.distant = {sun({1, -1, 0.7})};
  const auto alone = [&](const test::FormulaField& field, float gate) {
    const ReflectanceFit fit = fitOf(field, gate);
    return renderWith(field, &fit, camera, lights, Shadows::captured, 1 << 30, true);
  };
  const Frame model = alone(*odd_, 0);
  EXPECT_GT(psnr(model, camera, lights, glossy), 44);
  EXPECT_EQ(model.rgba.data(), alone(*exact_, 1).rgba.data());
}

TEST_F(GuidedInterpolationTest, AClosedGateIsPlainToTheBit) {
  const ReflectanceFit fit = fitOf(*odd_, 0);
  const auto camera = cameraFrom({3, -4, 1});
  FrameLights lights;
  lights.distant = {sun({1, -1, 0.7}), sun({-1, -1, 0.2})};
  EXPECT_EQ(renderWith(*odd_, &fit, camera, lights).rgba.data(),
            renderWith(*odd_, nullptr, camera, lights).rgba.data());
}

TEST_F(GuidedInterpolationTest, SameBitsForAnyNumberOfThreadsAndMemory) {
  const ReflectanceFit fit = fitOf(*odd_, 0.7f);
  const auto camera = cameraFrom({3, -4, 1});
  FrameLights lights;
  lights.distant = sampleEnvironment(ImageF(32, 16, 3, 1.f), 64).lights;
  const auto expected = renderWith(*odd_, &fit, camera, lights, Shadows::deformed).rgba.data();
  EXPECT_EQ(renderWith(*odd_, &fit, camera, lights, Shadows::deformed, 1 << 20).rgba.data(), expected);
  setThreadCount(1);
  EXPECT_EQ(renderWith(*odd_, &fit, camera, lights, Shadows::deformed).rgba.data(), expected);
  setThreadCount(0);
}

TEST_F(GuidedInterpolationTest, IsLinearInTheLights) {
  const ReflectanceFit fit = fitOf(*odd_, 0.8f);
  const auto camera = cameraFrom({3, -4, 1});
  FrameLights a, b, both;
  a.distant = {sun({1, -1, 1})};
  b.near_lights = {{Point<ObjectSpace>(1, -2, 1), {2, 3, 4}}};
  both.distant = {sun({1, -1, 1}, {0.3, 0.3, 0.3})};
  both.near_lights = {{Point<ObjectSpace>(1, -2, 1), {14, 21, 28}}};
  const Frame fa = renderWith(*odd_, &fit, camera, a), fb = renderWith(*odd_, &fit, camera, b);
  const Frame sum = renderWith(*odd_, &fit, camera, both);
  for (std::size_t i = 0; i < sum.rgba.data().size(); ++i) {
    if (i % 4 == 3) continue;
    const double expected = 0.3 * fa.rgba.data()[i] + 7.0 * fb.rgba.data()[i];
    // Differences of model values are added in floats about as large as the picture's.
    ASSERT_NEAR(sum.rgba.data()[i], expected, 3e-6 * std::max(expected, 1.0));
  }
}

}  // namespace
}  // namespace srf
