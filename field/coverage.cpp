#include "field/coverage.h"

#include <algorithm>

namespace srf {

Coverage::Coverage(const Image8& image)
    : width_(image.width()), height_(image.height()), tiles_x_((image.width() + kSide - 1) / kSide) {
  const int tiles_y = (height_ + kSide - 1) / kSide;
  tiles_.reserve(static_cast<std::size_t>(tiles_x_) * tiles_y);
  for (int tile_y = 0; tile_y < tiles_y; ++tile_y)
    for (int tile_x = 0; tile_x < tiles_x_; ++tile_x) {
      const int x0 = tile_x * kSide, y0 = tile_y * kSide;
      const int x1 = std::min(width_, x0 + kSide), y1 = std::min(height_, y0 + kSide);
      const std::uint8_t first = image.at(x0, y0);
      bool same = true;
      for (int y = y0; y < y1; ++y)
        for (int x = x0; x < x1; ++x) same = same && image.at(x, y) == first;
      if (same) {
        tiles_.push_back(first);
        continue;
      }
      Mixed mixed;
      mixed.first = static_cast<std::uint32_t>(partial_.size());
      for (int y = y0; y < y1; ++y)
        for (int x = x0; x < x1; ++x) {
          const int bit = (y - y0) * kSide + x - x0;
          const std::uint8_t value = image.at(x, y);
          if (value == 255) mixed.full[bit / 64] |= std::uint64_t{1} << bit % 64;
          if (value == 0 || value == 255) continue;
          mixed.partial[bit / 64] |= std::uint64_t{1} << bit % 64;
          partial_.push_back(value);
        }
      tiles_.push_back(kMixed + static_cast<std::uint32_t>(mixed_.size()));
      mixed_.push_back(mixed);
    }
  mixed_.shrink_to_fit();
  partial_.shrink_to_fit();
}

std::uint32_t Coverage::fullRow(int tile_x, int tile_y, int row) const {
  const std::size_t at = static_cast<std::size_t>(tile_y) * tiles_x_ + tile_x;
  if (tile_x >= tiles_x_ || at >= tiles_.size()) return 0;
  const std::uint32_t tile = tiles_[at];
  if (tile < kMixed) return tile == 255 ? 0xffff : 0;
  return mixed_[tile - kMixed].full[row / 4] >> (row % 4 * kSide) & 0xffff;
}

std::array<std::uint16_t, 16> Coverage::wholeRows(int tile_x, int tile_y) const {
  static_assert(kSide == 16);
  std::array<std::uint16_t, 16> whole;
  const auto pairs = [&](int row) {  // of texels beside one another that are 255
    const int y = tile_y + row / kSide;
    const std::uint32_t full = fullRow(tile_x, y, row % kSide) | (fullRow(tile_x + 1, y, row % kSide) & 1) << kSide;
    return full & full >> 1;
  };
  std::uint32_t above = pairs(0);
  for (int row = 0; row < kSide; ++row) {
    const std::uint32_t below = pairs(row + 1);
    whole[row] = static_cast<std::uint16_t>(above & below);
    above = below;
  }
  return whole;
}

Image8 Coverage::image() const {
  Image8 out(width_, height_, 1);
  for (int y = 0; y < height_; ++y)
    for (int x = 0; x < width_; ++x) out.at(x, y) = at(x, y);
  return out;
}

std::size_t Coverage::bytes() const {
  return tiles_.capacity() * sizeof tiles_[0] + mixed_.capacity() * sizeof(Mixed) + partial_.capacity();
}

}  // namespace srf
