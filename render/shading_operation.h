// One minimal operation of shading (patent Table B; M15).
#pragma once

#include <cstdint>
#include <type_traits>

#include "field/block_cache.h"

namespace srf {

/// Adds to a target the sum over 4 neighbouring texels of one tile of one view, and over all its lights, of
/// tap * reflectance * light weight. Table B's record {target, (view, light), (x, y), (w_r, w_g, w_b)} is the case of
/// one tap and one light; here all operations of a target on the same texels are merged into one, whose light weights
/// the handle names. A bilinear fetch that straddles tiles is one operation for each tile.
struct ShadingOperation {
  std::uint32_t target;  ///< position in the batch's list of hits
  std::uint32_t lights;  ///< handle: position in the batch's list of light weights
  std::uint32_t tile;    ///< StoreGeometry::tileNumber
  std::uint16_t view;    ///< i_c
  std::uint8_t x, y;     ///< first of the 2 x 2 texels, in the tile; a neighbour beyond the tile has weight 0
  float tap[4];          ///< view weight times bilinear weight over coverage: (x, y), (x+1, y), (x, y+1), (x+1, y+1)
};
static_assert(sizeof(ShadingOperation) == 32 && std::is_trivially_copyable_v<ShadingOperation>);

/// Operations on one block of the store have the same key.
constexpr std::uint64_t blockKey(const ShadingOperation& operation) {
  return blockKey(operation.view, operation.tile);
}

}  // namespace srf
