// The product of reflectance and light weights: the inner loop of the renderer.
#pragma once

#include <array>
#include <cstdint>

#include "render/shading_operation.h"

namespace srf {

using Rgb = std::array<float, 3>;

/// What one light counts.
struct LightEntry {
  std::uint32_t light;  ///< position in the list
  Rgb weight;
};
static_assert(sizeof(LightEntry) == 16);  // kernels load it whole

/// sum over taps t and lights j of tap_t * block[y_t][x_t][c][j] * weights[c][j], for each channel c.
/// `block`: half[16][16][3][light_pad] of finite values; `weights`: float[3][light_pad]; light_pad a multiple of 8.
/// Error: at most (light_pad / 8 + 10) 2^-24 of the sum of the terms' absolute values.
Rgb reflectanceDot(const std::uint16_t* block, int light_pad, const ShadingOperation& operation, const float* weights);

/// The same, one term after the other in double: the oracle.
std::array<double, 3> reflectanceDotReference(const std::uint16_t* block, int light_pad,
                                              const ShadingOperation& operation, const float* weights);

/// sum[i] += share[0] * vector[0][i] + .. + share[3] * vector[3][i] for i < count, a multiple of 16; terms in this
/// order.
void addBlend(float* sum, const std::array<float, 4>& share, const std::array<const float*, 4>& vector, int count);

}  // namespace srf
