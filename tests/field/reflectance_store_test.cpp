#include "field/reflectance_store.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cstring>
#include <fstream>
#include <thread>

#include "base/error.h"
#include "tests/field/store_fixture.h"
#include "tests/support/hard_case.h"
#include "tests/support/test_support.h"

namespace srf {
namespace {

namespace fs = std::filesystem;
using test::randomBlock;
using test::smallGeometry;
using test::writeSmallStore;

// In place, without the flush to the disk of writeBinaryFile.
void overwrite(const fs::path& file, std::size_t at, const void* data, std::size_t bytes) {
  std::fstream stream(file, std::ios::binary | std::ios::in | std::ios::out);
  stream.seekp(static_cast<std::streamoff>(at))
      .write(static_cast<const char*>(data), static_cast<std::streamsize>(bytes));
}

std::vector<std::uint16_t> read(const ReflectanceStore& store, int tile) {
  std::vector<std::uint16_t> block(store.geometry().blockHalves(), 0xffff);
  store.readTile(tile % store.geometry().tiles_x, tile / store.geometry().tiles_x, block);
  return block;
}

/// Opening and reading everything must throw an Error of bad input that names the file.
// True where it was refused at all.
bool expectRefused(const fs::path& file, const std::string& part) {
  try {
    const ReflectanceStore store(file);
    for (int tile = 0; tile < store.geometry().tileCount(); ++tile) read(store, tile);
    ADD_FAILURE() << "accepted: " << part;
    return false;
  } catch (const Error& e) {
    EXPECT_EQ(e.kind(), ErrorKind::bad_input);
    EXPECT_NE(std::string(e.what()).find(file.string()), std::string::npos) << e.what();
    EXPECT_NE(std::string(e.what()).find(part), std::string::npos) << e.what();
    return true;
  }
}

class ReflectanceStoreRoundTrip : public testing::TestWithParam<std::tuple<bool, bool, int>> {};

TEST_P(ReflectanceStoreRoundTrip, KeepsEveryBit) {
  const auto [compress, smooth, lights] = GetParam();
  const test::TemporaryFolder folder;
  const StoreGeometry g = smallGeometry(lights);
  const std::uint64_t hash = writeSmallStore(folder / "v.blk", g, compress, smooth);
  const ReflectanceStore store(folder / "v.blk");
  EXPECT_EQ(store.contentHash(), hash);
  EXPECT_EQ(store.bytesOnDisk(), fs::file_size(folder / "v.blk"));
  EXPECT_EQ(store.geometry().crop_x, g.crop_x);
  EXPECT_EQ(store.geometry().image_height, g.image_height);
  EXPECT_EQ(store.geometry().light_count, lights);
  EXPECT_EQ(store.coverage().at(0, 0), 200);
  EXPECT_EQ(store.coverage().at(2 * kTile, 0), 0);
  for (int tile = 0; tile < g.tileCount(); ++tile) {
    EXPECT_EQ(store.hasTile(tile % g.tiles_x, tile / g.tiles_x), tile != 2);
    const auto expected = tile == 2 ? std::vector<std::uint16_t>(g.blockHalves(), 0) : randomBlock(g, tile, smooth);
    EXPECT_EQ(read(store, tile), expected) << "tile " << tile;
  }
}

INSTANTIATE_TEST_SUITE_P(All, ReflectanceStoreRoundTrip,
                         testing::Combine(testing::Bool(), testing::Bool(), testing::Values(1, 16, 37)));

TEST(ReflectanceStore, SmoothBlocksShrinkToLessThanHalf) {
  const test::TemporaryFolder folder;
  writeSmallStore(folder / "packed.blk", smallGeometry(16), true);
  writeSmallStore(folder / "raw.blk", smallGeometry(16), false);
  EXPECT_LT(2 * fs::file_size(folder / "packed.blk"), fs::file_size(folder / "raw.blk"));
}

TEST(ReflectanceStore, HashTellsContentsApartAndNotTheOrderOfWriting) {
  const test::TemporaryFolder folder;
  const StoreGeometry g = smallGeometry();
  const std::uint64_t hash = writeSmallStore(folder / "a.blk", g);
  EXPECT_EQ(writeSmallStore(folder / "b.blk", g, true, true, /*backwards=*/true), hash);
  EXPECT_NE(writeSmallStore(folder / "c.blk", g, true, false), hash);
  StoreGeometry moved = g;
  ++moved.crop_x;
  EXPECT_NE(writeSmallStore(folder / "d.blk", moved), hash);
}

TEST(ReflectanceStore, RemembersTheBackground) {
  const test::TemporaryFolder folder;
  StoreGeometry g = smallGeometry();
  g.black_background = false;
  writeSmallStore(folder / "v.blk", g);
  EXPECT_FALSE(ReflectanceStore(folder / "v.blk").geometry().black_background);
}

TEST(ReflectanceStore, AppearsOnlyWhenWhole) {
  const test::TemporaryFolder folder;
  {
    ReflectanceStoreWriter writer(folder / "v.blk", smallGeometry(), Image8(64, 32, 1, 255));
    writer.writeTile(0, 0, randomBlock(smallGeometry(), 0));
    EXPECT_FALSE(fs::exists(folder / "v.blk"));
  }
  EXPECT_TRUE(fs::is_empty(folder.path()));
}

TEST(ReflectanceStore, RejectsMissingAndForeignFiles) {
  const test::TemporaryFolder folder;
  expectRefused(folder / "none.blk", "could not be opened");
  expectRefused(folder.path(), "is not a file");
  writeTextFile(folder / "text.blk", std::string(300, 'x'));
  expectRefused(folder / "text.blk", "is not a view's store");
}

TEST(ReflectanceStore, RejectsEveryTruncation) {
  const test::TemporaryFolder folder;
  const fs::path file = folder / "v.blk";
  writeSmallStore(file, smallGeometry());
  int accepted = 0;
  for (std::size_t size = fs::file_size(file) - 1; size > 0; size -= size < 200 ? 1 : 97) {
    fs::resize_file(file, size);
    accepted += !expectRefused(file, "damaged");
  }
  test::recordHardCase(41, "truncated stores that were not refused by name", accepted, test::atMost(0));
}

TEST(ReflectanceStore, RejectsEveryFlippedBit) {
  const test::TemporaryFolder folder;
  const fs::path file = folder / "v.blk";
  writeSmallStore(file, smallGeometry(1));
  const auto bytes = readBinaryFile(file);
  const auto index_start = bytes.size() - 24 * static_cast<std::size_t>(smallGeometry().tileCount());
  int accepted = 0;
  for (std::size_t i = 0; i < bytes.size(); i += i < 250 || i >= index_start ? 1 : 41) {
    const std::byte flipped = bytes[i] ^ std::byte{static_cast<unsigned char>(1u << (i % 8))};
    overwrite(file, i, &flipped, 1);
    accepted += !expectRefused(file, i < 8 ? "is not a view's store" : i < 12 ? "" : "damaged");
    overwrite(file, i, &bytes[i], 1);
  }
  test::recordHardCase(41, "stores with a flipped bit that were not refused by name", accepted, test::atMost(0));
}

// Headers whose checksum is right and whose numbers are not: nothing may be read or allocated on their word.
TEST(ReflectanceStore, RejectsImpossibleNumbersBehindARightChecksum) {
  const test::TemporaryFolder folder;
  const fs::path file = folder / "v.blk";
  writeSmallStore(file, smallGeometry());
  const auto original = readBinaryFile(file);
  const auto patched = [&](std::size_t at, auto value) {
    auto bytes = original;
    std::memcpy(bytes.data() + at, &value, sizeof value);
    const std::uint64_t hash = contentHash(bytes.data(), 96);
    std::memcpy(bytes.data() + 96, &hash, sizeof hash);
    overwrite(file, 0, bytes.data(), bytes.size());
    expectRefused(file, "damaged");
  };
  for (const std::size_t at : {48, 56, 72})  // coverage_offset, coverage_bytes, index_offset
    for (const std::uint64_t value : {~0ull, 1ull << 63, static_cast<unsigned long long>(original.size())})
      patched(at, value);
  for (const std::size_t at : {16, 20, 24, 28, 32, 36, 40})  // sizes, crop, tiles, lights
    for (const std::int32_t value : {-1, 2000000000, 65537}) patched(at, value);
  patched(32, 4096);  // more tiles than the index has
}

TEST(ReflectanceStore, RejectsANewerVersion) {
  const test::TemporaryFolder folder;
  const fs::path file = folder / "v.blk";
  writeSmallStore(file, smallGeometry());
  auto bytes = readBinaryFile(file);
  bytes[8] = std::byte{7};
  overwrite(file, 0, bytes.data(), bytes.size());
  expectRefused(file, "has version 7, this program reads up to 1");
}

TEST(ReflectanceStore, RejectsExchangedTiles) {
  const test::TemporaryFolder folder;
  const fs::path file = folder / "v.blk";
  writeSmallStore(file, smallGeometry(), /*compress=*/false);
  auto bytes = readBinaryFile(file);
  const std::size_t block = smallGeometry().blockBytes(), index = bytes.size() - 24 * 8, first = index - 7 * block;
  std::swap_ranges(bytes.begin() + first, bytes.begin() + first + block, bytes.begin() + first + block);
  overwrite(file, 0, bytes.data(), bytes.size());
  expectRefused(file, "tile (0, 0)");
}

TEST(ReflectanceStore, ManyThreadsWriteAndReadTheSame) {
  const test::TemporaryFolder folder;
  const StoreGeometry g = smallGeometry();
  const std::uint64_t expected = writeSmallStore(folder / "one.blk", g);
  Image8 coverage = ReflectanceStore(folder / "one.blk").coverage();
  ReflectanceStoreWriter writer(folder / "many.blk", g, coverage);
  {
    std::vector<std::jthread> threads;
    for (int tile = 0; tile < g.tileCount(); ++tile)
      if (tile != 2)
        threads.emplace_back([&, tile] { writer.writeTile(tile % g.tiles_x, tile / g.tiles_x, randomBlock(g, tile)); });
  }
  EXPECT_EQ(writer.commit(), expected);
  const ReflectanceStore store(folder / "many.blk");
  std::vector<std::jthread> threads;
  for (int t = 0; t < 4; ++t)
    threads.emplace_back([&, t] {
      for (int i = 0; i < 2 * g.tileCount(); ++i) {
        const int tile = (i + t) % g.tileCount();
        if (tile == 2) continue;
        EXPECT_EQ(read(store, tile), randomBlock(g, tile));
      }
    });
}

}  // namespace
}  // namespace srf
