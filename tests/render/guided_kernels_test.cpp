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
    PointReflectance point = randomPoint(random);
    if (trial % 3 > 0) point.alpha_y = point.alpha_x;  // a shorter form
    if (trial % 3 > 1) point.alpha_x = point.alpha_y = 0.05f + 0.0006f * static_cast<float>(trial);
    if (trial % 5 > 2) point.coefficient[1] = {0, 0, 0};
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
    constexpr std::size_t kCaptured = 16;
    std::vector<float> energy(lanes, 0), lit, tells, disagree, trusted, shown(3 * kCaptured),
        about_captured(4 * kCaptured, 0);
    std::vector<std::int8_t> sight(lanes, kNotAsked);
    std::vector<std::uint32_t> about(lanes, 0);
    for (std::size_t i = 0; i < kCaptured; ++i) {
      const auto at = static_cast<float>(i);
      lit.push_back(0.05f * at), disagree.push_back(0.06f * at), trusted.push_back(0.06f * at);
      tells.push_back(i % 4 == 0 ? 0.f : 0.5f);
    }
    for (std::size_t i = 0; i < lights.count; ++i) {
      energy[i] = lights.amount[0][i] + lights.amount[1][i] + lights.amount[2][i];
      sight[i] = static_cast<std::int8_t>(static_cast<int>(random() % 3) - 1);
      about[i] = random() % kCaptured;
    }
    const bool corrected = trial % 2;
    shownBySight(lit.data(), tells.data(), corrected ? disagree.data() : nullptr, kCaptured, shown.data());
    std::array<std::vector<float>, 3> answer;
    for (auto& channel : answer) channel.resize(lanes);
    const std::size_t facing = modelAnswers(model, view, lights.lanes(), constant(lights.amount), lanes,
                                            {answer[0].data(), answer[1].data(), answer[2].data()});
    const auto got =
        distantSums(model.n, {lights.lanes(), energy.data()}, constant(answer), sight.data(), about.data(),
                    {shown.data(), kCaptured, trial % 3 ? trusted.data() : nullptr}, lanes, about_captured.data());
    std::size_t want_facing = 0;
    std::vector<double> want_shown(kCaptured), want_all(kCaptured);
    for (std::uint32_t i = 0; i < lights.count; ++i) {
      const double cosine = double{point.normal[0]} * lights.direction[0][i] +
                            double{point.normal[1]} * lights.direction[1][i] +
                            double{point.normal[2]} * lights.direction[2][i];
      const std::uint32_t a = about[i];
      double reaches = sight[i] != kNotAsked ? sight[i] : tells[a] > 0 ? lit[a] : 1;
      if (corrected) reaches += disagree[a] * (lit[a] - reaches);
      if (cosine > 0) {
        ++want_facing;
        want_shown[a] += reaches * energy[i];
        want_all[a] += energy[i];
      }
      const double counts = cosine > 0 ? reaches * (trial % 3 ? trusted[a] : 1) : 0;
      for (int c = 0; c < 3; ++c) lights.amount[c][i] *= static_cast<float>(counts);
    }
    ASSERT_EQ(facing, want_facing);
    for (std::size_t i = 0; i < kCaptured; ++i) {
      ASSERT_NEAR(about_captured[4 * i] + about_captured[4 * i + 2], want_shown[i], 1e-5 * want_all[i]);
      ASSERT_NEAR(about_captured[4 * i + 1] + about_captured[4 * i + 3], want_all[i], 1e-5 * want_all[i]);
    }
    const auto want = modelSums(model, &view, 1, lights.lanes(), constant(lights.amount), lanes);
    for (int c = 0; c < 3; ++c) ASSERT_NEAR(got[c], want[c], 1e-5 * want[c] + 1e-6) << "trial " << trial;
  }
}

TEST(GuidedKernels, AnswersAreTheModelsLightByLightAndSumAsTheyAreShown) {
  std::mt19937 random(12);
  for (int trial = 0; trial < 60; ++trial) {
    const Lights lights(1 + random() % 90, random);
    const std::size_t lanes = paddedLanes(lights.count);
    PointReflectance point = randomPoint(random);
    if (trial % 2) point.alpha_y = point.alpha_x;
    ModelOfPoint model = modelOfPoint(point);
    const ModelView view = addView(model, point, floats(randomDirection(random)), 1);
    std::array<std::vector<float>, 3> answer;
    for (auto& channel : answer) channel.assign(lanes, 7);
    std::size_t want_facing = 0;
    const std::size_t facing = modelAnswers(model, view, lights.lanes(), constant(lights.amount), lanes,
                                            {answer[0].data(), answer[1].data(), answer[2].data()});
    std::vector<float> key(lanes), shown(lanes);
    addBrightness(constant(answer), lanes, key.data());
    std::array<double, 3> all{};
    for (std::size_t i = 0; i < lanes; ++i) {
      std::array<std::vector<float>, 3> alone;
      for (int c = 0; c < 3; ++c) {
        alone[c].assign(lanes, 0);
        alone[c][i] = lights.amount[c][i];
      }
      const auto sum = modelSums(model, &view, 1, lights.lanes(), constant(alone), lanes);
      const float cosine = point.normal[0] * lights.direction[0][i] + point.normal[1] * lights.direction[1][i] +
                           point.normal[2] * lights.direction[2][i];
      want_facing += cosine > 0 && i < lights.count;
      shown[i] = 0.01f * static_cast<float>(random() % 100);
      for (int c = 0; c < 3; ++c) {
        const float want = cosine > 0 ? sum[c] : 0;
        ASSERT_NEAR(answer[c][i], want, 1e-5f * want + 1e-6f) << "trial " << trial << " light " << i;
        all[c] += double{shown[i]} * double{answer[c][i]};
      }
      ASSERT_NEAR(key[i], std::max(0.f, answer[0][i] + answer[1][i] + answer[2][i]), 1e-6f * key[i]);
    }
    ASSERT_EQ(facing, want_facing);
    const auto sum = shownSums(constant(answer), shown.data(), lanes);
    for (int c = 0; c < 3; ++c) ASSERT_NEAR(sum[c], all[c], 1e-5 * all[c] + 1e-6) << "trial " << trial;
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
    std::vector<std::uint32_t> want;
    for (const auto& [minus, i] : order) want.push_back(i);
    std::sort(want.begin(), want.end());
    // Wherever the search begins.
    const std::int32_t begins[] = {0, 1, 0x3f000000, static_cast<std::int32_t>(random() >> 1), 0x7fffffff};
    for (std::int32_t about : begins) {
      std::vector<std::uint32_t> found(key.size());
      found.resize(largestKeys(key.data(), key.size(), most, found.data(), about));
      ASSERT_EQ(found, want) << "trial " << trial;
    }
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
  const ResidualAmounts single{constant(photograph), constant(model)};
  const std::size_t count =
      usedLights(captured, lanes, nullptr, &single, {own.data(), own.data() + lanes, own.data() + 2 * lanes},
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

TEST(GuidedKernels, TheResidualIsTakenAsStatedAndAddsToSingleLights) {
  std::mt19937 random(10);
  std::uniform_real_distribution<float> uniform(0, 1);
  for (int trial = 0; trial < 60; ++trial) {
    const Lights lights(1 + random() % 120, random);
    const std::size_t lanes = paddedLanes(lights.count);
    const auto some = [&](std::size_t size, bool zeros = false) {
      std::vector<float> values(size, 0);
      for (std::size_t i = 0; i < size; ++i) values[i] = zeros && random() % 3 == 0 ? 0.f : uniform(random);
      return values;
    };
    const std::vector<float> known = some(lanes, true), gate = trial % 2 ? std::vector<float>(lanes, 1) : some(lanes);
    const std::vector<float> lit = some(lanes, true), usable = some(lanes, true);
    std::vector<float> energy(4 * lanes, 0), own(3 * lanes);
    std::array<std::vector<float>, 3> irradiance, inverse, photograph, model, direction, used;
    for (int c = 0; c < 3; ++c) {
      irradiance[c] = some(lanes), inverse[c] = some(lanes, true);
      photograph[c] = some(lanes, true), model[c] = some(lanes, true);
      for (float& amount : model[c]) amount *= 8;
      direction[c].assign(lanes, 7), used[c].assign(lanes, 7);
    }
    for (std::size_t i = 0; i < lights.count; ++i)
      for (std::size_t half = 0; half < 2; ++half) {
        if (random() % 4 == 0) continue;
        energy[4 * i + 2 * half + 1] = uniform(random) + 0.1f;
        energy[4 * i + 2 * half] = uniform(random) * energy[4 * i + 2 * half + 1];
      }
    const bool with_single = trial % 3 > 0;
    const ResidualShares shares{
        trial % 7 ? 0.7f : 0.f, trial % 5 ? 0.2f : 0.f, 2, energy.data(), gate.data(), lit.data(),
        usable.data(),          constant(irradiance)};
    const ResidualAmounts single{constant(photograph), constant(model)};
    const CapturedLanes captured{lights.lanes(), known.data(), constant(irradiance), constant(inverse)};
    std::size_t photographs = 0;
    const std::size_t count = usedLights(captured, lanes, &shares, with_single ? &single : nullptr,
                                         {own.data(), own.data() + lanes, own.data() + 2 * lanes},
                                         {{direction[0].data(), direction[1].data(), direction[2].data()},
                                          {used[0].data(), used[1].data(), used[2].data()}},
                                         photographs);
    double standing = 0, reaching = 0, hidden = 0, dark = 0;
    const auto reach = [&](std::size_t i) {
      const double all = double{energy[4 * i + 1]} + energy[4 * i + 3],
                   shown = double{energy[4 * i]} + energy[4 * i + 2];
      return std::pair(all > 0, all > 0 ? shown / all : 0);
    };
    for (std::size_t i = 0; i < lanes; ++i) {
      const auto [any, share] = reach(i);
      const double stands = double{irradiance[0][i]} + irradiance[1][i] + irradiance[2][i];
      standing += usable[i] * (any ? share : 1) * stands;
      reaching += double{energy[4 * i]} + energy[4 * i + 2];
      const double hides = known[i] * (1 - (any ? share : lit[i])) * stands;
      hidden += hides, dark += (1 - lit[i]) * hides;
    }
    const double scale = standing > 0 ? std::min(2.0, reaching / standing) : 0;
    const double dark_scale = dark > 0 ? std::min(2.0, hidden / dark) : 0;
    std::size_t at = 0;
    for (std::size_t i = 0; i < lanes; ++i) {
      const auto [any, share] = reach(i);
      const double reaches = any ? share : lit[i], from_all = gate[i] * shares.indirect * reaches;
      const double from_lit = gate[i] * (1.0 - shares.indirect) * scale * usable[i] * (any ? share : 1);
      const double from_dark = gate[i] * shares.indirect_shadow * dark_scale * (1 - reaches) * (1 - lit[i]);
      bool takes = false;
      std::array<double, 3> taken;
      for (int c = 0; c < 3; ++c) {
        double given = known[i] * (from_lit + from_all + from_dark + 1 - gate[i]) * irradiance[c][i];
        taken[c] = known[i] * (from_lit + from_all * lit[i]) * irradiance[c][i];
        if (with_single) given += photograph[c][i], taken[c] += model[c][i];
        ASSERT_NEAR(own[c * lanes + i], given * inverse[c][i], 1e-5) << "trial " << trial;
        takes |= inverse[c][i] > 0 && taken[c] > 0;
      }
      if (!takes) continue;
      ASSERT_LT(at, count);
      ASSERT_EQ(direction[0][at], lights.direction[0][i]);
      for (int c = 0; c < 3; ++c) ASSERT_NEAR(used[c][at], inverse[c][i] > 0 ? taken[c] : 0, 2e-5);
      ++at;
    }
    EXPECT_EQ(at, count);
    for (; at < paddedLanes(count); ++at) EXPECT_EQ(used[1][at], 0);
  }
}

}  // namespace
}  // namespace srf
