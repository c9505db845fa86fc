#include "render/deferred_shading.h"

#include <gtest/gtest.h>

#include <cmath>
#include <random>

#include "base/image_io.h"
#include "base/parallel.h"
#include "render/texel_kernels.h"
#include "render/texel_products.h"
#include "tests/support/hard_case.h"
#include "tests/support/test_support.h"

namespace srf {
namespace {

std::vector<std::uint16_t> randomBlock(const StoreGeometry& geometry, std::mt19937& random) {
  std::uniform_real_distribution<float> uniform(0, 4);
  std::vector<std::uint16_t> block(geometry.blockHalves());
  for (auto& half : block) half = halfFromFloat(uniform(random));
  return block;
}

ShadingOperation randomOperation(std::mt19937& random) {
  std::uniform_real_distribution<float> uniform(0, 1);
  ShadingOperation o{};
  o.x = random() % kTile;
  o.y = random() % kTile;
  for (float& tap : o.tap) tap = uniform(random);
  if (o.x == kTile - 1) o.tap[1] = o.tap[3] = 0;
  if (o.y == kTile - 1) o.tap[2] = o.tap[3] = 0;
  return o;
}

TEST(ReflectanceDot, StaysWithinItsStatedError) {
  std::mt19937 random(1);
  std::normal_distribution<float> normal;
  for (const int lights : {1, 16, 100, 331}) {
    const StoreGeometry geometry{kTile, kTile, 0, 0, 1, 1, lights};
    const int pad = geometry.lightPad();
    const auto block = randomBlock(geometry, random);
    for (int trial = 0; trial < 300; ++trial) {
      std::vector<float> weights(3 * pad), magnitudes(3 * pad);
      for (int i = 0; i < 3 * pad; ++i) {
        weights[i] = normal(random) * std::exp(3 * normal(random));
        magnitudes[i] = std::fabs(weights[i]);
      }
      const ShadingOperation operation = randomOperation(random);  // taps and reflectance are not negative
      const auto want = reflectanceDotReference(block.data(), pad, operation, weights.data());
      const auto terms = reflectanceDotReference(block.data(), pad, operation, magnitudes.data());
      const Rgb got = reflectanceDot(block.data(), pad, operation, weights.data());
      for (int c = 0; c < 3; ++c) EXPECT_LE(std::fabs(got[c] - want[c]), (pad / 8 + 10) * std::ldexp(terms[c], -24));
    }
  }
}

TEST(ReflectanceDot, ReadsTheTexelAndLightThatItNames) {
  const StoreGeometry geometry{kTile, kTile, 0, 0, 1, 1, 20};
  const int pad = geometry.lightPad();
  std::vector<std::uint16_t> block(geometry.blockHalves());
  block[((5 * kTile + 8) * 3 + 1) * pad + 17] = halfFromFloat(2);  // texel (8, 5), green, light 17
  std::vector<float> weights(3 * pad);
  weights[1 * pad + 17] = 3;
  ShadingOperation operation{};
  operation.x = 7;
  operation.y = 5;
  operation.tap[1] = 0.25f;
  EXPECT_EQ(reflectanceDot(block.data(), pad, operation, weights.data()), (Rgb{0, 1.5f, 0}));
}

// ---- products shared by operations ----------------------------------------------------------------------------------

TEST(TexelKernels, StayWithinTheirStatedErrorWhateverTheirCompany) {
  std::mt19937 random(5);
  std::normal_distribution<float> normal;
  for (const int lights : {1, 16, 100, 331}) {
    const StoreGeometry geometry{kTile, kTile, 0, 0, 1, 1, lights};
    const int pad = geometry.lightPad();
    const auto block = randomBlock(geometry, random);
    for (int trial = 0; trial < 100; ++trial) {
      const std::uint16_t* texel = block.data() + (random() % 256) * 3 * pad;
      std::vector<std::vector<float>> vectors(kProductVectors, std::vector<float>(3 * pad));
      const float* of[kProductVectors];
      float values[kProductVectors][kProductRow], alone[kProductRow];
      float* to[kProductVectors];
      for (int v = 0; v < kProductVectors; ++v) {
        for (float& weight : vectors[v]) weight = normal(random) * std::exp(3 * normal(random));
        of[v] = vectors[v].data(), to[v] = values[v];
      }
      const int count = 1 + trial % kProductVectors;
      texelDots(texel, pad, of, count, to);
      for (int v = 0; v < count; ++v) {
        std::vector<float> magnitudes = vectors[v];
        for (float& weight : magnitudes) weight = std::fabs(weight);
        const auto want = texelDotReference(texel, pad, of[v]);
        const auto terms = texelDotReference(texel, pad, magnitudes.data());
        float* one = alone;
        texelDots(texel, pad, of + v, 1, &one);
        for (int c = 0; c < 3; ++c) {
          EXPECT_LE(std::fabs(values[v][c] - want[c]), (pad / 16 + 4) * std::ldexp(terms[c], -24));
          EXPECT_EQ(values[v][c], alone[c]);
        }
        EXPECT_EQ(values[v][3], 0);
      }
    }
  }
}

/// Operations with light weights of every kind: blends of many vectors, single lights, a vector of their own.
TEST(TexelProducts, AgreeWithTheProductOfTheMergedVector) {
  std::mt19937 random(6);
  std::uniform_real_distribution<float> uniform(0, 1);
  const StoreGeometry geometry{kTile, kTile, 0, 0, 1, 1, 100};
  const int pad = geometry.lightPad(), count = 3 * pad;
  const auto block = randomBlock(geometry, random);
  ReflectanceBlock photographed;
  photographed.pad = pad;
  photographed.halves.assign(block.begin(), block.end());
  std::vector<std::vector<float>> shared(90, std::vector<float>(count));  // more than there are tables for
  LightGather lights;
  for (auto& vector : shared) {
    for (float& weight : vector) weight = uniform(random);
    lights.vectors.push_back(vector.data());
  }
  std::vector<ShadingOperation> operations;
  for (std::uint32_t i = 0; i < 400; ++i) {
    LightWeights weights;
    weights.first_entry = static_cast<std::uint32_t>(lights.entries.size());
    if (i % 4 != 3)
      for (int s = 0; s < 4; ++s) {
        weights.shared[s] = random() % shared.size();
        weights.share[s] = s == 3 && i % 2 ? 0 : uniform(random);
      }
    if (i % 3 == 0)
      for (std::size_t e = 0; e < (i == 30 ? 95 : 8); ++e)
        lights.entries.push_back({static_cast<std::uint32_t>(random() % 100), {uniform(random), 1, uniform(random)}});
    weights.entries = static_cast<std::uint32_t>(lights.entries.size()) - weights.first_entry;
    if (i % 5 == 0) {
      weights.own = static_cast<std::uint32_t>(lights.own.size());
      for (int j = 0; j < count; ++j) lights.own.push_back(uniform(random));
    }
    lights.weights.push_back(weights);
    operations.push_back(randomOperation(random));
    operations.back().lights = i;
  }
  std::vector<Rgb> together(operations.size()), alone(operations.size());
  TexelProducts products;
  products.begin(photographed, 100);
  for (std::size_t i = 0; i < operations.size(); ++i) products.add(operations[i], lights, together[i]);
  products.flush();
  std::vector<float> scratch(count);
  for (std::size_t i = 0; i < operations.size(); ++i) {
    products.begin(photographed, 100);
    products.add(operations[i], lights, alone[i]);
    products.flush();
    EXPECT_EQ(together[i], alone[i]) << "depends on its company";
    const float* merged = lights.vector(lights.weights[i], pad, scratch.data());
    const auto want = reflectanceDotReference(block.data(), pad, operations[i], merged);  // all terms are positive
    for (int c = 0; c < 3; ++c) EXPECT_NEAR(together[i][c], want[c], 120 * std::ldexp(want[c], -24));
  }
}

/// Two views of 3 x 2 tiles with different numbers of lights, and batches of random operations on them.
class DeferredShadingTest : public ::testing::Test {
 protected:
  void SetUp() override {
    std::mt19937 random(3);
    for (int v = 0; v < 2; ++v) {
      const StoreGeometry geometry{48, 32, 0, 0, 3, 2, v == 0 ? 20 : 7};
      const auto file = folder_ / ("view" + std::to_string(v));
      ReflectanceStoreWriter writer(file, geometry, Image8(48, 32, 1, 255));
      for (int t = 0; t < geometry.tileCount(); ++t) writer.writeTile(t % 3, t / 3, randomBlock(geometry, random));
      writer.commit();
      stores_.emplace_back(file);
      geometry_.push_back(geometry);
    }
    std::normal_distribution<float> normal;
    for (auto& batch : batches_) {
      batch.targets = 50;
      for (int v = 0; v < 2; ++v) {  // light weights 0 and 1: of its own for each view
        LightWeights weights;
        weights.own = static_cast<std::uint32_t>(batch.lights.own.size());
        for (int i = 0; i < 3 * geometry_[v].lightPad(); ++i) batch.lights.own.push_back(normal(random));
        if (v == 1) {
          weights.first_entry = 0;
          weights.entries = 1;
          batch.lights.entries.push_back({3, {1, 2, 3}});
        }
        batch.lights.weights.push_back(weights);
      }
      for (int i = 0; i < 400; ++i) {
        ShadingOperation operation = randomOperation(random);
        operation.view = random() % 2;
        operation.lights = operation.view;
        operation.tile = random() % 6;
        operation.target = i / 8;
        batch.operations.push_back(operation);
      }
      sortOperations(batch);
    }
  }

  std::vector<std::array<double, 3>> shade(std::size_t cache_bytes, ExecutionOrder order,
                                           CacheStatistics* statistics = nullptr) {
    const ReflectanceStore* stores[] = {&stores_[0], &stores_[1]};
    BlockCache cache(stores, cache_bytes);
    DeferredShading shading(geometry_, cache);
    for (auto& batch : batches_) batch.results.clear();
    shading.execute(batches_, order);
    if (statistics) *statistics = cache.statistics();
    std::vector<std::array<double, 3>> colors;
    for (const auto& batch : batches_)
      for (const auto& color : sumResults(batch)) colors.push_back(color);
    return colors;
  }

  test::TemporaryFolder folder_;
  std::vector<ReflectanceStore> stores_;
  std::vector<StoreGeometry> geometry_;
  std::vector<ShadingBatch> batches_ = std::vector<ShadingBatch>(3);
};

TEST_F(DeferredShadingTest, SortedEqualsUnsorted) {
  const auto want = shade(1 << 26, ExecutionOrder::immediate);
  test::recordHardCase(38, "sorted against immediate: 1 where a bit differs",
                       shade(1 << 26, ExecutionOrder::sorted) != want, test::atMost(0));
}

TEST_F(DeferredShadingTest, NeitherThreadsNorCacheSizeChangeABit) {
  setThreadCount(1);
  const auto want = shade(1 << 26, ExecutionOrder::sorted);
  setThreadCount(4);
  test::recordHardCase(38, "a cache of one block and 4 threads against one thread: 1 where a bit differs",
                       shade(1, ExecutionOrder::sorted) != want, test::atMost(0));
  test::recordHardCase(38, "a cache of everything and 4 threads against one thread: 1 where a bit differs",
                       shade(1 << 26, ExecutionOrder::sorted) != want, test::atMost(0));
  setThreadCount(0);
}

TEST_F(DeferredShadingTest, SortedReadsEachBlockOnceWithRoomForOneBlock) {
  setThreadCount(1);
  CacheStatistics sorted, immediate;
  shade(1, ExecutionOrder::sorted, &sorted);
  shade(1, ExecutionOrder::immediate, &immediate);
  setThreadCount(0);
  EXPECT_EQ(sorted.misses, 12u);  // 2 views of 6 tiles
  EXPECT_EQ(sorted.reread, 0u);
  EXPECT_GE(immediate.reread, 2 * sorted.misses);  // three batches, each sorted in itself
}

TEST_F(DeferredShadingTest, AgreesWithOneTermAfterTheOther) {
  const auto got = shade(1 << 26, ExecutionOrder::sorted);
  std::size_t at = 0;
  for (const auto& batch : batches_) {
    std::vector<std::array<double, 3>> want(batch.targets);
    for (const ShadingOperation& o : batch.operations) {
      const int pad = geometry_[o.view].lightPad();
      std::vector<std::uint16_t> block(geometry_[o.view].blockHalves());
      stores_[o.view].readTile(static_cast<int>(o.tile % 3), static_cast<int>(o.tile / 3), block);
      std::vector<float> weights(batch.lights.own.begin() + batch.lights.weights[o.lights].own,
                                 batch.lights.own.begin() + batch.lights.weights[o.lights].own + 3 * pad);
      if (o.view == 1)
        for (int c = 0; c < 3; ++c) weights[c * pad + 3] += static_cast<float>(c + 1);
      const auto term = reflectanceDotReference(block.data(), pad, o, weights.data());
      for (int c = 0; c < 3; ++c) want[o.target][c] += term[c];
    }
    for (const auto& color : want) {
      for (int c = 0; c < 3; ++c) EXPECT_NEAR(got[at][c], color[c], 1e-3);  // sums of some 1000 terms about 2 in float
      ++at;
    }
  }
}

TEST(ShadingOperations, AreSortedByViewThenTileThenAsTheyCame) {
  ShadingBatch batch;
  for (const auto& [view, tile, target] : {std::tuple{1, 0, 0}, {0, 5, 1}, {0, 2, 2}, {1, 0, 3}, {0, 5, 4}}) {
    ShadingOperation o{};
    o.view = static_cast<std::uint16_t>(view);
    o.tile = tile;
    o.target = target;
    batch.operations.push_back(o);
  }
  sortOperations(batch);
  std::vector<std::uint32_t> targets;
  for (const auto& o : batch.operations) targets.push_back(o.target);
  EXPECT_EQ(targets, (std::vector<std::uint32_t>{2, 1, 4, 0, 3}));
}

}  // namespace
}  // namespace srf
