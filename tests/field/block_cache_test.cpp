#include "field/block_cache.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <atomic>
#include <barrier>
#include <chrono>
#include <random>
#include <thread>

#include "base/error.h"
#include "tests/field/store_fixture.h"
#include "tests/support/test_support.h"

namespace srf {
namespace {

using test::randomBlock;
using test::smallGeometry;

class BlockCacheTest : public testing::Test {
 protected:
  BlockCacheTest() {
    for (int view = 0; view < 2; ++view) {
      const auto file = folder_ / std::to_string(view);
      test::writeSmallStore(file, geometry_, view == 0);
      owned_.emplace_back(file);
    }
    for (const auto& store : owned_) stores_.push_back(&store);
  }
  BlockCache cacheOf(std::size_t blocks) { return BlockCache(stores_, blocks * geometry_.blockBytes()); }
  BlockCache::Handle get(BlockCache& cache, int tile, std::uint32_t view = 0) const {
    return cache.get(ViewId{view}, static_cast<std::uint32_t>(tile));
  }
  bool right(const BlockCache::Handle& handle, int tile) const {
    const auto expected =
        tile == 2 ? std::vector<std::uint16_t>(geometry_.blockHalves(), 0) : randomBlock(geometry_, tile);
    return std::equal(expected.begin(), expected.end(), handle.block().halves.begin(), handle.block().halves.end());
  }

  test::TemporaryFolder folder_;
  StoreGeometry geometry_ = smallGeometry();
  std::vector<ReflectanceStore> owned_;
  std::vector<const ReflectanceStore*> stores_;
};

TEST_F(BlockCacheTest, HoldsWhatTheStoreHolds) {
  BlockCache cache = cacheOf(3);
  for (int round = 0; round < 2; ++round)
    for (int tile = 0; tile < 8; ++tile) EXPECT_TRUE(right(get(cache, tile, tile % 2), tile));
}

TEST_F(BlockCacheTest, ReadsABlockOnceWhileItStays) {
  BlockCache cache = cacheOf(8);
  for (int round = 0; round < 3; ++round)
    for (int tile = 3; tile < 8; ++tile) get(cache, tile);
  const CacheStatistics s = cache.statistics();
  EXPECT_EQ(s.misses, 5u);
  EXPECT_EQ(s.hits, 10u);
  EXPECT_EQ(s.reread, 0u);
  EXPECT_EQ(s.peak_bytes, 5 * geometry_.blockBytes());
  EXPECT_GT(s.bytes_read, 0u);
}

TEST_F(BlockCacheTest, LetsTheLeastRecentlyUsedGo) {
  BlockCache cache = cacheOf(2);
  get(cache, 0);
  get(cache, 1);
  get(cache, 0);  // now 1 is the oldest
  get(cache, 3);  // takes the place of 1
  EXPECT_EQ(cache.statistics().misses, 3u);
  get(cache, 0);
  EXPECT_EQ(cache.statistics().misses, 3u);
  get(cache, 1);
  const CacheStatistics s = cache.statistics();
  EXPECT_EQ(s.misses, 4u);
  EXPECT_EQ(s.reread, 1u);
  EXPECT_LE(s.peak_bytes, 2 * geometry_.blockBytes());
}

TEST_F(BlockCacheTest, NeverLetsABlockGoThatIsInUse) {
  BlockCache cache = cacheOf(1);
  const auto held = get(cache, 0);
  const auto* data = held.block().halves.data();
  for (int tile = 1; tile < 8; ++tile)
    EXPECT_TRUE(right(get(cache, tile), tile));  // the holder may go beyond the budget
  EXPECT_EQ(get(cache, 0).block().halves.data(), data);
  EXPECT_TRUE(right(held, 0));
}

TEST_F(BlockCacheTest, OneBlockLargerThanTheBudgetIsAllowed) {
  BlockCache cache(stores_, 1);
  for (int tile = 0; tile < 8; ++tile) EXPECT_TRUE(right(get(cache, tile), tile));
  EXPECT_EQ(cache.statistics().peak_bytes, geometry_.blockBytes());
}

TEST_F(BlockCacheTest, ThreadsWaitForEachOtherWhereTheBudgetIsOneBlock) {
  BlockCache cache = cacheOf(1);
  std::atomic<int> wrong = 0;
  {
    std::vector<std::jthread> threads;
    for (int t = 0; t < 4; ++t)
      threads.emplace_back([&, t] {
        std::mt19937 random(t);
        for (int i = 0; i < 100; ++i) {
          const int tile = static_cast<int>(random() % 8);
          wrong += !right(get(cache, tile, random() % 2), tile);
        }
      });
  }
  EXPECT_EQ(wrong, 0);
  EXPECT_EQ(cache.statistics().peak_bytes, geometry_.blockBytes());
  EXPECT_EQ(cache.statistics().hits + cache.statistics().misses, 400u);
}

TEST_F(BlockCacheTest, AThreadWaitsUntilAnotherLetsItsBlockGo) {
  BlockCache cache = cacheOf(1);
  auto held = get(cache, 0);
  std::atomic<bool> done = false;
  std::jthread other([&] {
    EXPECT_TRUE(right(get(cache, 1), 1));
    done = true;
  });
  std::this_thread::sleep_for(std::chrono::milliseconds(50));  // a cache that does not wait is done by now
  EXPECT_FALSE(done);
  held = {};
  other.join();
  EXPECT_TRUE(done);
}

TEST(BlockCache, ThreadsThatWantTheSameBlockReadItOnce) {
  const test::TemporaryFolder folder;
  const StoreGeometry g = smallGeometry(512);  // large blocks: reading one takes longer than starting the threads
  test::writeSmallStore(folder / "v", g);
  const ReflectanceStore store(folder / "v");
  const ReflectanceStore* stores[] = {&store};
  BlockCache cache(stores, 8 * g.blockBytes());
  std::barrier start(4);
  std::vector<std::jthread> threads;
  for (int t = 0; t < 4; ++t)
    threads.emplace_back([&] {
      for (int tile = 3; tile < 8; ++tile) {
        start.arrive_and_wait();
        EXPECT_EQ(cache.get(ViewId{0}, tile).block().halves[0], randomBlock(g, tile)[0]);
      }
    });
  threads.clear();
  EXPECT_EQ(cache.statistics().misses, 5u);
  EXPECT_EQ(cache.statistics().hits, 15u);
}

TEST_F(BlockCacheTest, ADamagedBlockIsAnErrorForEveryoneAndBlocksNobody) {
  const auto file = folder_ / "1";
  const auto size = std::filesystem::file_size(file);
  std::filesystem::resize_file(file, size / 4);  // after opening: the index is known, the blocks are gone
  BlockCache cache = cacheOf(1);
  std::atomic<int> errors = 0;
  {
    std::vector<std::jthread> threads;
    for (int t = 0; t < 3; ++t)
      threads.emplace_back([&] {
        try {
          get(cache, 7, 1);
        } catch (const Error&) {
          ++errors;
        }
      });
  }
  EXPECT_EQ(errors, 3);
  EXPECT_TRUE(right(get(cache, 7, 0), 7));
}

// ---- reading ahead ----

TEST_F(BlockCacheTest, APlanIsReadOnceWithRoomForOneBlockByAnyNumberOfReaders) {
  std::vector<std::uint64_t> keys;
  for (std::uint32_t view = 0; view < 2; ++view)
    for (std::uint32_t tile = 0; tile < 8; ++tile) keys.push_back(blockKey(view, tile));
  for (const int readers : {0, 1, 16})
    for (const std::size_t ahead : {std::size_t{1}, std::size_t{4} << 20}) {
      BlockCache cache(stores_, 1, {ahead, readers});
      for (int round = 1; round <= 2; ++round) {
        cache.plan(keys);
        for (const std::uint64_t key : keys) {
          const int tile = static_cast<int>(key & 0xff);
          EXPECT_TRUE(right(get(cache, tile, key >> 32), tile)) << readers << " readers, " << ahead << " bytes ahead";
        }
        const CacheStatistics s = cache.statistics();
        EXPECT_EQ(s.misses + s.hits, 16u * round);
        EXPECT_EQ(s.reread, s.misses - 16);
        EXPECT_EQ(s.peak_bytes, geometry_.blockBytes());
      }
      // At most one request beyond what may be held: there is always one.
      EXPECT_LE(cache.statistics().peak_ahead_bytes, std::max<std::size_t>(ahead, 8 * geometry_.blockBytes()));
    }
}

TEST_F(BlockCacheTest, NeighboursInTheFileAreReadAsOne) {
  std::vector<std::uint64_t> keys;
  for (std::uint32_t tile = 0; tile < 8; ++tile) keys.push_back(blockKey(0, tile));
  BlockCache cache(stores_, 1 << 20, {1 << 20, 2});
  cache.plan(keys);
  std::this_thread::sleep_for(std::chrono::milliseconds(200));  // the readers have come to the end of it
  for (int tile = 0; tile < 8; ++tile) EXPECT_TRUE(right(get(cache, tile), tile));
  EXPECT_LE(cache.statistics().requests, 2u);  // 7 blocks of a few kilobytes
  EXPECT_EQ(cache.statistics().misses, 8u);
}

TEST_F(BlockCacheTest, WhatThePlanWantsSoonestIsLetGoLast) {
  BlockCache cache(stores_, 3 * geometry_.blockBytes(), {1 << 20, 0});
  for (const int tile : {5, 6, 7}) get(cache, tile);  // held from before
  std::vector<std::uint64_t> keys;
  for (const std::uint32_t tile : {0, 1, 3, 4, 5, 6, 7}) keys.push_back(blockKey(0, tile));
  cache.plan(keys);
  for (const int tile : {0, 1, 3, 4, 5, 6, 7}) get(cache, tile);
  // By age alone 5, 6 and 7 would have gone before their turn; only 7 must, being wanted last.
  EXPECT_EQ(cache.statistics().hits, 2u);
  EXPECT_EQ(cache.statistics().reread, 1u);
}

TEST_F(BlockCacheTest, AnotherPlanKeepsWhatItWantsTooAndForgetsTheRest) {
  BlockCache cache(stores_, 1, {1 << 20, 4});
  for (int round = 0; round < 50; ++round) {
    std::vector<std::uint64_t> keys;
    for (std::uint32_t tile = round % 3; tile < 8; tile += 1 + round % 2) keys.push_back(blockKey(round % 2, tile));
    cache.plan(keys);
    if (round % 5 == 0) continue;  // not asked for at all
    for (const std::uint64_t key : keys) {
      const int tile = static_cast<int>(key & 0xff);
      EXPECT_TRUE(right(get(cache, tile, key >> 32), tile));
    }
  }
}

TEST_F(BlockCacheTest, ADamagedBlockThatWasReadAheadIsAnErrorWhereItIsAskedFor) {
  const auto file = folder_ / "1";
  std::filesystem::resize_file(file, std::filesystem::file_size(file) / 4);
  BlockCache cache(stores_, 1, {1 << 20, 4});
  std::vector<std::uint64_t> keys{blockKey(0, 3), blockKey(1, 6), blockKey(1, 7)};
  cache.plan(keys);
  EXPECT_TRUE(right(get(cache, 3), 3));
  EXPECT_THROW(get(cache, 6, 1), Error);
  EXPECT_THROW(get(cache, 7, 1), Error);
  EXPECT_TRUE(right(get(cache, 7), 7));
}

}  // namespace
}  // namespace srf
