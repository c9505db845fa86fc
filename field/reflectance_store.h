// The reflectance images of one view on disk: tiles of 16 x 16 texels, all lights of a texel together (M6).
//
// A block (tile) in memory: half[16][16][3][light_pad]: row, column, channel, light; radiance as photographed.
// Lights beyond light_count and texels without coverage hold 0. Tiles without any covered texel are not stored.
#pragma once

#include <cstdint>
#include <filesystem>
#include <memory>
#include <span>
#include <string>

#include "base/files.h"
#include "base/image.h"

namespace srf {

inline constexpr int kTile = 16;        ///< texels along the side of a block
inline constexpr int kLightGroup = 16;  ///< lights are padded to a multiple: one 32-byte row of halves

/// Where the stored rectangle lies in the photograph, and the shape of its blocks.
struct StoreGeometry {
  int image_width = 0, image_height = 0;  ///< pixels of the photograph
  int crop_x = 0, crop_y = 0;             ///< first stored pixel; the crop is a whole number of tiles
  int tiles_x = 0, tiles_y = 0;
  int light_count = 0;
  bool black_background = true;  ///< as StoredView has it: pixels are premultiplied by coverage

  int lightPad() const { return (light_count + kLightGroup - 1) / kLightGroup * kLightGroup; }
  int tileCount() const { return tiles_x * tiles_y; }
  int cropWidth() const { return tiles_x * kTile; }
  int cropHeight() const { return tiles_y * kTile; }
  std::size_t texelHalves() const { return 3 * static_cast<std::size_t>(lightPad()); }
  std::size_t blockHalves() const { return kTile * kTile * texelHalves(); }
  std::size_t blockBytes() const { return 2 * blockHalves(); }
};

/// Writes one view's store beside its final name; appears there at commit(). Tiles may come in any order, each once.
class ReflectanceStoreWriter {
 public:
  /// `coverage`: cropWidth() x cropHeight() mask values; 0 where a texel must not be used (also NaN pixels).
  ReflectanceStoreWriter(const std::filesystem::path& file, const StoreGeometry& geometry, const Image8& coverage,
                         bool compress = true);
  ~ReflectanceStoreWriter();
  /// `block`: blockHalves() halves, finite. Thread-safe.
  void writeTile(int tile_x, int tile_y, std::span<const std::uint16_t> block);
  /// Writes index and header, renames into place, returns the hash of the whole content.
  std::uint64_t commit();

 private:
  struct State;
  std::unique_ptr<State> state_;
};

/// Random access to a store. Thread-safe; every block's checksum is verified when it is read.
class ReflectanceStore {
 public:
  /// Throws bad_input for a missing, truncated, damaged or newer file.
  explicit ReflectanceStore(const std::filesystem::path& file);
  ~ReflectanceStore();
  ReflectanceStore(ReflectanceStore&&) noexcept;
  ReflectanceStore& operator=(ReflectanceStore&&) noexcept;

  const StoreGeometry& geometry() const;
  /// cropWidth() x cropHeight() coverage, 0..255.
  const Image8& coverage() const;
  bool hasTile(int tile_x, int tile_y) const;
  /// Decodes a block into `out` (blockHalves()); zeros for a tile that is not stored. Returns the bytes read from disk.
  std::size_t readTile(int tile_x, int tile_y, std::span<std::uint16_t> out) const;
  std::uint64_t contentHash() const;
  std::uint64_t bytesOnDisk() const;
  const std::filesystem::path& file() const;

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace srf
