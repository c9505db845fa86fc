// The products of one block's texels with what operations multiply them by, each made once however many operations ask
// for it (M15). An operation's light weights are a blend of vectors that many hits share, plus single lights: by
// linearity the block's texels are multiplied with each vector alone, and operations blend and interpolate the colours
// that come out. At two pixels a texel that is a fifth of the work. Compressed blocks are basis_products' work.
#pragma once

#include <cstdint>
#include <memory>
#include <vector>

#include "field/reflectance_block.h"
#include "render/basis_products.h"
#include "render/light_weights.h"
#include "render/shading_operation.h"
#include "render/texel_kernels.h"
#include "render/vector_slots.h"

namespace srf {

class TexelProducts {
 public:
  TexelProducts();
  /// Begins a block under so many lights. It must stay until flush().
  void begin(const ReflectanceBlock& block, int light_count);
  /// Notes an operation and where its result goes. Everything must stay until flush().
  void add(const ShadingOperation& operation, const LightGather& lights, Rgb& result);
  /// Has what a later add() reads fetched into the cache.
  static void prefetchWeights(const ShadingOperation& operation, const LightGather& lights) {
    __builtin_prefetch(lights.weights.data() + operation.lights);
  }
  static void prefetchEntries(const ShadingOperation& operation, const LightGather& lights) {
    const LightWeights& weights = lights.weights[operation.lights];
    if (weights.entries == 0) return;
    const char* const entries = reinterpret_cast<const char*>(lights.entries.data() + weights.first_entry);
    __builtin_prefetch(entries);
    __builtin_prefetch(entries + 64);
  }
  /// Computes the results of all operations noted.
  void flush();

 private:
  static constexpr int kSlots = 64;  ///< tables held at once: one bit each
  static constexpr int kTexels = 256;

  std::uint8_t slotOfLight(std::uint32_t light);
  std::uint8_t newSlot(const float* vector, std::uint32_t light);
  void fill();
  float* table(int slot) { return tables_.get() + static_cast<std::size_t>(slot) * kProductTable; }

  const ReflectanceBlock* block_ = nullptr;
  int light_count_ = 0;
  BasisProducts in_basis_;                   ///< of a compressed block
  std::unique_ptr<float[]> tables_;          ///< float[kSlots][256][kProductRow]
  int slots_ = 0;                            ///< in use
  const float* vector_[kSlots];              ///< of each slot; none: a single light
  std::uint32_t light_[kSlots];              ///< of each slot
  std::vector<std::uint8_t> slot_of_light_;  ///< kNoSlot: none
  VectorSlots<std::uint8_t, 8> slot_of_vector_;
  std::uint64_t wanted_[kTexels] = {};  ///< by texel: slots
  std::vector<ProductSum> sums_;
  std::size_t sums_used_ = 0;
  std::vector<std::uint8_t> terms_;  ///< slots of their terms
  std::size_t terms_used_ = 0;
};

}  // namespace srf
