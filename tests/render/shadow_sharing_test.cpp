#include "render/shadow_sharing.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <random>
#include <set>

#include "base/numeric.h"
#include "base/parallel.h"
#include "model/deformation.h"
#include "render/frame_renderer.h"
#include "render/light_clusters.h"
#include "render/light_set.h"
#include "tests/support/glossy_sphere.h"
#include "tests/support/test_support.h"

namespace srf {
namespace {

/// Lights all over the sphere, each a cluster.
LightClusters spread(std::size_t count) {
  LightClusters clusters;
  for (std::size_t i = 0; i <= count; ++i) clusters.first.push_back(static_cast<std::uint32_t>(i));
  for (std::size_t i = 0; i < count; ++i)
    clusters.direction.push_back(
        Direction<ObjectSpace>::fromUnit(test::fibonacci(static_cast<int>(i), static_cast<int>(count))));
  return clusters;
}

TEST(SharedShadowRays, GoToTheBrightestAndToAQuarterOfTheOthersAndAreNotMore) {
  std::mt19937 random(3);
  SharedShadowRays rays;
  for (int trial = 0; trial < 500; ++trial) {
    const std::size_t lights = 16 * (1 + random() % 20), sharers = 1 + random() % kMostSharers, most = random() % 40;
    const unsigned quarter = random() % 4;
    std::vector<float> keys(lights);
    for (float& key : keys) key = std::max(0.f, std::uniform_real_distribution<float>(-0.5f, 1)(random));
    const auto lit = static_cast<std::size_t>(std::count_if(keys.begin(), keys.end(), [](float k) { return k > 0; }));
    const LightClusters clusters = spread(lights);
    const NearClusters near = nearClusters(clusters, kOneShadow);
    rays.choose(keys, clusters, near, quarter, sharers, most);
    ASSERT_TRUE(rays.alike.empty());  // so far apart
    ASSERT_LE(rays.each.size() * sharers + rays.once.size(), sharers * most);
    ASSERT_GE(rays.each.size(), std::min(lit, (most + 3) / 4));
    if (sharers == 1 || lit <= most) {
      ASSERT_EQ(rays.each.size(), std::min(lit, most));
      ASSERT_TRUE(rays.once.empty());
    }
    const std::set<std::uint32_t> each(rays.each.begin(), rays.each.end());
    std::set<std::uint32_t> asked = each;
    for (const std::uint32_t light : rays.once) {
      ASSERT_EQ(light % 4, quarter);
      ASSERT_TRUE(asked.insert(light).second);  // none twice
    }
    // No light that is left is brighter than one that is asked after for the same reason.
    float least_of_each = 2, least_of_once = 2;
    for (const std::uint32_t light : rays.each) least_of_each = std::min(least_of_each, keys[light]);
    for (const std::uint32_t light : rays.once) least_of_once = std::min(least_of_once, keys[light]);
    for (std::uint32_t k = 0; k < lights; ++k) {
      ASSERT_TRUE(each.contains(k) || keys[k] <= least_of_each);
      ASSERT_TRUE(asked.contains(k) || k % 4 != quarter || rays.once.empty() || keys[k] <= least_of_once);
    }
    for (const std::uint32_t light : asked) ASSERT_GT(keys[light], 0);
    // Strong lights: a few that give most.
    const std::size_t strong = 1 + random() % 5;
    for (std::size_t i = 0; i < strong; ++i) keys[(7 * i + quarter) % lights] = static_cast<float>(lights);
    rays.choose(keys, clusters, near, quarter, sharers, most);
    ASSERT_LE(rays.each.size() * sharers + rays.once.size(), sharers * most);
    for (std::size_t i = 0; i < strong && (strong + (most + 3) / 4 <= most || (sharers == 1 && strong <= most)); ++i)
      ASSERT_TRUE(std::binary_search(rays.each.begin(), rays.each.end(), (7 * i + quarter) % lights));
  }
}

// A sun of thirty lights beside a sky: weak each, they throw one outline, which neighbours may not tell.
TEST(SharedShadowRays, OfASunOfManyLightsEachHitAsksAfterAsManyAsItCanAndTakesTheOthersForAlike) {
  LightClusters clusters = spread(192);
  std::vector<float> keys(192, 1.f);
  for (std::size_t i = 0; i < 30; ++i) {
    const double around = 2.4 * static_cast<double>(i), away = radians(0.2) * std::sqrt(static_cast<double>(i));
    clusters.direction[3 * i] = *normalize(Vector<ObjectSpace>(away * std::cos(around), away * std::sin(around), 1));
    keys[3 * i] = 20 + static_cast<float>(i % 7);
  }
  const auto isSun = [](std::uint32_t light) { return light % 3 == 0 && light < 90; };
  const NearClusters near = nearClusters(clusters, kOneShadow);
  SharedShadowRays rays;
  for (unsigned quarter = 0; quarter < 4; ++quarter) {
    rays.choose(keys, clusters, near, quarter, 4, 8);
    ASSERT_EQ(rays.each.size(), 6u);
    EXPECT_TRUE(std::all_of(rays.each.begin(), rays.each.end(), isSun));
    EXPECT_EQ(rays.once.size(), 4u);
    EXPECT_TRUE(std::none_of(rays.once.begin(), rays.once.end(), isSun));
    std::size_t suns_alike = 0;
    for (const auto& [light, as] : rays.alike) {
      suns_alike += isSun(light);
      EXPECT_TRUE(std::binary_search(rays.each.begin(), rays.each.end(), as));
      EXPECT_GT(dot(clusters.direction[light].raw(), clusters.direction[as].raw()), std::cos(kOneShadow) - 1e-12);
    }
    EXPECT_EQ(suns_alike, 24u);
  }
}

TEST(LightClusters, NearOnesAreThoseWithinTheAngle) {
  const LightClusters clusters = spread(400);
  const double angle = radians(14);
  const NearClusters near = nearClusters(clusters, angle);
  std::size_t found = 0;
  for (std::uint32_t a = 0; a < 400; ++a) {
    std::vector<std::uint32_t> want;
    for (std::uint32_t b = 0; b < 400; ++b)
      if (b != a && dot(clusters.direction[a].raw(), clusters.direction[b].raw()) >= std::cos(angle)) want.push_back(b);
    ASSERT_TRUE(std::equal(want.begin(), want.end(), near.of(a).begin(), near.of(a).end())) << a;
    found += want.size();
  }
  EXPECT_GT(found, 400u);
}

TEST(SharedShadowRays, CellsSideBySideAskAfterAllQuarters) {
  for (int y = -2; y < 3; ++y)
    for (int x = -2; x < 3; ++x) {
      std::set<unsigned> quarters;
      for (const auto& [i, j] : {std::pair{0, 0}, {1, 0}, {0, 1}, {1, 1}})
        quarters.insert(ShadowCell{x + i, y + j}.quarter());
      EXPECT_EQ(quarters.size(), 4u);
      int of_own = 0;
      for (const ShadowCell& cell : ShadowCell{x, y}.about()) of_own += cell.quarter() == ShadowCell{x, y}.quarter();
      EXPECT_EQ(of_own, 0);
    }
}

TEST(LightClusters, HoldEachLightOnceAndStrongOnesByThemselves) {
  std::mt19937 random(5);
  std::vector<DistantLight> lights;
  for (int i = 0; i < 3000; ++i) {
    const double strength = std::uniform_real_distribution(0.5, 1.5)(random);
    lights.push_back({Direction<ObjectSpace>::fromUnit(test::fibonacci(i, 3000)), {strength, strength, strength}});
  }
  lights[1234].irradiance = {900, 800, 700};
  const Direction<ObjectSpace> sun = lights[1234].direction;
  std::shuffle(lights.begin(), lights.end(), random);
  orderByDirection(lights);
  double apart = 0;  // from one to the next
  for (std::size_t i = 1; i < lights.size(); ++i)
    apart += std::acos(std::clamp(dot(lights[i - 1].direction.raw(), lights[i].direction.raw()), -1.0, 1.0));
  EXPECT_LT(degrees(apart / static_cast<double>(lights.size())),
            7.4);  // twice the 3.7 between neighbours; 90 in no order

  const LightClusters clusters = clusterLights(lights, 256);
  ASSERT_EQ(clusters.count(), 256u);
  ASSERT_EQ(clusters.first.size(), 257u);
  EXPECT_EQ(clusters.first.front(), 0u);
  EXPECT_EQ(clusters.first.back(), lights.size());
  int suns = 0;
  for (std::size_t c = 0; c < clusters.count(); ++c) {
    ASSERT_LT(clusters.first[c], clusters.first[c + 1]);
    for (std::uint32_t i = clusters.first[c]; i < clusters.first[c + 1]; ++i) {
      EXPECT_GT(dot(lights[i].direction.raw(), clusters.direction[c].raw()), std::cos(radians(15)));
      if (dot(lights[i].direction.raw(), sun.raw()) < 1 - 1e-9) continue;
      ++suns;
      EXPECT_LE(clusters.first[c + 1] - clusters.first[c], 2u);
      EXPECT_GT(dot(clusters.direction[c].raw(), sun.raw()), std::cos(radians(0.1)));
    }
  }
  EXPECT_EQ(suns, 1);
}

TEST(LightClusters, FewLightsAndLightsInOneDirectionAreNoCase) {
  std::vector<DistantLight> lights(5, {Direction<ObjectSpace>::fromUnit({0, 0, 1}), {0, 0, 0}});
  for (const std::size_t count : {0, 1, 5}) {
    lights.resize(count, lights.front());
    orderByDirection(lights);
    for (const std::size_t most : {1, 4, 5, 100}) {
      const LightClusters clusters = clusterLights(lights, most);
      EXPECT_EQ(clusters.first.back(), count);
      EXPECT_EQ(clusters.count(), count <= most ? count : 1);
      EXPECT_EQ(clusters.first.size(), clusters.count() + 1);
    }
    if (lights.empty()) lights.push_back({Direction<ObjectSpace>::fromUnit({0, 0, 1}), {0, 0, 0}});
  }
}

/// A sphere drawn out and bent to a horseshoe, whose arms shade each other, under a sky.
class SharedShadowsTest : public test::FittedSphereTest {
 protected:
  static void SetUpTestSuite() { setUp({}, test::glossy, 1); }
  static Camera<ObjectSpace> camera() {
    Camera<ObjectSpace> camera;
    camera.lens = pinholeFromFov(72, 72, 40);
    camera.pose = *lookAt(Point<ObjectSpace>(0.5, -6, 3), Point<ObjectSpace>(0, 0, 0.6), Vector<ObjectSpace>(0, 0, 1));
    return camera;
  }
  static void bend(DeformedModel& model) {
    const char* text = R"([{"type":"affine","matrix":[[2.6,0,0,0],[0,0.6,0,0],[0,0,0.6,0],[0,0,0,1]]},
                           {"type":"bend","axis":[1,0,0],"toward":[0,0,1],"degrees_per_unit":65}])";
    model.deform(AnimatedDeformation::parse(parseJson(text, "test"), ".", Reporter::silent()).at(0));
  }
  static FrameLights sky(int count = 200) {
    FrameLights lights;
    for (int i = 0; i < count; ++i) {
      const Vec3 to = test::fibonacci(i, count);
      const double strength = 4.0 / count * (1.2 + to.z) * (i % 37 == 0 ? 8 : 1);
      lights.distant.push_back({Direction<ObjectSpace>::fromUnit(to), {strength, strength, 1.2 * strength}});
    }
    return lights;
  }
  static FrameSettings settings(int rays, int samples) {
    FrameSettings settings;
    settings.fit = fit_.get();
    settings.shadows = Shadows::deformed;
    settings.samples = samples;
    settings.accuracy.shadow_rays = rays;
    return settings;
  }
  static ImageF picture(const FrameSettings& settings, int lights = 200) {
    DeformedModel deformed(field_->model);
    bend(deformed);
    FrameRenderer renderer(field_->folder, field_->manifest, field_->model, settings, Reporter::silent());
    return renderer.render(camera(), deformed, sky(lights)).rgba;
  }
  /// Root of the mean squared difference over the root of the mean square.
  static double difference(const ImageF& image, const ImageF& reference) {
    double error = 0, sum = 0;
    for (std::size_t i = 0; i < image.data().size(); ++i) {
      error += square(double{image.data()[i]} - reference.data()[i]);
      sum += square(double{reference.data()[i]});
    }
    return std::sqrt(error / sum);
  }
};

TEST_F(SharedShadowsTest, AFewRaysAHitShowWhatARayToEveryLightDoes) {
  // Each for itself they leave three quarters of the error that none leaves.
  const std::pair<int, double> most_left[] = {{1, 0.3}, {4, 0.2}};  // of one and of four samples a pixel
  for (const auto& [samples, share] : most_left) {
    const ImageF every = picture(settings(1000, samples));
    const double none = difference(picture(settings(0, samples)), every);
    EXPECT_GT(none, 0.03);
    EXPECT_LT(difference(picture(settings(12, samples)), every), share * none) << samples;
  }
}

TEST_F(SharedShadowsTest, AFewRaysAHitAreEnoughForThousandsOfLights) {
  const ImageF every = picture(settings(100000, 1), 3000);
  const double none = difference(picture(settings(0, 1), 3000), every);
  EXPECT_GT(none, 0.03);
  EXPECT_LT(difference(picture(settings(16, 1), 3000), every), 0.35 * none);
}

TEST_F(SharedShadowsTest, TheOutlineOfASunOfManyLightsIsAsSharpAsTheirRays) {
  // Twenty lights within a degree, and a weak sky.
  const auto lit = [](int rays) {
    FrameLights lights = sky();
    for (DistantLight& light : lights.distant) light.irradiance = 0.3 * light.irradiance;
    for (int i = 0; i < 20; ++i) {
      const double around = 2.4 * i, away = radians(0.1) * std::sqrt(i);
      const Vec3 to{0.9 + away * std::cos(around), -0.4 + away * std::sin(around), 0.6};
      lights.distant.push_back({*normalize(Vector<ObjectSpace>(to)), {0.15, 0.14, 0.12}});
    }
    DeformedModel deformed(field_->model);
    bend(deformed);
    FrameRenderer renderer(field_->folder, field_->manifest, field_->model, settings(rays, 1), Reporter::silent());
    return renderer.render(camera(), deformed, lights).rgba;
  };
  const ImageF every = lit(1000);
  EXPECT_LT(difference(lit(8), every), 0.25 * difference(lit(0), every));
}

TEST_F(SharedShadowsTest, SameBitsForAnyNumberOfThreadsAndMemory) {
  for (const int samples : {1, 9}) {
    FrameSettings with = settings(6, samples);
    const auto expected = picture(with, 300).data();
    with.memory_bytes = 1 << 20;
    EXPECT_EQ(picture(with, 300).data(), expected);
    setThreadCount(1);
    EXPECT_EQ(picture(settings(6, samples), 300).data(), expected);
    setThreadCount(0);
  }
}

TEST_F(SharedShadowsTest, AnExplainedPixelIsTheRenderedOneToTheBit) {
  for (const int samples : {1, 4})
    for (const Shading shading : {Shading::every, Shading::sparse}) {
      FrameSettings with = settings(5, samples);
      with.accuracy.shading = shading;
      DeformedModel deformed(field_->model);
      bend(deformed);
      FrameRenderer renderer(field_->folder, field_->manifest, field_->model, with, Reporter::silent());
      const Frame frame = renderer.render(camera(), deformed, sky());
      int met = 0;
      for (int y = 1; y < 72; y += 5)
        for (int x = 2; x < 72; x += 6) {
          const PixelExplanation why = renderer.explain(camera(), deformed, sky(), x, y);
          met += !why.hits.empty();
          // A pixel in between is explained as if it were shaded; these are.
          const bool shaded =
              shading == Shading::every || samples > 1 || (x % 2 == 0 && y % 2 == 0 && x % 16 < 13 && y % 16 < 13);
          for (int c = 0; c < 4 && shaded; ++c) ASSERT_EQ(why.rgba[c], frame.rgba.at(x, y, c)) << x << " " << y;
        }
      EXPECT_GT(met, 30);
    }
}

}  // namespace
}  // namespace srf
