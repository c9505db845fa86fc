#include "render/effects.h"

#include <gtest/gtest.h>

#include <cmath>
#include <set>

#include "base/files.h"
#include "base/image_io.h"
#include "base/numeric.h"
#include "render/animation.h"
#include "render/ground.h"
#include "render/pixel_rays.h"
#include "tests/support/formula_field.h"
#include "tests/support/test_support.h"

namespace srf {
namespace {

namespace fs = std::filesystem;

Camera<ObjectSpace> cameraAt(const Vec3& eye, int size = 32) {
  return {pinholeFromFov(size, size, 40),
          *lookAt(Point<ObjectSpace>(eye), Point<ObjectSpace>(), Vector<ObjectSpace>(0, 0, 1))};
}

TEST(ThinLens, RaysOfAPixelMeetInThePlaneOfFocusAndPassTheLensEvenly) {
  const Camera<ObjectSpace> camera = cameraAt({0.3, -4, 1});
  const ThinLens lens{0.2, 3};
  const Ray<ObjectSpace> chief = *camera.ray({7.5, 20.25});
  const int samples = 256;
  Vec3 mean;
  double mean_square = 0;
  for (int i = 0; i < samples; ++i) {
    const Ray<ObjectSpace> ray = throughLens(lens, camera, chief, 7, 20, i, samples);
    const Vector<ObjectSpace> aside = ray.origin - camera.center();
    EXPECT_NEAR(dot(aside, camera.forward()), 0, 1e-12);  // in the plane of the lens
    EXPECT_LE(length(aside), lens.aperture * (1 + 1e-12));
    mean += aside.raw() / samples;
    mean_square += dot(aside, aside) / samples;
    const auto at_focus = [&](const Ray<ObjectSpace>& r) {
      return r.origin + (lens.focus - dot(r.origin - camera.center(), camera.forward())) /
                            dot(r.direction, camera.forward()) * r.direction;
    };
    EXPECT_LT(distance(at_focus(ray), at_focus(chief)), 1e-12);
  }
  EXPECT_LT(length(mean), 0.02 * lens.aperture);
  EXPECT_NEAR(mean_square, lens.aperture * lens.aperture / 2, 0.02 * lens.aperture * lens.aperture);  // of a disc
}

TEST(Effects, TheShutterIsCentredOnItsFrame) {
  Effects effects;
  EXPECT_EQ(momentsOf(effects, 7), std::vector<double>{7});
  effects.motion_blur = MotionBlur{Animated<double>(0.5), 4};
  const std::vector<double> want{6.8125, 6.9375, 7.0625, 7.1875};
  EXPECT_EQ(momentsOf(effects, 7), want);
  effects.motion_blur->shutter = Animated<double>(0);
  EXPECT_EQ(momentsOf(effects, 7), std::vector<double>{7});
}

class GroundTest : public testing::Test {
 protected:
  /// The ground at a place, seen from above.
  GroundSample at(double x, double y, const GroundPlane& plane, const FrameLights& lights, int shadow_rays = 32) const {
    const GroundShading ground(plane, lights, object_, {shadow_rays, 1e-6});
    const std::vector<Ray<ObjectSpace>> rays{
        {Point<ObjectSpace>(x, y, plane.height + 0.5), Direction<ObjectSpace>::fromUnit({0, 0, -1})}};
    const std::vector<std::uint32_t> pixel{next_pixel_++};  // each its own noise
    std::vector<SurfaceHit> hits(1);
    std::vector<GroundSample> samples;
    cast_ = ground.shade(rays, pixel, 8, hits, samples);
    EXPECT_EQ(samples.size(), 1u);
    return samples.front();
  }

  test::TemporaryFolder folder_;
  test::FormulaField field_ = test::makeSphereField(folder_ / "x.srf", {.views = 4, .lights = 4, .size = 16},
                                                    [](const Vec3&, const Vec3&, const Vec3&) {
                                                      return Vec3{1, 1, 1};
                                                    });
  DeformedModel object_{field_.model};  // the unit sphere
  mutable std::uint64_t cast_ = 0;
  mutable std::uint32_t next_pixel_ = 0;
};

TEST_F(GroundTest, ShadowOfASphereLiesWhereALightPutsIt) {
  FrameLights lights;
  lights.distant.push_back({Direction<ObjectSpace>::fromUnit({0.6, 0, 0.8}), {2, 2, 2}});
  GroundPlane plane{-2, {0.5, 0.25, 1}, true};
  // The axis of the shadow meets the plane at x = -2 * 0.6 / 0.8; across it the shadow is as wide as the sphere.
  const double middle = -1.5;
  EXPECT_EQ(at(middle, 0, plane, lights).rgba[3], 1);
  EXPECT_EQ(at(middle, 0.99, plane, lights).rgba[3], 1);
  EXPECT_EQ(at(middle, 1.01, plane, lights).rgba[3], 0);
  EXPECT_EQ(at(middle + 1.24, 0, plane, lights).rgba[3], 1);  // along it 1 / 0.8 as long
  EXPECT_EQ(at(middle + 1.26, 0, plane, lights).rgba[3], 0);

  plane.shadow_only = false;
  const auto lit = at(5, 0, plane, lights).rgba;
  for (int c = 0; c < 3; ++c) EXPECT_NEAR(lit[c], plane.albedo[c] / kPi * 2 * 0.8, 1e-6);
  EXPECT_EQ(lit[3], 1);
  EXPECT_EQ(at(middle, 0, plane, lights).rgba, (std::array<float, 4>{0, 0, 0, 1}));
  // A second light of a third of the irradiance: the shadow of the first keeps a quarter of the light.
  lights.near_lights.push_back({Point<ObjectSpace>(middle, 0, 0), Vec3{1, 1, 1} * (4 * 2 * 0.8 / 3)});
  plane.shadow_only = true;
  EXPECT_NEAR(at(middle, 0, plane, lights).rgba[3], 0.75, 1e-6);
}

TEST_F(GroundTest, FewRaysTellTheSameInTheMeanAndTheSameWhereNothingIsInTheWay) {
  FrameLights lights;
  for (int i = 0; i < 400; ++i) {
    const Vec3 direction = test::fibonacci(i, 400);
    lights.distant.push_back({Direction<ObjectSpace>::fromUnit(direction), Vec3{0.1, 0.2, 0.3} * (1 + direction.x)});
  }
  const GroundPlane plane{-1.2, {1, 1, 1}, false};
  double few = 0, all = 0;
  std::uint64_t most = 0;
  for (int i = 0; i < 200; ++i) {
    const double x = -2 + 0.02 * i;
    few += at(x, 0.3, plane, lights, 8).rgba[1];
    most = std::max(most, cast_);
    all += at(x, 0.3, plane, lights, 400).rgba[1];
  }
  EXPECT_LE(most, 8u);
  EXPECT_NEAR(few / all, 1, 0.02);
  EXPECT_EQ(at(1e4, 0, plane, lights, 1).rgba, at(1e4, 0, plane, lights, 400).rgba);
}

/// Frames of a scene file, as users get them.
class EffectScenes : public testing::Test {
 protected:
  void SetUp() override {
    const auto field = test::makeSphereField(folder_ / "x.srf", {.views = 8, .lights = 8, .size = 24, .subdivision = 3},
                                             [](const Vec3& p, const Vec3& l, const Vec3&) {
                                               return std::max(0.0, dot(p, l)) * (Vec3{0.3, 0.3, 0.3} + 0.2 * p);
                                             });
    writeManifest(folder_ / "x.srf", field.manifest);
    storeModel(folder_ / "x.srf", field.model, "sphere");
    writeTextFile(folder_ / "scene.json", R"({"srf": "x.srf", "frames": "4",
      "camera": {"w": 24, "h": 20, "vfov": 40, "look_at": {"eye": {"keys": [[0, [-2, -4, 1]], [9, [2, -4, 1]]]},
                 "target": [0, 0, 0], "up": [0, 0, 1]}},
      "deformation": [{"type": "twist", "axis": [0, 0, 1], "degrees_per_unit": {"keys": [[0, 0], [9, 90]]}}],
      "lights": [{"type": "directional", "direction": [0, -1, 1], "irradiance": [1, 1, 1]}]})");
  }
  ImageF render(const std::vector<std::string>& overrides = {}) {
    reporter_.emplace(ProgressMode::none, LogLevel::error);
    AnimationOptions options;
    options.output = (folder_ / "f.####.exr").string();
    const auto frames = renderAnimation(readScene(folder_ / "scene.json", overrides, *reporter_), options, *reporter_);
    return readImage(frames.at(0).file).pixels;
  }

  test::TemporaryFolder folder_;
  std::optional<Reporter> reporter_;
};

// A pattern that lies to one side would move the picture, by other amounts for other numbers of samples.
TEST(SamplePattern, IsCentredOnThePixelAndEven) {
  for (int samples = 1; samples <= 64; ++samples) {
    const std::vector<Vec2> pattern = samplePattern(samples);
    ASSERT_EQ(pattern.size(), static_cast<std::size_t>(samples));
    double x = 0, y = 0;
    std::set<std::pair<double, double>> places;
    for (const Vec2& at : pattern) {
      EXPECT_TRUE(at.x > 0 && at.x < 1 && at.y > 0 && at.y < 1) << samples;
      x += at.x / samples, y += at.y / samples;
      places.insert({at.x, at.y});
    }
    EXPECT_NEAR(x, 0.5, 1e-12) << samples;
    EXPECT_NEAR(y, 0.5, 1e-12) << samples;
    EXPECT_EQ(places.size(), pattern.size()) << samples;
  }
}

TEST_F(EffectScenes, BlurIsTheMeanOfItsMoments) {
  const ImageF blurred = render({R"(/effects={"motion_blur": {"shutter": 2, "samples": 2}})"});
  const ImageF before = render({"/frames=3"}), at = render({"/frames=4"});
  // Moments 3.5 and 4.5 lie between keys: the same as whole frames of a scene that counts twice as fast.
  double difference = 0;
  for (std::size_t i = 0; i < at.data().size(); ++i) difference += std::fabs(blurred.data()[i] - at.data()[i]);
  EXPECT_GT(difference, 0.1);  // it does something
  const std::string faster = R"(/camera/look_at/eye={"keys": [[0, [-2, -4, 1]], [18, [2, -4, 1]]]})";
  const std::string turned = R"(/deformation/0/degrees_per_unit={"keys": [[0, 0], [18, 90]]})";
  const ImageF first = render({faster, turned, "/frames=7"}), second = render({faster, turned, "/frames=9"});
  for (std::size_t i = 0; i < blurred.data().size(); ++i)
    ASSERT_NEAR(blurred.data()[i], (first.data()[i] + second.data()[i]) / 2, 1e-3) << i;  // halves
}

TEST_F(EffectScenes, WhatIsNotAskedForIsNotDone) {
  render();
  const auto counters = reporter_->counters();
  for (const char* name : {"ground.samples", "ground.shadow_rays", "shadow_rays", "model_values"})
    EXPECT_FALSE(counters.contains(name)) << name;
  const ImageF plain = render();
  // A ground that the camera does not see, a lens of no width, a shutter that does not open: the same picture.
  const ImageF off = render({R"(/effects={"ground": {"height": 9}, "depth_of_field": {"aperture": 0, "focus": 4},
                                          "motion_blur": {"shutter": 0}})"});
  EXPECT_EQ(plain.data(), off.data());
}

// What stands in the plan for an effect alone is counted by it alone, and the rest of the frame does the same work.
TEST_F(EffectScenes, AKeyAddsItsOwnWorkAndNoOther) {
  const std::set<std::string> of_effects{"ground.samples", "ground.shadow_rays", "shadow_rays",
                                         "model_values",   "shadows.not_told",   "support"};
  render();
  const auto bare = reporter_->counters();
  for (const auto& [name, value] : bare) EXPECT_FALSE(of_effects.contains(name)) << name;
  EXPECT_FALSE(reporter_->figures().contains("support.supported"));
  EXPECT_FALSE(reporter_->figures().contains("seconds.ground"));
  EXPECT_FALSE(reporter_->figures().contains("seconds.shadows"));
  struct Added {
    const char* key;
    std::set<std::string> counters;
  };
  for (const Added& added :
       {Added{R"(/effects={"ground": {"height": -1.2}})", {"ground.samples", "ground.shadow_rays"}},
        Added{R"(/effects={"shadows": "deformed"})", {"shadow_rays"}},
        Added{R"(/effects={"shadows": "both"})", {"shadow_rays"}}, Added{R"(/effects={"matte": true})", {}}}) {
    render({added.key});
    std::set<std::string> more;
    for (const auto& [name, value] : reporter_->counters()) {
      if (!bare.contains(name)) {
        more.insert(name);
      } else if (name != "operations" && name != "light_vectors") {  // weights of their own are not shared
        EXPECT_EQ(value, bare.at(name)) << added.key << " " << name;
      }
    }
    EXPECT_EQ(more, added.counters) << added.key;
  }
}

// A convex object casts no shadow on itself: rays change nothing, whether they divide the rest pose's out or not.
TEST_F(EffectScenes, ShadowsOfAConvexObjectAreThoseOfThePhotographs) {
  const ImageF captured = render({"/accuracy/light_sharing=0"});
  for (const char* shadows : {"deformed", "both", "off"}) {
    const ImageF by_rays =
        render({"/accuracy/light_sharing=0", std::string(R"(/effects={"shadows": ")") + shadows + "\"}"});
    double most = 0, brightest = 0;
    for (std::size_t i = 0; i < captured.data().size(); ++i) {
      most = std::max(most, std::fabs(double{by_rays.data()[i]} - captured.data()[i]));
      brightest = std::max(brightest, double{captured.data()[i]});
    }
    EXPECT_GT(brightest, 0.1);
    EXPECT_LT(most, 2e-3 * brightest) << shadows;  // halves
  }
}

TEST_F(EffectScenes, AGroundHidesWhatLiesBelowItAndLeavesTheRestAlone) {
  const ImageF plain = render(), ground = render({R"(/effects={"ground": {"height": 0.2, "shadow_only": true}})"});
  std::size_t hidden = 0, same = 0;
  for (std::size_t i = 0; i < plain.data().size(); i += 4) {
    if (plain.data()[i + 3] == 0) continue;
    const bool equal = std::equal(&plain.data()[i], &plain.data()[i] + 4, &ground.data()[i]);
    same += equal, hidden += !equal;
  }
  EXPECT_GT(hidden, 20u);
  EXPECT_GT(same, 20u);
}

}  // namespace
}  // namespace srf
