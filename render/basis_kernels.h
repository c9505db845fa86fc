// Products with a compressed block in its basis, w . (B c) = (B^T w) . c: kernels of basis_products over plain arrays.
// The same bits in every instruction set: sums over the basis run in 16 lanes, folded in halves.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>

#include "render/reflectance_dot.h"

namespace srf {

/// Light weights in the basis: projected[i][c][k] = sum over lights j in `lit` of basis[j][k] * vectors[i][c][j], for
/// i < count <= kProductVectors. Of a surface that turns away from half of the lights, their rows of the basis are 0
/// and not `lit`. basis: float[][rank_pad], rank_pad a multiple of 16; vectors: float[3][light_pad]; projected:
/// float[3][rank_pad]. Error: at most (lit + 1) 2^-24 of the sum of the terms' absolute values.
void projectVectors(const float* basis, int rank_pad, std::span<const std::uint32_t> lit, const float* const* vectors,
                    int light_pad, int count, float* const* projected);

/// One operation: four texels, and a blend of vectors and single lights.
struct BasisSum {
  const ShadingOperation* operation;
  std::uint16_t slot[5];  ///< of each vector: where it is in `projected`
  std::uint16_t share_count;
  float shares[5];  ///< coefficients of the vectors
  std::uint32_t entry_count;
  const LightEntry* entries;
  Rgb* result;
};
/// result[c] = sum over k of (sum over taps of tap * block[texel][c][k]) * (sum over vectors of share *
/// projected[slot][c][k] + sum over entries of weight[c] * basis[light][k]). block: half[16][16][3][rank_pad];
/// projected: float[][3][rank_pad]. Terms in this order, then the lanes. Error: at most 2^-24 (share_count +
/// entry_count + rank_pad / 16 + 9) of the sum of the terms' absolute values.
void basisSums(const std::uint16_t* block, const float* basis, int rank_pad, const float* projected,
               std::span<const BasisSum> sums);

}  // namespace srf
