// Products of texels with vectors of light weights, and sums of them: kernels of texel_products over plain arrays. The
// same bits in every instruction set: sums run in 16 lanes, folded in halves.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>

#include "render/reflectance_dot.h"

namespace srf {

inline constexpr int kProductVectors = 4;  ///< that one texel is multiplied with at once

/// products[i][c] = sum over lights j of texel[c][j] * vectors[i][c][j] for i < count <= kProductVectors; [3] is 0.
/// `texel`: half[3][light_pad]; vectors: float[3][light_pad]; light_pad a multiple of 16. Error: at most
/// (light_pad / 16 + 4) 2^-24 of the sum of the terms' absolute values.
void texelDots(const std::uint16_t* texel, int light_pad, const float* const* vectors, int count,
               float* const* products);
/// The same of one vector in double, one term after the other: the oracle.
std::array<double, 3> texelDotReference(const std::uint16_t* texel, int light_pad, const float* vector);

/// products[i] = texel[.][lights[i]], the reflectance under one light; [3] is 0.
void texelLights(const std::uint16_t* texel, int light_pad, const std::uint32_t* lights, int count,
                 float* const* products);

/// A table of products, one row of kProductRow floats a texel of the block: r, g, b, 0.
inline constexpr int kProductRow = 4;
inline constexpr int kProductTable = 256 * kProductRow;  ///< floats

/// What one operation adds up: own + sum over terms of coefficient * (sum over taps of tap * table[slot][texel]).
struct ProductSum {
  float tap[4];              ///< of the texels `texel`, the next one, and the two a row below; 0: unused, but read
  int texel;                 ///< position of the first of them in the block
  const std::uint8_t* slot;  ///< of each term its table
  float shares[5];           ///< coefficients of the first terms
  int share_count;
  const LightEntry* entries;  ///< of the other terms: coefficients of r, g and b
  int entry_count;
  bool continues;  ///< the result holds `own`; else that is 0
  Rgb* result;
};
/// Taps in 8 lanes, two texels beside one another; the terms of shares, of even and of odd entries, each in their
/// order, then their sums; then the halves, then `own`.
void sumProducts(const float* tables, const ProductSum* sums, std::size_t count);

}  // namespace srf
