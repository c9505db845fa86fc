// How much of a frame the capture supports: layers and summary against what the field's own directions say.
#include "render/capture_support.h"

#include <gtest/gtest.h>

#include <cmath>
#include <map>

#include "base/numeric.h"
#include "render/frame_renderer.h"
#include "tests/support/formula_field.h"
#include "tests/support/test_support.h"

namespace srf {
namespace {

class CaptureSupportTest : public testing::Test {
 protected:
  void SetUp() override {
    field_ = test::makeSphereField(folder_ / "x.srf", {.views = 24, .lights = 32, .size = 32, .subdivision = 3},
                                   [](const Vec3& p, const Vec3& l, const Vec3&) {
                                     return std::max(0.0, dot(p, l)) * Vec3{0.3, 0.3, 0.3};
                                   });
    camera_ = atRest(field_.manifest.views[9].camera);
    settings_.layers = {"light_angle", "extrapolation", "occlusion", "confidence"};
    settings_.support = true;
  }
  Frame render(const FrameLights& lights, const std::string& deformation = "[]") {
    DeformedModel deformed(field_.model);
    deformed.deform(AnimatedDeformation::parse(parseJson(deformation, "test"), ".", Reporter::silent()).at(0));
    Reporter reporter(ProgressMode::none, LogLevel::error);
    FrameRenderer renderer(field_.folder, field_.manifest, field_.model, settings_, reporter);
    Frame frame = renderer.render(camera_, deformed, lights);
    figures_ = reporter.figures();
    return frame;
  }
  static FrameLights from(const Vec3& direction) {
    FrameLights lights;
    lights.distant = {{Direction<ObjectSpace>::fromUnit(direction / length(direction)), {1, 1, 1}}};
    return lights;
  }
  double degreesToNearest(const Vec3& direction) const {
    double least = 180;
    for (const CaptureLight& light : field_.manifest.lights)
      if (light.kind != LightKind::captured)
        least = std::min(least, degrees(angleBetweenUnit(direction / length(direction), light.direction.raw())));
    return least;
  }

  test::TemporaryFolder folder_;
  test::FormulaField field_;
  Camera<ObjectSpace> camera_;
  FrameSettings settings_;
  std::map<std::string, double> figures_;  // of the last frame
};

TEST_F(CaptureSupportTest, ACapturedViewUnderACapturedLightIsSupportedWholly) {
  const Frame frame = render(from(field_.manifest.lights[5].direction.raw()));
  ASSERT_TRUE(frame.support);
  EXPECT_GT(frame.support->hits, 50u);
  EXPECT_DOUBLE_EQ(frame.support->share(frame.support->supported), 1);
  for (const char* layer : {"light_angle", "extrapolation", "occlusion"})
    for (const float value : frame.layers.at(layer).data()) ASSERT_NEAR(value, 0, 1e-5) << layer;
}

TEST_F(CaptureSupportTest, TheAngleIsThatToTheNearestLight) {
  const Vec3 direction{0.3, -0.8, 0.9};
  const Frame frame = render(from(direction));
  const double expected = degreesToNearest(direction);
  ASSERT_GT(expected, 2);
  int lit = 0;
  for (int y = 0; y < 32; ++y)
    for (int x = 0; x < 32; ++x)
      if (frame.layers.at("light_angle").at(x, y) > 0) {
        ++lit;
        EXPECT_NEAR(frame.layers.at("light_angle").at(x, y), expected, 1e-4);
      }
  EXPECT_GT(lit, 50);
}

TEST_F(CaptureSupportTest, LightFromWhereNoneWasIsExtrapolated) {
  // Only lights from above are there; one from below shines.
  for (CaptureLight& light : field_.manifest.lights)
    if (light.direction.raw().z < 0.2) light.kind = LightKind::captured;
  const Vec3 below{0, 0, -1};
  ASSERT_GT(degreesToNearest(below), 90);
  const Frame frame = render(from(below));
  double far = 0, shown = 0;
  for (int y = 0; y < 32; ++y)
    for (int x = 0; x < 32; ++x) {
      if (frame.rgba.at(x, y, 3) == 0) continue;
      ++shown;
      far += frame.layers.at("extrapolation").at(x, y);
    }
  EXPECT_GT(far, 0.2 * shown);  // what faces down
  EXPECT_LT(far, 0.9 * shown);
  EXPECT_NEAR(frame.support->share(frame.support->light_far), far / shown, 1e-6);
  EXPECT_NEAR(frame.support->share(frame.support->supported), 1 - far / shown, 1e-6);
}

TEST_F(CaptureSupportTest, WhatNoViewSeesAndWhatIsStretchedIsNotSupported) {
  const FrameLights lights = from(field_.manifest.lights[5].direction.raw());
  const Frame stretched =
      render(lights, R"([{"type": "affine", "matrix": [[3,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]}])");
  EXPECT_GT(stretched.support->share(stretched.support->stretched), 0.3);
  EXPECT_LE(stretched.support->share(stretched.support->supported),
            1 - stretched.support->share(stretched.support->stretched));
  for (std::size_t i = 0; i < field_.model.size(); ++i)
    if (field_.model.p0[i].raw().z > 0)
      for (std::size_t word = 0; word < field_.model.visible.wordsPerPoint(); ++word)
        field_.model.visible.words()[i * field_.model.visible.wordsPerPoint() + word] = 0;
  const Frame hidden = render(lights);
  const double share = hidden.support->share(hidden.support->occluded);
  EXPECT_GT(share, 0.1);
  EXPECT_LT(share, 0.9);
  EXPECT_DOUBLE_EQ(hidden.support->share(hidden.support->supported), 1 - share);
}

TEST_F(CaptureSupportTest, IsNotLookedAtUnlessAskedForAndTellsWhatItTook) {
  render(from({0, -1, 1}));
  ASSERT_TRUE(figures_.contains("seconds.support"));
  EXPECT_GT(figures_.at("seconds.support"), 0);
  settings_.layers.clear(), settings_.support = false;
  const Frame frame = render(from({0, -1, 1}));
  EXPECT_FALSE(frame.support);
  EXPECT_TRUE(frame.layers.empty());
  EXPECT_FALSE(figures_.contains("seconds.support"));
}

}  // namespace
}  // namespace srf
