// Light weights in the basis of a compressed block: w . (B c) = (B^T w) . c, so that the product with the stack runs
// over a few coefficients in place of all lights.
#pragma once

#include <array>
#include <unordered_map>
#include <vector>

#include "field/reflectance_block.h"
#include "render/light_weights.h"

namespace srf {

/// out[c][k] = sum over lights j of weights[c][j] * basis[j][k]: float[3][rank_pad] from float[3][light_pad].
/// Error: at most (lights + 1) 2^-24 of the sum of the terms' absolute values.
void projectWeights(const float* basis, int rank_pad, int lights, const float* weights, int light_pad, float* out);

/// The projections that the operations of one block need. Vectors that many hits share are projected once, and blended
/// as they would have been before.
class ProjectedWeights {
 public:
  ProjectedWeights(const ReflectanceBlock& block, const StoreGeometry& geometry);
  /// float[3][block.pad]; holds until the next call.
  const float* of(const LightGather& lights, const LightWeights& weights);

 private:
  std::size_t shared(const float* vector);

  const ReflectanceBlock& block_;
  int lights_, light_pad_;
  std::size_t size_;  ///< floats of a projection
  std::vector<float> held_, result_;
  std::unordered_map<const float*, std::size_t> where_;  ///< of a shared vector's projection in held_
  std::array<std::pair<const float*, std::size_t>, 4> last_{};
};

}  // namespace srf
