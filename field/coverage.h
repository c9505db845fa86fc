// How much of each texel the object covers, in little memory: most tiles are all in or all out, and in the others most
// texels are.
#pragma once

#include <array>
#include <bit>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "base/image.h"

namespace srf {

/// Least coverage of a texel that holds nothing but the object.
inline constexpr int kWhollyCovered = 250;

class Coverage {
 public:
  Coverage() = default;
  explicit Coverage(const Image8& image);

  int width() const { return width_; }
  int height() const { return height_; }
  /// 0..255. x, y must lie inside.
  std::uint8_t at(int x, int y) const {
    const unsigned column = static_cast<unsigned>(x), row = static_cast<unsigned>(y);
    const std::uint32_t tile = tiles_[std::size_t{row / kSide} * static_cast<unsigned>(tiles_x_) + column / kSide];
    if (tile < kMixed) return static_cast<std::uint8_t>(tile);
    const Mixed& mixed = mixed_[tile - kMixed];
    const unsigned bit = row % kSide * kSide + column % kSide, word = bit / 64;
    const std::uint64_t mask = std::uint64_t{1} << bit % 64;
    if (mixed.full[word] & mask) return 255;
    if (!(mixed.partial[word] & mask)) return 0;
    std::size_t at = mixed.first + std::popcount(mixed.partial[word] & (mask - 1));
    for (unsigned w = 0; w < word; ++w) at += std::popcount(mixed.partial[w]);
    return partial_[at];
  }
  /// Of the 16 x 16 texels of a tile, row by row: bit x of a row where it and its neighbours to the right, below and
  /// beyond are all 255. Beyond the last tile there is nothing.
  std::array<std::uint16_t, 16> wholeRows(int tile_x, int tile_y) const;
  /// What it was made of.
  Image8 image() const;
  std::size_t bytes() const;

 private:
  static constexpr int kSide = 16;
  static constexpr std::uint32_t kMixed = 256;
  /// Bit x: texel x of a tile's row is 255.
  std::uint32_t fullRow(int tile_x, int tile_y, int row) const;
  struct Mixed {
    std::uint64_t full[4] = {}, partial[4] = {};  ///< one bit a texel, row by row: 255; neither 0 nor 255
    std::uint32_t first = 0;                      ///< of its partial texels' values in partial_
  };
  int width_ = 0, height_ = 0, tiles_x_ = 0;
  std::vector<std::uint32_t> tiles_;  ///< below kMixed: what all texels hold; else kMixed + position in mixed_
  std::vector<Mixed> mixed_;
  std::vector<std::uint8_t> partial_;
};

}  // namespace srf
