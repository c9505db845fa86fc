#include "render/texel_products.h"

#include <algorithm>
#include <bit>

#include "base/check.h"
#include "field/reflectance_store.h"

namespace srf {
namespace {

constexpr std::uint8_t kNoSlot = 0xff;

}  // namespace

TexelProducts::TexelProducts()
    // Zeros: a tap of weight 0 reads its texel too.
    : tables_(std::make_unique<float[]>(static_cast<std::size_t>(kSlots) * kProductTable)) {
  static_assert(kTexels == kTile * kTile && kTexels * kProductRow == kProductTable);
}

void TexelProducts::begin(const ReflectanceBlock& block, int light_count) {
  SRF_DCHECK(sums_used_ == 0);
  block_ = &block;
  if (!block.basis.empty()) return in_basis_.begin(block, light_count);
  light_count_ = light_count;
  slot_of_light_.assign(light_count, kNoSlot);
}

std::uint8_t TexelProducts::newSlot(const float* vector, std::uint32_t light) {
  vector_[slots_] = vector;
  light_[slots_] = light;
  return static_cast<std::uint8_t>(slots_++);
}

inline std::uint8_t TexelProducts::slotOfLight(std::uint32_t light) {
  std::uint8_t& slot = slot_of_light_[light];
  if (slot == kNoSlot) slot = newSlot(nullptr, light);
  return slot;
}

void TexelProducts::add(const ShadingOperation& operation, const LightGather& lights, Rgb& result) {
  if (!block_->basis.empty()) return in_basis_.add(operation, lights, result);
  const LightWeights& weights = lights.weights[operation.lights];
  // What is this hit's alone is multiplied at once.
  const bool own = weights.own != LightWeights::kNone;
  if (own) result = reflectanceDot(block_->halves.data(), block_->pad, operation, lights.own.data() + weights.own);
  const LightEntry* entry = lights.entries.data() + weights.first_entry;
  const LightEntry* const entries_end = entry + weights.entries;
  const std::size_t vector_floats = 3 * static_cast<std::size_t>(lightPad(light_count_));
  const auto add_slot = [this](const float* vector) { return newSlot(vector, 0); };
  bool first = true;
  // As many terms as there are tables for; mostly all at once.
  while (first || entry < entries_end) {
    const int now = static_cast<int>(std::min<std::ptrdiff_t>(entries_end - entry, kSlots - 5));
    if (slots_ + 5 + now > kSlots) flush();
    slot_of_vector_.sharedBy(lights);
    if (sums_used_ == sums_.size()) sums_.resize(std::max<std::size_t>(512, 2 * sums_.size()));
    if (terms_used_ + kSlots > terms_.size()) terms_.resize(std::max<std::size_t>(8192, 2 * terms_.size()));
    ProductSum& sum = sums_[sums_used_++];
    // 2 x 2 texels inside the block: at its end the taps beyond it have weight 0 and lie on the other side instead.
    const bool last_x = operation.x == kTile - 1, last_y = operation.y == kTile - 1;
    const float left = last_x ? 0.f : 1.f, above = last_y ? 0.f : 1.f;
    const float* const tap = operation.tap;
    const float top[2] = {left * tap[0], tap[last_x ? 0 : 1]}, bottom[2] = {left * tap[2], tap[last_x ? 2 : 3]};
    sum.tap[0] = above * top[0], sum.tap[1] = above * top[1];
    sum.tap[2] = last_y ? top[0] : bottom[0], sum.tap[3] = last_y ? top[1] : bottom[1];
    sum.texel = (operation.y - (last_y ? 1 : 0)) * kTile + operation.x - (last_x ? 1 : 0);
    sum.continues = own || !first;
    sum.result = &result;
    std::uint8_t* const begin = terms_.data() + terms_used_;
    std::uint8_t* to = begin;
    std::uint64_t slots = 0;
    int shares = 0;
    const auto share = [&](float part, std::uint8_t slot) {
      sum.shares[shares++] = part;
      slots |= std::uint64_t{1} << slot;
      *to++ = slot;
    };
    if (first) {
      for (int i = 0; i < 4; ++i) {
        if (!(weights.share[i] > 0)) continue;
        share(weights.share[i], slot_of_vector_.ofShared(weights.shared[i], vector_, vector_floats, add_slot));
      }
    }
    sum.share_count = shares;
    sum.entries = entry;
    sum.entry_count = now;
    for (int e = 0; e < now; ++e) {
      const std::uint8_t slot = slotOfLight(entry[e].light);
      slots |= std::uint64_t{1} << slot;
      *to++ = slot;
    }
    terms_used_ += to - begin;
    std::uint64_t* const wanted = wanted_ + sum.texel;
    wanted[0] |= slots, wanted[1] |= slots, wanted[kTile] |= slots, wanted[kTile + 1] |= slots;
    first = false;
    entry += now;
  }
}

void TexelProducts::fill() {
  const int pad = block_->pad;
  for (int texel = 0; texel < kTexels; ++texel) {
    if (!wanted_[texel]) continue;
    const std::uint16_t* halves = block_->halves.data() + static_cast<std::size_t>(texel) * 3 * pad;
    const float* vectors[kProductVectors];
    float* products[kProductVectors];
    std::uint32_t lights[kSlots];
    float* of_light[kSlots];
    int count = 0, light_count = 0;
    for (std::uint64_t rest = wanted_[texel]; rest; rest &= rest - 1) {
      const int slot = std::countr_zero(rest);
      float* to = table(slot) + static_cast<std::size_t>(texel) * kProductRow;
      if (!vector_[slot]) {
        lights[light_count] = light_[slot];
        of_light[light_count++] = to;
        continue;
      }
      vectors[count] = vector_[slot];
      products[count] = to;
      if (++count == kProductVectors) {
        texelDots(halves, pad, vectors, count, products);
        count = 0;
      }
    }
    if (count > 0) texelDots(halves, pad, vectors, count, products);
    texelLights(halves, pad, lights, light_count, of_light);
    wanted_[texel] = 0;
  }
}

void TexelProducts::flush() {
  if (!block_->basis.empty()) return in_basis_.flush();
  fill();
  const std::uint8_t* slot = terms_.data();
  for (std::size_t i = 0; i < sums_used_; ++i) {
    sums_[i].slot = slot;
    slot += sums_[i].share_count + sums_[i].entry_count;
  }
  sumProducts(tables_.get(), sums_.data(), sums_used_);
  sums_used_ = 0;
  terms_used_ = 0;
  slot_of_vector_.clear();
  for (int i = 0; i < slots_; ++i)
    if (!vector_[i]) slot_of_light_[light_[i]] = kNoSlot;
  slots_ = 0;
}

}  // namespace srf
