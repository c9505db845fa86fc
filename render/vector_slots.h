// Which slot holds which of the vectors of light weights that one block's operations ask for: what is computed of a
// vector is computed once for all that share it.
#pragma once

#include <algorithm>
#include <cstdint>
#include <limits>
#include <vector>

#include "render/light_weights.h"

namespace srf {

/// Slots are numbers that add() gives, looked up by a vector's address (open addressing) in 2^bits places, several
/// times the slots.
template <class Slot, int bits>
class VectorSlots {
 public:
  static constexpr Slot kNone = std::numeric_limits<Slot>::max();

  VectorSlots() : slot_of_hash_(kPlaces, kNone) {}
  /// Says of which gather the next shared vectors are.
  void sharedBy(const LightGather& lights) {
    if (lights_ == &lights) return;
    lights_ = &lights;
    slot_of_shared_.assign(lights.vectors.size(), kNone);
  }
  /// The slot of shared vector `index`; otherwise as of().
  template <class Add>
  Slot ofShared(std::uint32_t index, const float* const* vectors, std::size_t floats, const Add& add) {
    Slot& slot = slot_of_shared_[index];
    if (slot == kNone) slot = of(lights_->vectors[index], vectors, floats, add);
    return slot;
  }
  /// The slot for which vectors[slot] is `vector`; without one that of add(vector), and the vector, so many floats, is
  /// fetched into the cache: it is read once the block's other operations have been looked at.
  template <class Add>
  Slot of(const float* vector, const float* const* vectors, std::size_t floats, const Add& add) {
    std::size_t at = (reinterpret_cast<std::uintptr_t>(vector) * 0x9e3779b97f4a7c15u) >> (64 - bits);
    for (;; at = (at + 1) % kPlaces) {
      Slot& slot = slot_of_hash_[at];
      if (slot != kNone && vectors[slot] != vector) continue;
      if (slot == kNone) {
        constexpr std::size_t kCacheLine = 64 / sizeof(float);
        slot = add(vector);
        for (const float *line = vector, *end = vector + floats; line < end; line += kCacheLine)
          __builtin_prefetch(line);
      }
      return slot;
    }
  }
  /// Forgets all slots.
  void clear() {
    lights_ = nullptr;
    std::fill(slot_of_hash_.begin(), slot_of_hash_.end(), kNone);
  }

 private:
  static constexpr std::size_t kPlaces = std::size_t{1} << bits;

  std::vector<Slot> slot_of_hash_;
  const LightGather* lights_ = nullptr;
  std::vector<Slot> slot_of_shared_;
};

}  // namespace srf
