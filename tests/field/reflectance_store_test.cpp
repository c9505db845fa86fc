#include "field/reflectance_store.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <fstream>
#include <map>
#include <random>
#include <thread>

#include "base/error.h"
#include "base/half.h"
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

/// Halves with the noise of a camera.
std::vector<std::uint16_t> noisyBlock(const StoreGeometry& g, int tile) {
  std::mt19937 random(tile + 1);
  std::vector<std::uint16_t> block(g.blockHalves());
  for (std::uint16_t& half : block) half = static_cast<std::uint16_t>(0x3000 + (random() & 255));
  return block;
}
/// Halves of few values, as 8-bit photographs give them: hard to pack, easy for zstd.
std::vector<std::uint16_t> fewValuesBlock(const StoreGeometry& g, int tile) {
  auto block = randomBlock(g, tile, false);
  for (std::uint16_t& half : block) half = half ? halfFromFloat(static_cast<float>(half % 4)) : 0;
  return block;
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
    const std::uint64_t hash = contentHash(bytes.data(), 136);
    std::memcpy(bytes.data() + 136, &hash, sizeof hash);
    overwrite(file, 0, bytes.data(), bytes.size());
    expectRefused(file, "damaged");
  };
  for (const std::size_t at : {48, 56, 72})  // coverage_offset, coverage_bytes, index_offset
    for (const std::uint64_t value : {~0ull, 1ull << 63, static_cast<unsigned long long>(original.size())})
      patched(at, value);
  for (const std::size_t at : {16, 20, 24, 28, 32, 36, 40, 44})  // sizes, crop, tiles, lights, levels
    for (const std::int32_t value : {-1, 2000000000, 65537}) patched(at, value);
  patched(32, 4096);  // more tiles than the index has
}

// Widths that do not account for a tile's bytes, with every checksum made right again.
TEST(ReflectanceStore, RejectsATileThatCannotBeUnpacked) {
  const test::TemporaryFolder folder;
  const fs::path file = folder / "v.blk";
  const StoreGeometry g{.image_width = 16, .image_height = 16, .tiles_x = 1, .tiles_y = 1, .light_count = 16};
  ReflectanceStoreWriter writer(file, g, Image8(16, 16, 1, 255));
  writer.writeTile(0, 0, noisyBlock(g, 0));
  writer.commit();
  auto bytes = readBinaryFile(file);
  struct {
    std::uint64_t offset;
    std::uint32_t size, encoding;
    std::uint64_t hash;
  } entry;
  const std::size_t index = bytes.size() - sizeof entry;
  std::memcpy(&entry, &bytes[index], sizeof entry);
  ASSERT_EQ(entry.encoding, 4u);
  bytes[entry.offset] ^= std::byte{1};
  entry.hash = contentHash(&bytes[entry.offset], entry.size, 0);
  std::memcpy(&bytes[index], &entry, sizeof entry);
  std::uint64_t coverage_hash = 0, hash = contentHash(&bytes[index], sizeof entry);
  std::memcpy(&coverage_hash, &bytes[64], sizeof coverage_hash);
  std::memcpy(&bytes[80], &hash, sizeof hash);  // of the index
  const std::int32_t shape[] = {16, 16, 0, 0, 1, 1, 16, 1};
  hash = contentHash(&entry.hash, sizeof entry.hash, contentHash(shape, sizeof shape, coverage_hash));
  std::memcpy(&bytes[88], &hash, sizeof hash);  // of the content
  hash = contentHash(bytes.data(), 136);
  std::memcpy(&bytes[136], &hash, sizeof hash);
  overwrite(file, 0, bytes.data(), bytes.size());
  expectRefused(file, "tile (0, 0) of level 0 that cannot be unpacked");
}

TEST(ReflectanceStore, RejectsANewerVersion) {
  const test::TemporaryFolder folder;
  const fs::path file = folder / "v.blk";
  writeSmallStore(file, smallGeometry());
  auto bytes = readBinaryFile(file);
  bytes[8] = std::byte{7};
  overwrite(file, 0, bytes.data(), bytes.size());
  expectRefused(file, "has version 7, this program reads up to 3");
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
  Image8 coverage(g.cropWidth(), g.cropHeight(), 1, 200);
  for (int y = 0; y < kTile; ++y) std::fill_n(&coverage.at(2 * kTile, y), kTile, std::uint8_t{0});
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

TEST(Coverage, IsTheImageInLessMemory) {
  std::mt19937 random(2);
  Image8 image(77, 60, 1);
  for (int y = 0; y < 60; ++y)
    for (int x = 0; x < 77; ++x) {
      const double inside = 25 - std::hypot(x - 38.0, y - 30.0);
      image.at(x, y) = static_cast<std::uint8_t>(std::clamp(inside, 0.0, 1.0) * 255);
      if (x > 64) image.at(x, y) = static_cast<std::uint8_t>(random());
    }
  const Coverage coverage(image);
  ASSERT_EQ(coverage.width(), 77);
  ASSERT_EQ(coverage.height(), 60);
  for (int y = 0; y < 60; ++y)
    for (int x = 0; x < 77; ++x) ASSERT_EQ(coverage.at(x, y), image.at(x, y)) << x << ' ' << y;
  EXPECT_LT(Coverage(Image8(512, 512, 1, 255)).bytes(), 5000u);
}

std::vector<std::uint32_t> encodings(const fs::path& file, const StoreGeometry& g) {
  const auto bytes = readBinaryFile(file);
  std::vector<std::uint32_t> all(g.allTiles());
  for (std::size_t t = 0; t < all.size(); ++t)
    std::memcpy(&all[t], &bytes[bytes.size() - 24 * (all.size() - t) + 12], sizeof all[t]);
  return all;
}

TEST(ReflectanceStore, ChoosesTheLosslessCodingThatSuitsTheBlock) {
  const test::TemporaryFolder folder;
  const StoreGeometry g{.image_width = 48, .image_height = 16, .tiles_x = 3, .tiles_y = 1, .light_count = 16};
  const std::vector<std::uint16_t> blocks[] = {noisyBlock(g, 0), fewValuesBlock(g, 1), [&] {
                                                 std::mt19937 random(3);
                                                 std::vector<std::uint16_t> any(g.blockHalves());
                                                 for (auto& half : any) half = random() % 0x7c00;
                                                 return any;
                                               }()};
  ReflectanceStoreWriter writer(folder / "v.blk", g, Image8(48, 16, 1, 255));
  for (int tile = 0; tile < 3; ++tile) writer.writeTile(tile, 0, blocks[tile]);
  writer.commit();
  EXPECT_EQ(encodings(folder / "v.blk", g), (std::vector<std::uint32_t>{4, 2, 1}));  // packed, zstd, raw
  const ReflectanceStore store(folder / "v.blk");
  for (int tile = 0; tile < 3; ++tile) EXPECT_EQ(read(store, tile), blocks[tile]);
}

// Files as earlier versions of this program wrote them, without packed blocks; the first with a shorter header.
TEST(ReflectanceStore, ReadsEarlierVersions) {
  for (const std::uint32_t version : {1, 2}) {
    const test::TemporaryFolder folder;
    const StoreGeometry g{.image_width = 32, .image_height = 16, .tiles_x = 2, .tiles_y = 1, .light_count = 16};
    ReflectanceStoreWriter writer(folder / "v.blk", g, Image8(32, 16, 1, 255));
    for (int tile = 0; tile < 2; ++tile) writer.writeTile(tile, 0, fewValuesBlock(g, tile));
    const std::uint64_t hash = writer.commit();
    ASSERT_EQ(encodings(folder / "v.blk", g), (std::vector<std::uint32_t>{2, 2}));
    auto bytes = readBinaryFile(folder / "v.blk");
    std::memcpy(&bytes[8], &version, sizeof version);
    if (version == 1) std::memset(&bytes[44], 0, 4);
    const std::size_t hashed = version == 1 ? 96 : 136;
    const std::uint64_t header = contentHash(bytes.data(), hashed);
    std::memcpy(&bytes[hashed], &header, sizeof header);
    overwrite(folder / "v.blk", 0, bytes.data(), bytes.size());
    const ReflectanceStore store(folder / "v.blk");
    EXPECT_EQ(store.contentHash(), hash);
    EXPECT_EQ(store.geometry().levels, 1);
    EXPECT_EQ(store.fidelity().compression, Compression::lossless);
    for (int tile = 0; tile < 2; ++tile) EXPECT_EQ(read(store, tile), fewValuesBlock(g, tile));
  }
}

// ---- levels ----

ReflectanceBlock blockOf(const ReflectanceStore& store, const TilePlace& at) {
  ReadBuffer buffer;
  ReflectanceBlock block;
  const std::uint32_t tile = store.geometry().tileNumber(at);
  store.decode(tile, store.read(store.place(tile), buffer), block);
  return block;
}

/// 5 x 3 tiles of numbers that halves hold exactly; coverage 255, but 0 left of column 21 and 100 in it.
struct LevelField {
  StoreGeometry geometry{80, 48, 0, 0, 5, 3, 2};
  Image8 coverage = Image8(80, 48, 1, 255);
  LevelField(bool black) {
    geometry.black_background = black;
    geometry.levels = geometry.mostLevels();
    for (int y = 0; y < 48; ++y)
      for (int x = 0; x < 22; ++x) coverage.at(x, y) = x < 21 ? 0 : 100;
  }
  static float value(int x, int y) { return static_cast<float>(x + 4 * y); }
  std::vector<std::uint16_t> block(int tile) const {
    std::vector<std::uint16_t> halves(geometry.blockHalves(), 0);
    for (int i = 0; i < kTile * kTile; ++i) {
      const int x = tile % 5 * kTile + i % kTile, y = tile / 5 * kTile + i / kTile;
      if (coverage.at(x, y) > 0)
        halves[i * geometry.texelHalves() + geometry.lightPad() + 1] = halfFromFloat(value(x, y));
    }
    return halves;
  }
  std::uint64_t write(const fs::path& file, bool backwards = false, int threads = 1) const {
    ReflectanceStoreWriter writer(file, geometry, coverage);
    std::vector<std::jthread> workers;
    for (int t = 0; t < threads; ++t)
      workers.emplace_back([&, t] {
        for (int i = t; i < 15; i += threads) {
          const int tile = backwards ? 14 - i : i;
          if (tile % 5 > 0) writer.writeTile(tile % 5, tile / 5, block(tile));
        }
      });
    workers.clear();
    return writer.commit();
  }
};

TEST(ReflectanceStore, LevelsHoldMeansWeighedByCoverage) {
  const test::TemporaryFolder folder;
  const LevelField field(true);
  field.write(folder / "v.blk");
  const ReflectanceStore store(folder / "v.blk");
  const StoreGeometry& g = store.geometry();
  ASSERT_EQ(g.levels, 4);  // 5 x 3, 3 x 2, 2 x 1, 1 x 1
  EXPECT_EQ(g.allTiles(), 15u + 6 + 2 + 1);
  const auto at = [&](int level, int x, int y) {
    const ReflectanceBlock block = blockOf(store, {level, x / kTile, y / kTile});
    return floatFromHalf(block.halves[(y % kTile * kTile + x % kTile) * g.texelHalves() + g.lightPad() + 1]);
  };
  EXPECT_EQ(store.coverage(1).at(9, 5), 0);
  EXPECT_EQ(store.coverage(1).at(10, 5), 50);  // columns 20 and 21: 0 and 100
  EXPECT_EQ(store.coverage(1).at(11, 5), 255);
  EXPECT_EQ(at(1, 20, 7), (field.value(40, 14) + field.value(41, 15)) / 2);
  EXPECT_EQ(at(1, 10, 5), (field.value(21, 10) + field.value(21, 11)) / 4);  // premultiplied, as its coverage is
  EXPECT_EQ(at(2, 15, 3), (field.value(60, 12) + field.value(63, 15)) / 2);
  EXPECT_EQ(at(3, 6, 2), (field.value(48, 16) + field.value(55, 23)) / 2);
  EXPECT_EQ(store.coverage(1).at(39, 23), 255);
  EXPECT_EQ(store.coverage(1).at(40, 23), 0);  // beyond the crop
}

TEST(ReflectanceStore, LevelsOverABackgroundHoldTheObjectAlone) {
  const test::TemporaryFolder folder;
  const LevelField field(false);
  field.write(folder / "v.blk");
  const ReflectanceStore store(folder / "v.blk");
  EXPECT_EQ(store.coverage(1).at(10, 5), 0);
  EXPECT_EQ(store.coverage(1).at(11, 5), 255);
  const ReflectanceBlock block = blockOf(store, {1, 0, 0});
  const StoreGeometry& g = store.geometry();
  EXPECT_EQ(floatFromHalf(block.halves[(5 * kTile + 11) * g.texelHalves() + g.lightPad() + 1]),
            (field.value(22, 10) + field.value(23, 11)) / 2);
}

TEST(ReflectanceStore, LevelsAreTheSameWhateverTheOrderOfWriting) {
  const test::TemporaryFolder folder;
  const LevelField field(true);
  const std::uint64_t hash = field.write(folder / "a.blk");
  EXPECT_EQ(field.write(folder / "b.blk", /*backwards=*/true), hash);
  EXPECT_EQ(field.write(folder / "c.blk", false, /*threads=*/3), hash);
}

// ---- principal components ----

/// A surface of three kinds of reflectance in changing shares, and noise like that of photons.
std::vector<std::uint16_t> surfaceBlock(const StoreGeometry& g, double noise, unsigned seed, bool clean_copy = false) {
  std::mt19937 random(seed);
  std::normal_distribution<double> normal;
  std::vector<std::uint16_t> block(g.blockHalves(), 0);
  for (int t = 0; t < kTile * kTile; ++t)
    for (int c = 0; c < 3; ++c)
      for (int k = 0; k < g.light_count; ++k) {
        const double a = 0.5 + 0.4 * std::sin(0.3 * t + c), b = 0.5 + 0.3 * std::cos(0.11 * t * (1 + c));
        const double phase = 6.28 * k / g.light_count;
        const double value = std::max(0.0, a * (0.6 + 0.4 * std::cos(phase)) + b * (0.3 + 0.3 * std::sin(2 * phase)) +
                                               0.4 * std::pow(std::max(0.0, std::cos(phase - 0.02 * t)), 8));
        const double noisy = value + noise * std::sqrt(value + 0.05) * normal(random);
        block[(t * 3 + c) * g.lightPad() + k] =
            halfFromFloat(static_cast<float>(clean_copy ? value : std::max(0.0, noisy)));
      }
  return block;
}

double rootMeanSquare(const std::vector<std::uint16_t>& a, const std::vector<std::uint16_t>& b) {
  double sum = 0;
  for (std::size_t i = 0; i < a.size(); ++i) {
    const double d = static_cast<double>(floatFromHalf(a[i])) - floatFromHalf(b[i]);
    sum += d * d;
  }
  return std::sqrt(sum / static_cast<double>(a.size()));
}

TEST(CompressedBlock, KeepsTheSurfaceAndDropsTheNoise) {
  const StoreGeometry g{16, 16, 0, 0, 1, 1, 100};
  const auto noisy = surfaceBlock(g, 0.02, 1), clean = surfaceBlock(g, 0.02, 1, true);
  const auto compressed = compressBlock(g, noisy, 0.001);
  ASSERT_TRUE(compressed);
  std::vector<std::uint16_t> got(g.blockHalves());
  expandBlock(g, compressed->block, got);
  std::printf("rank %d, error against the clean block %.5f, of the noise %.5f\n", compressed->block.pad,
              rootMeanSquare(got, clean), rootMeanSquare(noisy, clean));
  EXPECT_LT(rootMeanSquare(got, clean), 0.5 * rootMeanSquare(noisy, clean));
  EXPECT_LE(compressed->block.pad, 16);
}

TEST(CompressedBlock, MeetsTheErrorWhereThereIsNoNoise) {
  const StoreGeometry g{16, 16, 0, 0, 1, 1, 40};
  const auto clean = surfaceBlock(g, 0, 1);
  const std::vector<std::uint16_t> zero(clean.size(), 0);
  for (const double error : {0.1, 0.01, 0.002}) {
    const auto compressed = compressBlock(g, clean, error);
    ASSERT_TRUE(compressed);
    std::vector<std::uint16_t> got(g.blockHalves());
    expandBlock(g, compressed->block, got);
    // Weighed by light, so not to the digit.
    EXPECT_LT(rootMeanSquare(got, clean), 1.2 * error * rootMeanSquare(clean, zero)) << error;
    ReflectanceBlock read;
    ASSERT_TRUE(unpackCompressed(g, compressed->stored, read));
    EXPECT_EQ(read.halves, compressed->block.halves);
    EXPECT_EQ(read.basis, compressed->block.basis);
    EXPECT_EQ(read.lit.size(), 40u);
  }
}

TEST(CompressedBlock, HandlesMoreLightsThanTexelsAndHardlyAnyTexels) {
  const StoreGeometry many{16, 16, 0, 0, 1, 1, 900}, few{16, 16, 0, 0, 1, 1, 30};
  const auto block = surfaceBlock(many, 0.02, 3);
  const auto compressed = compressBlock(many, block, 0.01);
  ASSERT_TRUE(compressed);
  std::vector<std::uint16_t> got(many.blockHalves());
  expandBlock(many, compressed->block, got);
  EXPECT_LT(rootMeanSquare(got, block), 0.03);
  std::vector<std::uint16_t> sparse(few.blockHalves(), 0);
  EXPECT_FALSE(compressBlock(few, sparse, 0.01));  // empty
  sparse[5 * few.lightPad() + 3] = 0x7bff;         // one value, the largest there is
  const auto one = compressBlock(few, sparse, 0.01);
  ASSERT_TRUE(one);
  std::vector<std::uint16_t> back(few.blockHalves());
  expandBlock(few, one->block, back);
  EXPECT_NEAR(floatFromHalf(back[5 * few.lightPad() + 3]), 65504, 40);
  EXPECT_EQ(one->block.lit, std::vector<std::uint32_t>{3});
  EXPECT_EQ(std::count(back.begin(), back.end(), 0), static_cast<int>(back.size()) - 1);
}

TEST(CompressedBlock, RefusesBytesThatAreNone) {
  const StoreGeometry g{16, 16, 0, 0, 1, 1, 20};
  const auto compressed = compressBlock(g, surfaceBlock(g, 0.02, 4), 0.01);
  ASSERT_TRUE(compressed);
  ReflectanceBlock block;
  auto bytes = compressed->stored;
  bytes.pop_back();
  EXPECT_FALSE(unpackCompressed(g, bytes, block));
  bytes = compressed->stored;
  for (const int rank : {0, 33, 255}) {
    bytes[0] = static_cast<std::byte>(rank);
    EXPECT_FALSE(unpackCompressed(g, bytes, block)) << rank;
  }
  EXPECT_FALSE(unpackCompressed(g, {}, block));
  const float infinite = INFINITY;
  bytes = compressed->stored;
  std::memcpy(&bytes[4], &infinite, sizeof infinite);
  EXPECT_FALSE(unpackCompressed(g, bytes, block));
}

// As stores before version 3 keep it: folded coefficients, low and high bytes apart.
TEST(CompressedBlock, IsReadInItsFormerFormToo) {
  const StoreGeometry g{16, 16, 0, 0, 1, 1, 40};
  const auto compressed = compressBlock(g, surfaceBlock(g, 0.02, 5), 0.01);
  ASSERT_TRUE(compressed);
  const int rank = compressed->block.rank;
  std::vector<std::byte> former;
  const auto put = [&](const void* data, std::size_t bytes) {
    former.insert(former.end(), static_cast<const std::byte*>(data), static_cast<const std::byte*>(data) + bytes);
  };
  const std::size_t vector_bytes = 4 + 2 * 40;  // a scale and its halves
  put(compressed->stored.data(), 4);
  for (int k = 0; k < rank; ++k) {
    const std::byte* const vector = &compressed->stored[4 + k * vector_bytes];
    const std::uint32_t differences = k % 2;
    put(vector, 4), put(&differences, 4), put(vector + 4, 80);
  }
  const auto coefficient = [&](int k, int row) {
    return static_cast<int>(floatFromHalf(compressed->block.halves[row * compressed->block.pad + k]));
  };
  for (const int shift : {0, 8})
    for (int k = 0; k < rank; ++k)
      for (int row = 0; row < 768; ++row) {
        int value = coefficient(k, row);
        if (k % 2 && row >= 3) value -= coefficient(k, row < 48 ? row - 3 : row - 48);
        former.push_back(static_cast<std::byte>((value >= 0 ? 2 * value : -2 * value - 1) >> shift));
      }
  ReflectanceBlock block;
  ASSERT_TRUE(unpackShuffledCompressed(g, former, block));
  EXPECT_EQ(block.halves, compressed->block.halves);
  EXPECT_EQ(block.basis, compressed->block.basis);
  EXPECT_EQ(block.lit, compressed->block.lit);
  former.pop_back();
  EXPECT_FALSE(unpackShuffledCompressed(g, former, block));
  former[0] = std::byte{255};
  EXPECT_FALSE(unpackShuffledCompressed(g, former, block));
}

TEST(ReflectanceStore, RecordsWhatCompressionLost) {
  const test::TemporaryFolder folder;
  const StoreGeometry g{64, 32, 0, 0, 4, 2, 100};
  std::vector<std::vector<std::uint16_t>> blocks;
  std::map<Compression, std::uintmax_t> bytes;
  for (int tile = 0; tile < 8; ++tile) blocks.push_back(surfaceBlock(g, 0.02, tile));
  for (const Compression compression : {Compression::lossless, Compression::pca, Compression::none}) {
    ReflectanceStoreWriter writer(folder / "v.blk", g, Image8(64, 32, 1, 255), {compression, 0.004});
    for (int tile = 0; tile < 8; ++tile) writer.writeTile(tile % 4, tile / 4, blocks[tile]);
    const std::uint64_t hash = writer.commit();
    const ReflectanceStore store(folder / "v.blk");
    EXPECT_EQ(store.contentHash(), hash);
    bytes[compression] = fs::file_size(folder / "v.blk");
    double squares = 0, all = 0;
    const std::vector<std::uint16_t> zero(g.blockHalves(), 0);
    for (int tile = 0; tile < 8; ++tile) {
      squares += std::pow(rootMeanSquare(read(store, tile), blocks[tile]), 2);
      all += std::pow(rootMeanSquare(zero, blocks[tile]), 2);
    }
    EXPECT_EQ(store.fidelity().compression, compression);
    EXPECT_NEAR(store.fidelity().relative_error, std::sqrt(squares / all), 1e-9);
    EXPECT_EQ(store.fidelity().largest_error > 0, compression == Compression::pca);
    std::uint16_t highest = 0;
    for (const auto& block : blocks) highest = std::max(highest, *std::max_element(block.begin(), block.end()));
    EXPECT_EQ(store.fidelity().highest, highest);
    EXPECT_GE(store.fidelity().highest_count, 1u);
  }
  std::printf("halves %ju, lossless %ju, principal components %ju bytes\n", bytes[Compression::none],
              bytes[Compression::lossless], bytes[Compression::pca]);
  const auto halves = static_cast<double>(8 * 256 * 3 * 100 * 2);
  EXPECT_GT(halves / static_cast<double>(bytes[Compression::pca]), 8);
}

TEST(ReflectanceStore, ReadsPastTheSystemsCacheTheSame) {
  const fs::path here = fs::current_path() / "direct.blk";  // a temporary folder may be in memory
  const StoreGeometry g = smallGeometry(37);
  writeSmallStore(here, g);
  try {
    const ReflectanceStore store(here, /*direct=*/true);
    for (int tile = 0; tile < g.tileCount(); ++tile)
      if (tile != 2) {
        EXPECT_EQ(read(store, tile), randomBlock(g, tile));
      }
  } catch (const Error& e) {
    EXPECT_NE(std::string(e.what()).find("cannot be read directly"), std::string::npos) << e.what();
  }
  fs::remove(here);
}

}  // namespace
}  // namespace srf
