#include "render/light_weights.h"

#include <gtest/gtest.h>

#include <cmath>
#include <random>

#include "base/numeric.h"
#include "render/light_kernels.h"
#include "tests/support/hard_case.h"

namespace srf {
namespace {

Vec3 spiral(int i, int n) {
  const double z = 1 - (2.0 * i + 1) / n, r = std::sqrt(1 - z * z), phi = kPi * (1 + std::sqrt(5.0)) * (i + 0.5);
  return {r * std::cos(phi), r * std::sin(phi), z};
}

using Look = Orthogonal<AcquisitionSpace, ObjectSpace>;

Look randomOrientation(std::mt19937& random, bool reflected = false) {
  std::normal_distribution<double> normal;
  const Mat3 r = rotationFromQuaternion({normal(random), normal(random), normal(random), normal(random)});
  return Look(reflected ? -1.0 * r : r);
}

double angleOf(const Look& a, const Look& b) {
  const Quaternion q = quaternionFromRotation((a.inverse() * b).raw());
  return degrees(2 * std::asin(std::min(1.0, std::sqrt(q.x * q.x + q.y * q.y + q.z * q.z))));
}

// ---- the grid -------------------------------------------------------------------------------------------------------

TEST(OrientationGrid, EveryOrientationIsWithinTheAngleOfACorner) {
  std::mt19937 random(1);
  for (const double angle : {1.0, 5.0, 40.0}) {
    const OrientationGrid grid(angle);
    for (int trial = 0; trial < 5000; ++trial) {
      const Look m = randomOrientation(random, trial % 2);
      const auto blend = grid.blend(m);
      double nearest = 1e9, sum = 0;
      for (int i = 0; i < 4; ++i) {
        EXPECT_GE(blend.share[i], -1e-7f);
        sum += blend.share[i];
        const Look corner = grid.orientation(blend.corner[i]);
        ASSERT_NEAR(determinant(corner), determinant(m), 1e-12);
        nearest = std::min(nearest, angleOf(m, corner));
      }
      EXPECT_NEAR(sum, 1, 1e-6);
      // The tetrahedron of L need not hold the cell's nearest corner; its own nearest is at most sqrt(5)/2 edges away,
      // the radius about the path's ends, of edges that are the angle times 2 / sqrt 3.
      EXPECT_LE(nearest, angle * std::sqrt(5.0 / 3));
    }
  }
}

TEST(OrientationGrid, BlendsContinuouslyAcrossCellsAndCubes) {
  // f(L) = a smooth function, blended along random great circles: no step may be much larger than the path's.
  const OrientationGrid grid(20);
  const auto f = [](const Look& m) { return m.raw().row[0].x + 0.7 * m.raw().row[1].z - 0.4 * m.raw().row[2].y; };
  const auto blended = [&](const Look& m) {
    const auto blend = grid.blend(m);
    double value = 0;
    for (int i = 0; i < 4; ++i)
      if (blend.share[i] > 0) value += blend.share[i] * f(grid.orientation(blend.corner[i]));
    return value;
  };
  std::mt19937 random(2);
  for (int path = 0; path < 20; ++path) {
    const Look start = randomOrientation(random);
    const Vec3 axis = path < 3 ? Vec3{path == 0 ? 1.0 : 0, path == 1 ? 1.0 : 0, path == 2 ? 1.0 : 0} : spiral(path, 20);
    double before = blended(start);
    const int steps = 20000;
    for (int s = 1; s <= steps; ++s) {
      const Look m(rotationAbout(axis, 2 * kPi * s / steps) * (path < 3 ? Mat3{} : start.raw()));
      const double now = blended(m);
      if (path >= 3 || s > 1) {
        ASSERT_LT(std::fabs(now - before), 5 * 2 * kPi / steps) << "path " << path;
      }
      before = now;
    }
  }
}

// ---- light weights --------------------------------------------------------------------------------------------------

struct Stage {
  std::vector<CaptureLight> captured;
  std::vector<AcquiredLights> lists;
  FrameLights lights;
  explicit Stage(int count, int distant) {
    std::vector<LightId> ids;
    for (int i = 0; i < count; ++i) {
      CaptureLight light;
      light.direction = Direction<AcquisitionSpace>::fromUnit(spiral(i, count));
      light.strength = {2, 4, 8};
      captured.push_back(light);
      ids.push_back({static_cast<std::uint32_t>(i)});
    }
    lists.emplace_back(ids, captured, Box<AcquisitionSpace>(), 4);
    // A sky and three lobes, as measured in limits.md.
    for (int i = 0; i < distant; ++i) {
      const Vec3 d = spiral(i, distant);
      double radiance = 0.3 + 0.5 * std::max(0.0, d.z);
      for (const Vec3& lobe : {Vec3{0.6, 0.64, 0.48}, Vec3{-0.8, 0, 0.6}, Vec3{0, -0.96, 0.28}})
        radiance += 6 * std::exp(20 * (dot(d, lobe) - 1));
      const double e = radiance * 4 * kPi / distant;
      lights.distant.push_back({Direction<ObjectSpace>::fromUnit(d), {e, 0.8 * e, 0.5 * e}});
    }
  }
  std::vector<float> weights(const Look& look, double sharing, std::optional<Look> only = {}) const {
    const FrameLighting lighting(lights, lists, {sharing, 1e-3, only});
    LightGather gather;
    SharedLightVectors shared;
    shared.prepare(lighting);
    lighting.gather(0, {Point<AcquisitionSpace>(), Point<ObjectSpace>(), look, {}}, gather);
    shared.want(gather, lighting);
    shared.compute(lighting);
    std::vector<float> scratch(3 * lightPad(lists[0].count()));
    const float* vector = gather.vector(gather.weights[0], lightPad(lists[0].count()), scratch.data());
    return {vector, vector + scratch.size()};
  }
};

TEST(LightKernels, AgreeWithTheNearestLightsInDouble) {
  std::mt19937 random(8);
  std::normal_distribution<double> normal;
  for (const int k : {1, 3, 4, 8}) {
    std::vector<CaptureLight> captured;
    std::vector<LightId> ids;
    for (int i = 0; i < 100; ++i) {
      CaptureLight light;
      light.direction = Direction<AcquisitionSpace>::fromUnit(spiral(i, 100));
      captured.push_back(light);
      ids.push_back({static_cast<std::uint32_t>(i)});
    }
    const AcquiredLights list(ids, captured, Box<AcquisitionSpace>(), k);
    const std::size_t count = 1003, stride = paddedLanes(count);
    std::vector<float> lane[3], weight(k * stride);
    std::vector<std::int32_t> cell(stride);
    std::vector<std::uint32_t> light(k * stride);
    std::vector<Direction<AcquisitionSpace>> directions;
    for (std::size_t i = 0; i < stride; ++i) {
      Vec3 d{normal(random), normal(random), normal(random)};
      if (i % 5 == 0) d = spiral(static_cast<int>(i) % 100, 100) + (i % 3 == 0 ? 0 : 1e-4) * d;  // at or near a light
      if (i % 7 == 0) d = {0, 1, i % 2 ? -1.0 : 1.0};  // where faces of the cube meet
      directions.push_back(*normalize(Vector<AcquisitionSpace>(d)));
      for (int c = 0; c < 3; ++c) lane[c].push_back(static_cast<float>(directions.back().raw()[c]));
    }
    const LightCells cells = *list.cells();
    lightCells(lane[0].data(), lane[1].data(), lane[2].data(), count, cells.resolution, cell.data());
    nearestWeights(cells, lane[0].data(), lane[1].data(), lane[2].data(), cell.data(), count, k, stride, weight.data(),
                   light.data());
    std::vector<Penalised> scratch;
    std::vector<Weighted> nearest;
    double largest = 0;
    for (std::size_t i = 0; i < count; ++i) {
      list.nearest(directions[i], Point<AcquisitionSpace>(), scratch, nearest);
      std::array<double, 100> difference{};
      for (const Weighted& w : nearest) difference[w.source] += w.weight;
      for (int j = 0; j < k; ++j) difference[light[j * stride + i]] -= weight[j * stride + i];
      for (const double d : difference) largest = std::max(largest, std::fabs(d));
    }
    EXPECT_LT(largest, 4e-6) << k;
    EXPECT_GT(largest, 0);
  }
}

TEST(LightKernels, AgreeWithTheOrientationGridInDouble) {
  std::mt19937 random(9);
  const OrientationGrid grid(2);
  const std::size_t count = 2005, stride = paddedLanes(count);
  std::vector<float> m[9], fraction[3];
  std::vector<std::int32_t> code(stride), cell[3];
  OrientationLanes in{};
  OrientationCells out{code.data(), {}, {}};
  std::vector<Look> looks;
  for (std::size_t i = 0; i < stride; ++i) {
    looks.push_back(randomOrientation(random, i % 2));
    if (i % 9 == 0) looks.back() = Look();
    for (int j = 0; j < 9; ++j) m[j].push_back(static_cast<float>(looks[i].raw().row[j / 3][j % 3]));
  }
  for (int j = 0; j < 9; ++j) in.m[j] = m[j].data();
  for (int j = 0; j < 3; ++j) {
    fraction[j].resize(stride), cell[j].resize(stride);
    out.fraction[j] = fraction[j].data(), out.cell[j] = cell[j].data();
  }
  orientationCells(in, count, grid.halfCells(), out);
  for (std::size_t i = 0; i < count; ++i) {
    const auto want = grid.blend(looks[i]);
    const auto got = grid.blend(OrientationGrid::Place{
        code[i], {cell[0][i], cell[1][i], cell[2][i]}, {fraction[0][i], fraction[1][i], fraction[2][i]}});
    const double margin = 2 * 4e-7 * grid.halfCells();  // shares are differences
    for (int a = 0; a < 4; ++a) {
      double wanted = 0, given = 0;
      for (int b = 0; b < 4; ++b) {
        if (want.corner[b] == want.corner[a]) wanted += want.share[b];
        if (got.corner[b] == want.corner[a]) given += got.share[b];
      }
      EXPECT_NEAR(wanted, given, margin) << i;
    }
  }
}

TEST(LightWeights, OfManyHitsAreThoseOfEach) {
  Stage stage(100, 256);
  stage.lights.near_lights.push_back({Point<ObjectSpace>(1, 2, 1), {3, 2, 1}});
  stage.lights.near_lights.push_back({Point<ObjectSpace>(-1, 0, 0.2), {1, 2, 3}});
  stage.lights.rest.push_back({{7}, 0.5});
  std::mt19937 random(10);
  std::normal_distribution<double> normal;
  std::vector<LitPoint> points;
  std::vector<FrameLighting::Wanted> wanted;
  for (std::uint32_t i = 0; i < 77; ++i) {
    points.push_back({Point<AcquisitionSpace>(),
                      Point<ObjectSpace>(0.1 * normal(random), 0.1 * normal(random), 0.1 * normal(random)),
                      randomOrientation(random, i % 2),
                      {}});
    if (i == 5) points.back().p_star = stage.lights.near_lights[1].position;
    if (i % 3 != 1) wanted.push_back({i, 0});
  }
  const FrameLighting lighting(stage.lights, stage.lists, {2, 1e-3, {}});
  LightGather many, each;
  lighting.gather(points, wanted, many);
  for (const auto& one : wanted) lighting.gather(one.list, points[one.point], each);
  ASSERT_EQ(many.weights.size(), wanted.size());
  SharedLightVectors shared;
  shared.prepare(lighting);
  for (LightGather* gather : {&many, &each}) {
    shared.want(*gather, lighting);
    shared.compute(lighting);
  }
  const int pad = lightPad(100);
  std::vector<float> a(3 * pad), b(3 * pad);
  for (std::size_t i = 0; i < wanted.size(); ++i) {
    const float* got = many.vector(many.weights[i], pad, a.data());
    const float* want = each.vector(each.weights[i], pad, b.data());
    double sum = 0;
    for (int j = 0; j < 3 * pad; ++j) sum += want[j];
    for (int j = 0; j < 3 * pad; ++j) EXPECT_NEAR(got[j], want[j], 2e-5 * sum) << i;
    // A hit's weights are its own: alone it gets the same bits.
    LightGather alone;
    lighting.gather(points, {&wanted[i], 1}, alone);
    ASSERT_EQ(alone.weights[0].entries, many.weights[i].entries);
    EXPECT_EQ(alone.weights[0].share, many.weights[i].share);
    for (std::uint32_t e = 0; e < alone.weights[0].entries; ++e) {
      EXPECT_EQ(alone.entries[e].light, many.entries[many.weights[i].first_entry + e].light);
      EXPECT_EQ(alone.entries[e].weight, many.entries[many.weights[i].first_entry + e].weight);
    }
  }
}

TEST(LightWeights, KeepTheLightsEnergy) {
  const Stage stage(100, 256);
  std::mt19937 random(4);
  Vec3 want;
  for (const auto& light : stage.lights.distant) want += light.irradiance;
  for (const double sharing : {0.0, 2.0}) {
    const auto weights = stage.weights(randomOrientation(random), sharing);
    for (int c = 0; c < 3; ++c) {
      double sum = 0;
      for (int j = 0; j < 112; ++j) sum += weights[c * 112 + j] * stage.captured[0].strength[c];
      EXPECT_NEAR(sum / want[c], 1, 1e-6);
      for (int j = 100; j < 112; ++j) EXPECT_EQ(weights[c * 112 + j], 0);
    }
  }
}

TEST(LightWeights, OneOrientationIsExactWhateverTheSharing) {
  const Stage stage(100, 256);
  std::mt19937 random(5);
  const Look look = randomOrientation(random, true);
  const auto exact = stage.weights(look, 0), shared = stage.weights(look, 5, look);
  for (std::size_t i = 0; i < exact.size(); ++i) EXPECT_NEAR(shared[i], exact[i], 1e-5 * (1e-3 + exact[i]));
}

TEST(LightWeights, SharingStaysNearTheExactSetting) {
  // Lambert and Phong(30) under the lights that the weights stand for.
  const Stage stage(100, 256);
  std::mt19937 random(6);
  for (const auto& [sharing, mean_bound, max_bound] :
       {std::tuple{1.0, 0.003, 0.05}, {2.0, 0.006, 0.1}, {5.0, 0.015, 0.25}}) {
    double sum = 0, largest = 0;
    const int trials = 1500;
    for (int trial = 0; trial < trials; ++trial) {
      const Look look = randomOrientation(random);
      const auto exact = stage.weights(look, 0), shared = stage.weights(look, sharing);
      const Vec3 n = spiral(trial, trials), v = spiral((trial * 7) % trials, trials);
      const Vec3 mirror = 2 * dot(n, v) * n - v;
      double a = 0, b = 0;
      for (int j = 0; j < 100; ++j) {
        const Vec3 l = stage.captured[j].direction.raw();
        const double cosine = std::max(0.0, dot(n, l));
        const double f = cosine / kPi + (cosine > 0 ? std::pow(std::max(0.0, dot(mirror, l)), 30) : 0);
        a += f * exact[j];
        b += f * shared[j];
      }
      const double error = std::fabs(b / a - 1);
      sum += error;
      largest = std::max(largest, error);
    }
    std::printf("light_sharing %.0f degrees: mean error %.3f %%, largest %.2f %%\n", sharing, 100 * sum / trials,
                100 * largest);
    EXPECT_LT(sum / trials, mean_bound);
    EXPECT_LT(largest, max_bound);
  }
}

TEST(LightWeights, APointLightFallsOffWithTheSquareOfTheDistance) {
  Stage stage(100, 0);
  stage.lights.near_lights = {{Point<ObjectSpace>(0, 0, 5), {100, 100, 100}}};
  const auto weights = stage.weights(Look(), 1);
  double sum = 0;
  for (int j = 0; j < 100; ++j) sum += weights[j] * 2;
  EXPECT_NEAR(sum, 4, 1e-6);
  // On the surface itself the distance is cut off, and everything stays finite.
  stage.lights.near_lights = {{Point<ObjectSpace>(0, 0, 0), {1, 1, 1}}};
  sum = 0;
  double unusable = 0;
  for (const float w : stage.weights(Look(), 1)) {
    unusable += !(std::isfinite(w) && w >= 0);
    sum += w;
  }
  EXPECT_GT(sum, 0);
  test::recordHardCase(40, "point light on the surface: weights that are negative, NaN or infinite", unusable,
                       test::atMost(0));
}

TEST(LightWeights, ACapturedLightIsTakenAsItWasPhotographed) {
  Stage stage(20, 0);
  stage.lights.rest = {{LightId{7}, 0.5}};
  const auto weights = stage.weights(Look(), 1);
  for (int c = 0; c < 3; ++c)
    for (int j = 0; j < 32; ++j) EXPECT_EQ(weights[c * 32 + j], j == 7 ? 0.5f : 0.f);
  stage.lights.rest = {{LightId{20}, 1}};
  EXPECT_FALSE(FrameLighting(stage.lights, stage.lists, {}).serves(0)) << "the list holds no such light";
}

TEST(LightWeights, ADarkChannelOfACapturedLightStaysFinite) {
  Stage stage(4, 1);
  for (auto& light : stage.captured) light.strength = {1, 0, 1e-3};
  stage.lists[0] = AcquiredLights(stage.lists[0].ids(), stage.captured, {}, 4);
  for (const float w : stage.weights(Look(), 0)) ASSERT_TRUE(std::isfinite(w));
}

}  // namespace
}  // namespace srf
