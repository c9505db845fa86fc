// A block of reflectance in memory, and its forms on disk.
#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "field/store_geometry.h"

namespace srf {

/// What the lights of a block's texels are: as photographed, or in a basis of few vectors over the lights,
/// value[texel][channel][light] = sum over k of halves[texel][channel][k] * basis[light][k].
struct ReflectanceBlock {
  int rank = 0;                       ///< vectors of the basis; 0: as photographed
  int pad = 0;                        ///< lightPad(), or the rank rounded up to a multiple of kRankGroup
  std::vector<std::uint16_t> halves;  ///< half[16][16][3][pad]; 0 beyond the rank
  std::vector<float> basis;           ///< float[light_count][pad]
  std::vector<std::uint32_t> lit;     ///< lights in whose rows of the basis is a number; rising

  std::size_t bytes() const {
    return halves.size() * sizeof halves[0] + basis.size() * sizeof basis[0] + lit.size() * sizeof lit[0];
  }
};

inline constexpr int kRankGroup = 16;

/// The block as photographed: half[16][16][3][lightPad()]. What a basis makes negative is 0, beyond the range of halves
/// 65504.
void expandBlock(const StoreGeometry& geometry, const ReflectanceBlock& block, std::span<std::uint16_t> out);

/// One block in a basis found by principal components (the Deformable SRF paper compresses so; here block by block, so
/// that each can be read alone). Lights are weighed by the inverse standard deviation that shot noise would have there.
/// Components are kept until `error` (root mean square, of the block's own) is met, but none that drown in the noise:
/// singular values below the optimal hard threshold for unknown noise (Gavish and Donoho, IEEE Trans. Inf. Theory 60,
/// 2014) hold more of it than of the surface. Coefficients are whole numbers; a step is one standard deviation of what
/// was left out.
struct CompressedBlock {
  std::vector<std::byte> stored;  ///< what unpackCompressed reads
  ReflectanceBlock block;         ///< what it gives
};
/// None where the block is empty or a basis would be no smaller than half of the halves.
std::optional<CompressedBlock> compressBlock(const StoreGeometry& geometry, std::span<const std::uint16_t> block,
                                             double error);
/// False where the bytes are no such block.
bool unpackCompressed(const StoreGeometry& geometry, std::span<const std::byte> stored, ReflectanceBlock& block);
/// The same of what stores before version 3 keep, zstd undone.
bool unpackShuffledCompressed(const StoreGeometry& geometry, std::span<const std::byte> stored,
                              ReflectanceBlock& block);

/// Lossless: differences of halves to the texel above (first row: to the left), each row of texels under one light in
/// as many bits as they need (doc/field_format.md).
void packBlock(const StoreGeometry& geometry, const std::uint16_t* block, std::vector<std::byte>& out);
/// False where the bytes are no such block; whatever they hold, nothing beyond them is read.
bool unpackBlock(const StoreGeometry& geometry, std::span<const std::byte> stored, std::uint16_t* block);
/// The same bit by bit: the oracle.
bool unpackBlockPlain(const StoreGeometry& geometry, std::span<const std::byte> stored, std::uint16_t* block);

/// Lossless, for zstd: the same differences, low and high bytes apart.
void shuffleBlock(const StoreGeometry& geometry, const std::uint16_t* block, std::byte* out);
void unshuffleBlock(const StoreGeometry& geometry, const std::byte* in, std::uint16_t* block);

}  // namespace srf
