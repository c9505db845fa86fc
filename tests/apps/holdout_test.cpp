// Hold-out: what is left out has no part in the prediction, and all else does.
#include "apps/holdout.h"

#include <gtest/gtest.h>

#include <cmath>

#include "render/frame_renderer.h"
#include "tests/support/formula_field.h"
#include "tests/support/test_support.h"

namespace srf {
namespace {

constexpr int kViews = 8, kLights = 12, kView = 3, kLight = 5;

/// A sphere of one colour, but for view kView and light kLight, which show others.
class HoldoutTest : public testing::Test {
 protected:
  void SetUp() override {
    const Vec3 odd_view = test::fibonacci(kView, kViews), odd_light = test::fibonacci(kLight, kLights);
    field_ =
        test::makeSphereField(folder_ / "x.srf", {.views = kViews, .lights = kLights, .size = 32, .subdivision = 3},
                              [&](const Vec3&, const Vec3& l, const Vec3& v) {
                                const double value = dot(v, odd_view) > 0.9 ? 3 : 1;
                                return Vec3{1, 1, 1} * (dot(l, odd_light) > 0.999 ? 10 * value : value);
                              });
  }
  /// Of the prediction inside the silhouette, and of the photograph.
  std::pair<double, double> means(const LeftOut& out, std::size_t view, std::size_t light) {
    const SrfManifest left = without(field_.manifest, out);
    DeformedModel deformed(field_.model);
    FrameRenderer renderer(field_.folder, left, field_.model, {}, Reporter::silent());
    const StoredView& at = field_.manifest.views[view];
    const auto photograph = storedPhotograph(field_.folder, at, light);
    const Frame frame = renderer.render(atRest(at.camera), deformed, asSceneLight(field_.manifest, at.lights[light]));
    double predicted = 0, true_mean = 0, pixels = 0;
    for (int y = 0; y < 32; ++y)
      for (int x = 0; x < 32; ++x)
        if (photograph.inside.at(x, y) > 0 && frame.rgba.at(x, y, 3) > 0)
          predicted += frame.rgba.at(x, y, 0), true_mean += photograph.rgb.at(x, y, 0), ++pixels;
    EXPECT_GT(pixels, 100);
    last_ = scorePrediction(frame.rgba, photograph.rgb, photograph.inside);
    return {predicted / pixels, true_mean / pixels};
  }

  test::TemporaryFolder folder_;
  test::FormulaField field_;
  PredictionScore last_;
  LeftOut nothing_{std::vector<std::uint8_t>(kViews, 0), std::vector<std::uint8_t>(kLights, 0)};
};

TEST_F(HoldoutTest, WithNothingLeftOutThePhotographReturns) {
  const auto [predicted, photographed] = means(nothing_, kView, kLight);
  EXPECT_NEAR(photographed, 30, 0.1);
  EXPECT_NEAR(predicted, 30, 0.3);
  EXPECT_LT(last_.difference2 / last_.square2, 0.02);  // pixels of the rim that the facets miss
}

TEST_F(HoldoutTest, WhatIsLeftOutHasNoPart) {
  LeftOut view = nothing_, light = nothing_, both = nothing_;
  view.views[kView] = light.lights[kLight] = both.views[kView] = both.lights[kLight] = 1;
  EXPECT_NEAR(means(view, kView, kLight).first, 10, 0.1);
  EXPECT_NEAR(last_.difference2 / last_.square2, 4.0 / 9, 0.05);  // (30 - 10)^2 / 30^2, less at the rim
  EXPECT_NEAR(means(light, kView, kLight).first, 3, 0.05);
  EXPECT_NEAR(means(both, kView, kLight).first, 1, 0.01);
  // Another view and light as ever.
  EXPECT_NEAR(means(both, 6, 1).first, 1, 0.01);
}

TEST(PowerLaw, IsFoundWhereItHolds) {
  std::vector<std::array<double, 2>> measured;
  for (const double n : {12.0, 24.0, 48.0}) measured.push_back({n, 0.9 * std::pow(n, -0.7)});
  const PowerLaw law = fitPowerLaw(measured);
  EXPECT_NEAR(law.exponent, 0.7, 1e-12);
  EXPECT_NEAR(law.at(96), 0.9 * std::pow(96, -0.7), 1e-12);
}

TEST(FarthestFirst, HalfOfAGridIsNotHalfOfTheSphere) {
  std::vector<Vec3> directions;
  for (int i = 0; i < 64; ++i) directions.push_back(test::fibonacci(i, 64));
  const auto order = farthestFirst(directions);
  ASSERT_EQ(order.size(), 64u);
  double sum = 0;
  for (std::size_t i = 0; i < 16; ++i)
    for (std::size_t k = 0; k < i; ++k) sum = std::max(sum, dot(directions[order[i]], directions[order[k]]));
  EXPECT_LT(sum, std::cos(0.6));  // 16 at their best lie about 0.9 apart
  std::vector<std::size_t> sorted = order;
  std::sort(sorted.begin(), sorted.end());
  for (std::size_t i = 0; i < 64; ++i) EXPECT_EQ(sorted[i], i);
}

}  // namespace
}  // namespace srf
