// Each shortcut against the general way of the same picture (M17), plain and guided: equal to 1e-5 of the brightest
// pixel.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include "render/frame_renderer.h"
#include "tests/support/glossy_sphere.h"
#include "tests/support/test_support.h"

namespace srf {
namespace {

constexpr const char* kQuarterTurn = R"({"type": "affine", "matrix": [[0,-1,0,0.1],[1,0,0,0],[0,0,1,0],[0,0,0,1]]})";

std::string twist(double degrees_per_unit) {
  return R"({"type": "twist", "axis": [0,0,1], "degrees_per_unit": )" + std::to_string(degrees_per_unit) + "}";
}

class ShortcutsTest : public test::FittedSphereTest {
 protected:
  static void SetUpTestSuite() {
    setUp(
        {.views = 16, .lights = 48, .size = 48, .subdivision = 4},
        [](const Vec3& p, const Vec3& l, const Vec3& v) {
          return std::max(0.0, dot(p, l)) * (Vec3{0.3, 0.2, 0.1} + 0.1 * (p + v));
        },
        0.8f);
  }
  static FrameLights lights(int distant) {
    FrameLights lights;
    for (int i = 0; i < distant; ++i)
      lights.distant.push_back({Direction<ObjectSpace>::fromUnit(test::fibonacci(i, distant)), {1, 0.9, 0.8}});
    return lights;
  }
  static Deformation psi(const std::string& list) {
    return AnimatedDeformation::parse(parseJson(list, "test"), ".", Reporter::silent()).at(0);
  }
  static std::vector<float> render(const DeformedModel& deformed, const FrameLights& lights, bool shortcuts) {
    FrameSettings settings;
    settings.shortcuts = shortcuts;
    return render(deformed, lights, settings);
  }
  static std::vector<float> renderGuided(const DeformedModel& deformed, const FrameLights& lights,
                                         Shadows shadows = Shadows::captured) {
    FrameSettings settings;
    settings.fit = fit_.get();
    settings.shadows = shadows;
    settings.accuracy.light_sharing = 1e-4;  // degrees: as fine as the grid of orientations gets
    return render(deformed, lights, settings);
  }
  static std::vector<float> render(const DeformedModel& deformed, const FrameLights& lights,
                                   const FrameSettings& settings) {
    FrameRenderer renderer(field_->folder, field_->manifest, field_->model, settings, Reporter::silent());
    Camera<ObjectSpace> camera;
    camera.lens = pinholeFromFov(40, 40, 36);
    camera.pose = *lookAt(Point<ObjectSpace>(0.5, -5, 1), Point<ObjectSpace>(), Vector<ObjectSpace>(0, 0, 1));
    const Frame frame = renderer.render(camera, deformed, lights);
    const auto data = frame.rgba.data();
    return {data.begin(), data.end()};
  }
  static double difference(const std::vector<float>& a, const std::vector<float>& b) {
    double most = 0, brightest = 0;
    for (std::size_t i = 0; i < a.size(); ++i) {
      most = std::max(most, std::fabs(double{a[i]} - b[i]));
      if (i % 4 < 3) brightest = std::max(brightest, double{a[i]});
    }
    EXPECT_GT(brightest, 0.1);
    return most / brightest;
  }
};

TEST_F(ShortcutsTest, OneVectorForARigidFrame) {
  for (const std::string& list : {std::string("[]"), "[" + std::string(kQuarterTurn) + "]"}) {
    DeformedModel deformed(field_->model);
    deformed.deform(psi(list));
    const auto shortcut = render(deformed, lights(40), true), general = render(deformed, lights(40), false);
    EXPECT_NE(shortcut, general) << "the general way is not taken";
    EXPECT_LT(difference(shortcut, general), 1e-5) << list;
  }
}

TEST_F(ShortcutsTest, AModelAtRestIsTheOneDeformedByNothing) {
  DeformedModel rest(field_->model), deformed(field_->model);
  deformed.deform(psi("[" + twist(0) + "]"));
  EXPECT_LT(difference(render(rest, lights(3), true), render(deformed, lights(3), true)), 1e-5);
}

// A few lights are entries at each hit, many a vector: one light in forty parts is one light.
TEST_F(ShortcutsTest, OneLightIsThatLightInManyParts) {
  DeformedModel deformed(field_->model);
  deformed.deform(psi("[" + twist(40) + "]"));
  FrameLights one, many;
  const auto direction = Direction<ObjectSpace>::fromUnit(Vec3{0, -0.6, 0.8});
  one.distant = {{direction, {1, 0.9, 0.8}}};
  for (int i = 0; i < 40; ++i) many.distant.push_back({direction, Vec3{1, 0.9, 0.8} / 40});
  EXPECT_LT(difference(render(deformed, one, true), render(deformed, many, false)), 1e-5);
}

// No environment: what an environment of one black sample adds is nothing.
TEST_F(ShortcutsTest, NoEnvironmentIsABlackOne) {
  DeformedModel deformed(field_->model);
  deformed.deform(psi("[" + twist(40) + "]"));
  FrameLights with_black = lights(1);
  for (int i = 0; i < 30; ++i)
    with_black.distant.push_back({Direction<ObjectSpace>::fromUnit(test::fibonacci(i, 30)), {0, 0, 0}});
  EXPECT_LT(difference(render(deformed, lights(1), true), render(deformed, with_black, false)), 1e-5);
}

// Guided, hits share vectors however many orientations there are: the one vector of a rigid frame is what shared ones
// come to where their orientations are all but the same, and lie as close as the grid can have them.
TEST_F(ShortcutsTest, GuidedOneVectorForARigidFrame) {
  for (const std::string& turn : {std::string(), std::string(kQuarterTurn) + ","})
    for (const Shadows shadows : {Shadows::captured, Shadows::deformed}) {
      DeformedModel rigid(field_->model), bent(field_->model);
      rigid.deform(psi("[" + turn + twist(0) + "]"));
      bent.deform(psi("[" + turn + twist(1e-6) + "]"));
      EXPECT_LT(difference(renderGuided(rigid, lights(40), shadows), renderGuided(bent, lights(40), shadows)), 1e-5)
          << turn;
    }
}

TEST_F(ShortcutsTest, GuidedAModelAtRestIsTheOneDeformedByNothing) {
  DeformedModel rest(field_->model), deformed(field_->model);
  deformed.deform(psi("[" + twist(0) + "]"));
  for (const int count : {3, 40})
    EXPECT_LT(difference(renderGuided(rest, lights(count)), renderGuided(deformed, lights(count))), 1e-5) << count;
}

// Guided, fewer distant lights than kFewestShared are each for itself, more are taken together, which is another
// picture (doc/effects.md).
TEST_F(ShortcutsTest, GuidedOneLightIsThatLightInAFewPartsAndBlackOnesAddNothing) {
  DeformedModel deformed(field_->model);
  deformed.deform(psi("[" + twist(40) + "]"));
  const int few = static_cast<int>(FrameLighting::kFewestShared) - 1;
  FrameLights one, parts, black;
  const auto direction = Direction<ObjectSpace>::fromUnit(Vec3{0, -0.6, 0.8});
  one.distant = black.distant = {{direction, {1, 0.9, 0.8}}};
  for (int i = 0; i < few; ++i) parts.distant.push_back({direction, Vec3{1, 0.9, 0.8} / few});
  for (int i = 1; i < few; ++i)
    black.distant.push_back({Direction<ObjectSpace>::fromUnit(test::fibonacci(i, few)), {0, 0, 0}});
  const auto expected = renderGuided(deformed, one);
  EXPECT_LT(difference(expected, renderGuided(deformed, parts)), 1e-5);
  EXPECT_LT(difference(expected, renderGuided(deformed, black)), 1e-5);
}

}  // namespace
}  // namespace srf
