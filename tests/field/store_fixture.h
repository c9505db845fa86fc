// A small store of random blocks, for the tests of stores and their cache.
#pragma once

#include <random>
#include <vector>

#include "field/reflectance_store.h"

namespace srf::test {

inline StoreGeometry smallGeometry(int light_count = 5) {
  return {.image_width = 70,
          .image_height = 41,
          .crop_x = 3,
          .crop_y = 2,
          .tiles_x = 4,
          .tiles_y = 2,
          .light_count = light_count};
}

/// Halves of a shaded surface with noise; zeros in the padding and where the tile's number is not in the pattern.
inline std::vector<std::uint16_t> randomBlock(const StoreGeometry& g, int tile, bool smooth = true) {
  std::mt19937 random(tile + 1);
  std::vector<std::uint16_t> block(g.blockHalves(), 0);
  for (int t = 0; t < kTile * kTile; ++t)
    for (int c = 0; c < 3; ++c)
      for (int k = 0; k < g.light_count; ++k) {
        const auto noise = static_cast<std::uint16_t>(random() & (smooth ? 15 : 0x7bff));
        block[(t * 3 + c) * g.lightPad() + k] = smooth ? 0x3000 + 16 * t + noise : noise;
      }
  return block;
}

/// Every tile but number 2, which has no coverage.
inline std::uint64_t writeSmallStore(const std::filesystem::path& file, const StoreGeometry& g, bool compress = true,
                                     bool smooth = true, bool backwards = false) {
  const StoreCoding coding{compress ? Compression::lossless : Compression::none};
  Image8 coverage(g.cropWidth(), g.cropHeight(), 1, 200);
  for (int y = 0; y < kTile; ++y)
    for (int x = 2 * kTile; x < 3 * kTile; ++x) coverage.at(x, y) = 0;
  ReflectanceStoreWriter writer(file, g, coverage, coding);
  for (int i = 0; i < g.tileCount(); ++i) {
    const int tile = backwards ? g.tileCount() - 1 - i : i;
    if (tile != 2) writer.writeTile(tile % g.tiles_x, tile / g.tiles_x, randomBlock(g, tile, smooth));
  }
  return writer.commit();
}

}  // namespace srf::test
