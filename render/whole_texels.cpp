#include "render/whole_texels.h"

#include <array>

#include "render/view_kernels.h"

namespace srf {

std::int32_t WholeTexels::add(const Coverage& coverage) {
  const auto first = static_cast<std::int32_t>(tiles_.size());
  const int across = (coverage.width() + kTile - 1) / kTile, down = (coverage.height() + kTile - 1) / kTile;
  for (int y = 0; y < down; ++y)
    for (int x = 0; x < across; ++x) {
      const std::array<std::uint16_t, kTile> rows = coverage.wholeRows(x, y);
      const auto all = [&](std::uint16_t bits) {
        return std::all_of(rows.begin(), rows.end(), [&](auto row) { return row == bits; });
      };
      if (all(0) || all(0xffff)) {
        tiles_.push_back(rows[0] ? kAll : kNone);
        continue;
      }
      tiles_.push_back(static_cast<std::int32_t>(words_.size() / kTileWords));
      for (int row = 0; row < kTile; row += 2) words_.push_back(rows[row] | std::uint32_t{rows[row + 1]} << 16);
    }
  return first;
}

bool WholeTexels::at(const PlacedView& view, double x, double y) const {
  if (!(x >= 0 && y >= 0 && x < view.across - 1 && y < view.down - 1)) return false;
  const auto column = static_cast<unsigned>(x), row = static_cast<unsigned>(y);
  const auto tile = static_cast<std::size_t>(view.first_tile + row / kTile * view.tiles_x + column / kTile);
  const std::uint32_t word = words_[static_cast<std::size_t>(tiles_[tile]) * kTileWords + row % kTile / 2];
  return word >> (row % 2 * kTile + column % kTile) & 1;
}

}  // namespace srf
