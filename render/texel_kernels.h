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

/// What one operation adds up: own + sum over terms of coefficient * (sum over taps of tap * table[term][texel]).
struct ProductSum {
  const float* tap;          ///< 4
  std::uint16_t texel[4];    ///< positions in the block
  const float* const* rows;  ///< of each term its table
  const float* shares;       ///< of the first terms, one number for r, g and b
  int share_count;
  const float* colors;  ///< of the other terms, kProductRow floats each
  int color_count;
  Rgb* result;  ///< holds `own`
};
void sumProducts(const ProductSum* sums, std::size_t count);

}  // namespace srf
