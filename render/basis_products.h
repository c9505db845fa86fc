// The products of a compressed block's texels with what operations multiply them by (M15). Vectors of light weights
// that operations share go into the block's basis once each; an operation then blends some ten numbers a channel and
// multiplies its four texels with them, which costs less than tables of products would (texel_products.h).
#pragma once

#include <cstdint>
#include <vector>

#include "field/reflectance_block.h"
#include "render/basis_kernels.h"
#include "render/light_weights.h"
#include "render/shading_operation.h"
#include "render/vector_slots.h"

namespace srf {

class BasisProducts {
 public:
  /// Begins a block in a basis under so many lights. It must stay until flush().
  void begin(const ReflectanceBlock& block, int light_count);
  /// Notes an operation and where its result goes. Everything must stay until flush().
  void add(const ShadingOperation& operation, const LightGather& lights, Rgb& result);
  /// Computes the results of all operations noted.
  void flush();

 private:
  static constexpr std::size_t kSlots = 256;  ///< vectors held at once

  const ReflectanceBlock* block_ = nullptr;
  int light_pad_ = 0;
  std::vector<const float*> vectors_;  ///< of each slot in use
  VectorSlots<std::uint16_t, 10> slot_of_vector_;
  std::vector<BasisSum> sums_;
  std::vector<float> projected_;  ///< float[slots][3][block_->pad]
};

}  // namespace srf
