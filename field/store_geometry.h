// Where a view's stored rectangle lies in its photograph, and the shape of its blocks.
#pragma once

#include <cstddef>
#include <cstdint>

namespace srf {

inline constexpr int kTile = 16;        ///< texels along the side of a block
inline constexpr int kLightGroup = 16;  ///< lights are padded to a multiple: one 32-byte row of halves

/// A tile of a store: its level, and where it lies there.
struct TilePlace {
  int level = 0, x = 0, y = 0;
};

/// A store holds `levels` levels, each with half as many texels across as the one before (rounded up to whole tiles).
/// Texel (x, y) of level l stands for the 2^l x 2^l texels of level 0 that begin at (x 2^l, y 2^l). Tiles are numbered
/// level by level, row by row.
struct StoreGeometry {
  int image_width = 0, image_height = 0;  ///< pixels of the photograph
  int crop_x = 0, crop_y = 0;             ///< first stored pixel; the crop is a whole number of tiles
  int tiles_x = 0, tiles_y = 0;           ///< of level 0
  int light_count = 0;
  bool black_background = true;  ///< as StoredView has it: pixels are premultiplied by coverage
  int levels = 1;

  int lightPad() const { return (light_count + kLightGroup - 1) / kLightGroup * kLightGroup; }
  int cropWidth() const { return tiles_x * kTile; }
  int cropHeight() const { return tiles_y * kTile; }
  std::size_t texelHalves() const { return 3 * static_cast<std::size_t>(lightPad()); }
  std::size_t blockHalves() const { return kTile * kTile * texelHalves(); }
  std::size_t blockBytes() const { return 2 * blockHalves(); }

  int tilesX(int level) const { return (tiles_x + (1 << level) - 1) >> level; }
  int tilesY(int level) const { return (tiles_y + (1 << level) - 1) >> level; }
  int tileCount(int level = 0) const { return tilesX(level) * tilesY(level); }
  /// Number of a level's first tile; of `levels`: how many tiles there are.
  std::uint32_t firstTile(int level) const {
    std::uint32_t first = 0;
    for (int l = 0; l < level; ++l) first += static_cast<std::uint32_t>(tileCount(l));
    return first;
  }
  std::uint32_t allTiles() const { return firstTile(levels); }
  std::uint32_t tileNumber(const TilePlace& at) const {
    return firstTile(at.level) + static_cast<std::uint32_t>(at.y) * tilesX(at.level) + static_cast<std::uint32_t>(at.x);
  }
  TilePlace place(std::uint32_t tile) const {
    TilePlace at;
    for (; tile >= static_cast<std::uint32_t>(tileCount(at.level)); ++at.level)
      tile -= static_cast<std::uint32_t>(tileCount(at.level));
    at.x = static_cast<int>(tile) % tilesX(at.level), at.y = static_cast<int>(tile) / tilesX(at.level);
    return at;
  }
  /// Levels until one tile holds all.
  int mostLevels() const {
    int level = 0;
    while (tileCount(level) > 1) ++level;
    return level + 1;
  }
};

}  // namespace srf
