// Which texels of the views' stored rectangles have all four of a bilinear fetch covered: a table of bits that kernels
// look up without asking Coverage.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "field/coverage.h"
#include "field/store_geometry.h"

namespace srf {

struct PlacedView;

/// Texels that are wholly covered, as are their neighbours to the right, below and beyond.
class WholeTexels {
 public:
  static constexpr std::size_t kTileWords = kTile * kTile / 32;
  /// Appends the tiles of a view, row by row; returns the number of the first.
  std::int32_t add(const Coverage& coverage);
  /// Of each tile: which kTileWords words are its own.
  const std::int32_t* tiles() const { return tiles_.data(); }
  const std::uint32_t* words() const { return words_.data(); }  ///< bit 16 (y % 2) + x of word y / 2
  std::size_t bytes() const { return sizeof tiles_[0] * tiles_.capacity() + sizeof words_[0] * words_.capacity(); }
  /// Whether it is so of texel (x, y) of a view, which may lie outside.
  bool at(const PlacedView& view, double x, double y) const;

 private:
  static constexpr std::int32_t kNone = 0, kAll = 1;
  std::vector<std::int32_t> tiles_{kNone};  // the first is of no view
  std::vector<std::uint32_t> words_ = [] {
    std::vector<std::uint32_t> words(2 * kTileWords, 0);
    std::fill(words.begin() + kTileWords, words.end(), ~0u);
    return words;
  }();
};

}  // namespace srf
