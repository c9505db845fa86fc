#include "render/guided_kernels.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <random>
#include <vector>

#include "base/numeric.h"

namespace srf {
namespace {

std::array<const float*, 3> constant(const std::array<std::vector<float>, 3>& of) {
  return {of[0].data(), of[1].data(), of[2].data()};
}

/// Random lights and amounts, padded as the kernels ask, and points with views.
struct Lights {
  std::array<std::vector<float>, 3> direction, amount;
  std::size_t count;
  explicit Lights(std::size_t lights, std::mt19937& random) : count(lights) {
    std::normal_distribution<double> normal;
    std::uniform_real_distribution<float> uniform(0, 2);
    for (int c = 0; c < 3; ++c) {
      direction[c].assign(paddedLanes(count), c == 2 ? 1.f : 0.f);
      amount[c].assign(paddedLanes(count), 0);
    }
    for (std::size_t i = 0; i < count; ++i) {
      const Vec3 d = normalize(Vector<AcquisitionSpace>(normal(random), normal(random), normal(random)))->raw();
      for (int c = 0; c < 3; ++c) direction[c][i] = static_cast<float>(d[c]), amount[c][i] = uniform(random);
    }
  }
  DirectionLanes lanes() const { return {direction[0].data(), direction[1].data(), direction[2].data()}; }
};

Direction<AcquisitionSpace> randomDirection(std::mt19937& random) {
  std::normal_distribution<double> normal;
  return *normalize(Vector<AcquisitionSpace>(normal(random), normal(random), normal(random)));
}
std::array<float, 3> floats(const Direction<AcquisitionSpace>& d) {
  return {static_cast<float>(d.raw().x), static_cast<float>(d.raw().y), static_cast<float>(d.raw().z)};
}
PointReflectance randomPoint(std::mt19937& random) {
  std::uniform_real_distribution<float> uniform(0, 1);
  PointReflectance point;
  const auto n = randomDirection(random);
  point.normal = floats(n);
  point.tangent = floats(anyPerpendicular(n));
  point.alpha_x = 0.1f + uniform(random), point.alpha_y = 0.1f + uniform(random);
  for (auto& term : point.coefficient)
    for (float& c : term) c = uniform(random);
  return point;
}

TEST(GuidedKernels, SumsOfTheModelStayWithinTheirStatedErrorWhateverTheViewsAndTheSpace) {
  std::mt19937 random(5);
  for (int trial = 0; trial < 200; ++trial) {
    const Lights lights(1 + random() % 90, random);
    const PointReflectance point = randomPoint(random);
    ModelOfPoint model = modelOfPoint(point);
    std::vector<ModelView> views;
    std::array<double, 3> want{}, scale{};
    const std::size_t count = trial % 2 ? 1 : 4;
    for (std::size_t v = 0; v < count; ++v) {
      const std::array<float, 3> view = floats(randomDirection(random));
      const float share = count == 1 ? 1.f : 0.1f * static_cast<float>(v + 1);
      views.push_back(addView(model, point, view, share));
      const auto sum = modelSumsReference(point, view, lights.lanes(), constant(lights.amount), lights.count);
      std::array<double, kModelTerms> largest{};
      for (std::size_t i = 0; i < lights.count; ++i) {
        const auto at = lights.lanes();
        const auto terms =
            modelTermsReference(point, Direction<AcquisitionSpace>::fromUnit(Vec3{at.x[i], at.y[i], at.z[i]}),
                                Direction<AcquisitionSpace>::fromUnit(Vec3{view[0], view[1], view[2]}));
        for (int t = 0; t < kModelTerms; ++t) largest[t] = std::max(largest[t], terms[t]);
      }
      for (int c = 0; c < 3; ++c) {
        want[c] += share * sum[c];
        for (std::size_t i = 0; i < lights.count; ++i)
          for (int t = 0; t < kModelTerms; ++t)
            scale[c] += share * lights.amount[c][i] * point.coefficient[t][c] * largest[t];
      }
    }
    const auto got = modelSums(model, views.data(), views.size(), lights.lanes(), constant(lights.amount),
                               paddedLanes(lights.count));
    for (int c = 0; c < 3; ++c) ASSERT_NEAR(got[c], want[c], 1e-4 * scale[c]) << "trial " << trial;

    // Mirrored, lights and all: the same sums.
    if (count > 1) continue;
    const Mat3 mirror{{Vec3{0, 1, 0}, Vec3{1, 0, 0}, Vec3{0, 0, 1}}};
    turn(model, views[0], mirror);
    const DirectionLanes turned{lights.direction[1].data(), lights.direction[0].data(), lights.direction[2].data()};
    const auto there = modelSums(model, views.data(), 1, turned, constant(lights.amount), paddedLanes(lights.count));
    for (int c = 0; c < 3; ++c) ASSERT_NEAR(there[c], want[c], 1e-4 * scale[c]) << "trial " << trial;
  }
}

TEST(GuidedKernels, DistantLightsCountAsTheyAreSeenOrAsTheCapturedLightAboutThemSays) {
  std::mt19937 random(6);
  for (int trial = 0; trial < 100; ++trial) {
    Lights lights(1 + random() % 300, random);
    const std::size_t lanes = paddedLanes(lights.count);
    const PointReflectance point = randomPoint(random);
    ModelOfPoint model = modelOfPoint(point);
    const ModelView view = addView(model, point, floats(randomDirection(random)), 1);
    std::vector<float> energy(lanes, 0), unasked, asked, offset, trusted, shown_energy(lanes, -1);
    std::vector<std::int8_t> sight(lanes, kNotAsked);
    std::vector<std::uint32_t> about(lanes, 0), facing(lanes);
    for (int i = 0; i < 16; ++i) {
      unasked.push_back(0.05f * i), asked.push_back(1 - 0.01f * i), offset.push_back(0.005f * i);
      trusted.push_back(0.06f * i);
    }
    for (std::size_t i = 0; i < lights.count; ++i) {
      energy[i] = lights.amount[0][i] + lights.amount[1][i] + lights.amount[2][i];
      sight[i] = static_cast<std::int8_t>(static_cast<int>(random() % 3) - 1);
      about[i] = random() % 16;
    }
    const bool corrected = trial % 2;
    std::size_t count = 0;
    const auto got = distantSums(
        model, view, {lights.lanes(), energy.data(), constant(lights.amount)}, sight.data(), about.data(),
        {unasked.data(), corrected ? asked.data() : nullptr, offset.data(), trial % 3 ? trusted.data() : nullptr},
        lanes, facing.data(), shown_energy.data(), count);
    std::vector<std::uint32_t> want_facing;
    for (std::uint32_t i = 0; i < lights.count; ++i) {
      const double cosine = double{point.normal[0]} * lights.direction[0][i] +
                            double{point.normal[1]} * lights.direction[1][i] +
                            double{point.normal[2]} * lights.direction[2][i];
      float shown = 0;
      if (sight[i] == kNotAsked)
        shown = unasked[about[i]];
      else
        shown = corrected ? asked[about[i]] * sight[i] + offset[about[i]] : sight[i];
      if (cosine > 0) {
        want_facing.push_back(i);
        ASSERT_NEAR(shown_energy[i], shown * energy[i], 1e-6 * energy[i]);
      }
      for (int c = 0; c < 3; ++c) lights.amount[c][i] *= cosine > 0 ? shown * (trial % 3 ? trusted[about[i]] : 1) : 0;
    }
    ASSERT_EQ(std::vector(facing.begin(), facing.begin() + static_cast<std::ptrdiff_t>(count)), want_facing);
    const auto want = modelSums(model, &view, 1, lights.lanes(), constant(lights.amount), lanes);
    for (int c = 0; c < 3; ++c) ASSERT_NEAR(got[c], want[c], 1e-5 * want[c] + 1e-6) << "trial " << trial;
  }
}

TEST(GuidedKernels, TheBrightestAreThoseOfASortAlsoWhereTheyTie) {
  std::mt19937 random(7);
  for (int trial = 0; trial < 300; ++trial) {
    const std::size_t count = 1 + random() % 260, most = random() % 70;
    std::vector<float> key(paddedLanes(count), 0);
    std::uniform_real_distribution<float> uniform(-1, 1);
    for (std::size_t i = 0; i < count; ++i)
      key[i] = trial % 3 == 0 ? static_cast<float>(random() % 4) : std::max(0.f, uniform(random));
    std::vector<std::pair<float, std::uint32_t>> order;
    for (std::uint32_t i = 0; i < count; ++i)
      if (key[i] > 0) order.emplace_back(-key[i], i);
    std::sort(order.begin(), order.end());
    order.resize(std::min(order.size(), most));
    std::vector<std::uint32_t> want, got(key.size());
    for (const auto& [minus, i] : order) want.push_back(i);
    std::sort(want.begin(), want.end());
    got.resize(largestKeys(key.data(), key.size(), most, got.data()));
    ASSERT_EQ(got, want) << "trial " << trial;
  }
}

TEST(GuidedKernels, SharesAreSumsOfTheBitsThatAreSet) {
  std::mt19937_64 random(8);
  std::uint64_t words[3][3];
  for (auto& row : words)
    for (auto& word : row) word = random();
  const std::uint64_t* rows[3] = {words[0], words[1], words[2]};
  const float weight[3] = {0.5f, 0.3f, 0.25f};  // over 1 where all are set
  std::vector<float> got(192);
  shareBits(rows, weight, 3, got.size(), got.data());
  for (std::size_t i = 0; i < got.size(); ++i) {
    float want = 0;
    for (int p = 0; p < 3; ++p)
      if (words[p][i / 64] >> (i % 64) & 1) want += weight[p];
    ASSERT_EQ(got[i], std::min(want, 1.f)) << i;
  }
}

TEST(GuidedKernels, WhatIsUsedIsWhatCountsAndDarkLightsHoldNothing) {
  std::mt19937 random(9);
  const Lights lights(37, random);
  const std::size_t lanes = paddedLanes(lights.count);
  std::array<std::vector<float>, 3> inverse, photograph, model, direction, used;
  std::vector<float> known(lanes, 1), own(3 * lanes);
  for (int c = 0; c < 3; ++c) {
    inverse[c].assign(lanes, 0), photograph[c].assign(lanes, 0), model[c].assign(lanes, 0);
    direction[c].assign(lanes, 7), used[c].assign(lanes, 7);
    for (std::size_t i = 0; i < lights.count; ++i) {
      inverse[c][i] = i % 5 == 0 ? 0.f : 0.5f;
      photograph[c][i] = i % 3 == 0 ? 0.f : 2.f + static_cast<float>(i);
      model[c][i] = i % 2 == 0 ? 0.f : 1.f + static_cast<float>(i);
    }
  }
  const CapturedLanes captured{lights.lanes(), known.data(), constant(lights.amount), constant(inverse)};
  std::size_t photographs = 0;
  const std::size_t count = usedLights(captured, lanes, constant(photograph), constant(model),
                                       {own.data(), own.data() + lanes, own.data() + 2 * lanes},
                                       {{direction[0].data(), direction[1].data(), direction[2].data()},
                                        {used[0].data(), used[1].data(), used[2].data()}},
                                       photographs);
  std::size_t at = 0, want_photographs = 0;
  for (std::size_t i = 0; i < lights.count; ++i) {
    ASSERT_EQ(own[i], photograph[0][i] * inverse[0][i]);
    want_photographs += own[i] != 0;
    if (i % 2 == 0 || i % 5 == 0) continue;
    ASSERT_EQ(direction[1][at], lights.direction[1][i]);
    ASSERT_EQ(used[2][at++], model[2][i]);
  }
  EXPECT_EQ(count, at);
  EXPECT_EQ(photographs, want_photographs);
  for (; at < paddedLanes(count); ++at) EXPECT_EQ(used[0][at], 0);
}

}  // namespace
}  // namespace srf
