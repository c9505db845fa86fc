// The reflectance images of one view on disk: tiles of 16 x 16 texels, all lights of a texel together (M6), and the
// same at half the size, and so on, for pictures that show the object small.
//
// A block (tile) in memory: half[16][16][3][light_pad]: row, column, channel, light; radiance as photographed.
// Lights beyond light_count and texels without coverage hold 0. Tiles without any covered texel are not stored.
#pragma once

#include <cstdint>
#include <cstdlib>
#include <filesystem>
#include <memory>
#include <span>
#include <string>

#include "base/files.h"
#include "base/image.h"
#include "field/coverage.h"
#include "field/reflectance_block.h"
#include "field/store_geometry.h"

namespace srf {

enum class Compression : std::uint32_t {
  none,      ///< blocks as they are
  lossless,  ///< every bit kept
  pca        ///< principal components over the lights, block by block (reflectance_block.h)
};

struct StoreCoding {
  Compression compression = Compression::lossless;
  double error = 0.005;  ///< of pca: root mean square of a block's error, of the block's own, where noise lets it
};

/// Writes one view's store beside its final name; appears there at commit(). Tiles may come in any order, each once.
/// The levels above 0 (as many as the geometry says) are made here, their texels the coverage-weighted means of 2 x 2:
/// a tile is written when all that it is made of has come. Rows of tiles in order need the least memory for that, about
/// half a row of blocks.
class ReflectanceStoreWriter {
 public:
  /// `coverage`: cropWidth() x cropHeight() mask values; 0 where a texel must not be used (also NaN pixels).
  ReflectanceStoreWriter(const std::filesystem::path& file, const StoreGeometry& geometry, const Image8& coverage,
                         const StoreCoding& coding = {});
  ~ReflectanceStoreWriter();
  /// `block`: blockHalves() halves, finite. Thread-safe.
  void writeTile(int tile_x, int tile_y, std::span<const std::uint16_t> block);
  /// Writes index and header, renames into place, returns the hash of the whole content.
  std::uint64_t commit();

 private:
  struct State;
  std::unique_ptr<State> state_;
};

/// What a store's compression did, as found when it was written; of level 0.
struct StoreFidelity {
  Compression compression = Compression::lossless;
  double asked_error = 0;           ///< StoreCoding::error
  double relative_error = 0;        ///< root mean square of the differences to the photographs, of their own
  double largest_error = 0;         ///< radiance
  std::uint16_t highest = 0;        ///< half; the largest value in the photographs
  std::uint64_t highest_count = 0;  ///< texels' channels that had it: many of them are a plateau, cut off by the camera
};

/// Memory for stored bytes, aligned as direct reading wants it.
class ReadBuffer {
 public:
  std::byte* reserve(std::size_t bytes);

 private:
  struct Free {
    void operator()(std::byte* p) const { std::free(p); }
  };
  std::unique_ptr<std::byte, Free> memory_;
  std::size_t capacity_ = 0;
};

/// Random access to a store. Thread-safe; every block's checksum is verified when it is read.
class ReflectanceStore {
 public:
  /// `direct`: blocks are read past the system's cache of files, for measuring the disk.
  /// Throws bad_input for a missing, truncated, damaged or newer file.
  explicit ReflectanceStore(const std::filesystem::path& file, bool direct = false);
  ~ReflectanceStore();
  ReflectanceStore(ReflectanceStore&&) noexcept;
  ReflectanceStore& operator=(ReflectanceStore&&) noexcept;

  const StoreGeometry& geometry() const;
  /// 0..255 for each texel of a level, tilesX(level) * 16 across. An array of geometry().levels.
  const Coverage* coverages() const;
  const Coverage& coverage(int level = 0) const { return coverages()[level]; }
  /// Zeros in a file of version 1, which is lossless.
  const StoreFidelity& fidelity() const;
  bool hasTile(std::uint32_t tile) const;
  bool hasTile(int tile_x, int tile_y) const;
  /// Decodes a block of level 0 into `out` (blockHalves()), as photographed; zeros for a tile that is not stored.
  /// Returns the bytes read from disk.
  std::size_t readTile(int tile_x, int tile_y, std::span<std::uint16_t> out) const;

  /// Where a tile's bytes lie in the file; 0 bytes for one that is not stored.
  struct Place {
    std::uint64_t offset = 0;
    std::uint32_t bytes = 0;
  };
  Place place(std::uint32_t tile) const;
  /// Reads a part of the file into the buffer and returns it.
  std::span<const std::byte> read(const Place& place, ReadBuffer& buffer) const;
  /// The block of a tile from its bytes.
  void decode(std::uint32_t tile, std::span<const std::byte> stored, ReflectanceBlock& out) const;

  std::uint64_t contentHash() const;
  std::uint64_t bytesOnDisk() const;
  /// What this object holds in memory.
  std::size_t bytesInMemory() const;
  const std::filesystem::path& file() const;

 private:
  struct State;
  std::unique_ptr<State> state_;
};

/// Writes the same photographs as another store, block after block. Returns the hash of its content.
std::uint64_t recodeStore(const ReflectanceStore& store, const std::filesystem::path& file, const StoreCoding& coding);

}  // namespace srf
