// The products of one block's texels with what operations multiply them by, each made once however many operations ask
// for it (M15). An operation's light weights are a blend of vectors that many hits share, plus single lights: by
// linearity the block's texels are multiplied with each vector alone, and operations blend and interpolate the colours
// that come out. At two pixels a texel that is a fifth of the work.
#pragma once

#include <cstdint>
#include <memory>
#include <vector>

#include "render/light_weights.h"
#include "render/shading_operation.h"
#include "render/texel_kernels.h"

namespace srf {

class TexelProducts {
 public:
  TexelProducts();
  /// Begins a block: half[16][16][3][light_pad]. It must stay until flush().
  void begin(const std::uint16_t* block, int light_pad);
  /// Notes an operation and where its result goes. Everything must stay until flush().
  void add(const ShadingOperation& operation, const LightGather& lights, Rgb& result);
  /// Computes the results of all operations noted.
  void flush();

 private:
  static constexpr int kSlots = 64;  ///< tables held at once: one bit each
  static constexpr int kTexels = 256;

  int slotOfVector(const float* vector);
  int slotOfLight(std::uint32_t light);
  void fill();
  float* table(int slot) { return tables_.get() + static_cast<std::size_t>(slot) * kTexels * kProductRow; }

  const std::uint16_t* block_ = nullptr;
  int pad_ = 0;
  std::unique_ptr<float[]> tables_;          ///< float[kSlots][256][kProductRow]
  std::vector<const float*> vector_;         ///< of each slot; none: a single light
  std::vector<std::uint32_t> light_;         ///< of each slot
  std::vector<std::uint8_t> slot_of_light_;  ///< kSlots: none
  std::vector<std::uint8_t> slot_of_hash_;   ///< of a vector's address, open addressing
  std::uint64_t wanted_[kTexels] = {};       ///< by texel: slots
  struct Noted {
    const ShadingOperation* operation;
    const LightGather* lights;
    Rgb* result;
    std::uint32_t first_row, first_color;
    int shares, colors;
    float share[4];
    std::uint16_t texel[4];
  };
  std::vector<Noted> noted_;
  std::vector<const float*> rows_;
  std::vector<float> colors_;
  std::vector<ProductSum> sums_;
};

}  // namespace srf
