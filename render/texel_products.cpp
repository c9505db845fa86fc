#include "render/texel_products.h"

#include <algorithm>
#include <bit>

#include "base/check.h"
#include "field/reflectance_store.h"

namespace srf {
namespace {

constexpr std::uint8_t kNoSlot = 0xff;
constexpr std::size_t kHash = 256;  // a power of two, several times the slots

}  // namespace

TexelProducts::TexelProducts()
    : tables_(std::make_unique_for_overwrite<float[]>(static_cast<std::size_t>(kSlots) * kTexels * kProductRow)),
      slot_of_hash_(kHash, kNoSlot) {
  static_assert(kTexels == kTile * kTile);
}

void TexelProducts::begin(const std::uint16_t* block, int light_pad) {
  SRF_DCHECK(noted_.empty());
  block_ = block;
  pad_ = light_pad;
  slot_of_light_.assign(light_pad, kNoSlot);
}

int TexelProducts::slotOfVector(const float* vector) {
  std::size_t at = (reinterpret_cast<std::uintptr_t>(vector) * 0x9e3779b97f4a7c15u) >> 56;
  for (;; at = (at + 1) % kHash) {
    std::uint8_t& slot = slot_of_hash_[at];
    if (slot != kNoSlot && vector_[slot] != vector) continue;
    if (slot == kNoSlot) {
      slot = static_cast<std::uint8_t>(vector_.size());
      vector_.push_back(vector);
      light_.push_back(0);
    }
    return slot;
  }
}

int TexelProducts::slotOfLight(std::uint32_t light) {
  std::uint8_t& slot = slot_of_light_[light];
  if (slot == kNoSlot) {
    slot = static_cast<std::uint8_t>(vector_.size());
    vector_.push_back(nullptr);
    light_.push_back(light);
  }
  return slot;
}

void TexelProducts::add(const ShadingOperation& operation, const LightGather& lights, Rgb& result) {
  const LightWeights& weights = lights.weights[operation.lights];
  // What is this hit's alone is multiplied at once.
  result = weights.own == LightWeights::kNone
               ? Rgb{}
               : reflectanceDot(block_, pad_, operation, lights.own.data() + weights.own);
  const int x1 = std::min(operation.x + 1, kTile - 1), y1 = std::min(operation.y + 1, kTile - 1);
  Noted noted{&operation, &lights, &result, 0, 0, 0, 0, {}, {}};
  noted.texel[0] = static_cast<std::uint16_t>(operation.y * kTile + operation.x);
  noted.texel[1] = static_cast<std::uint16_t>(operation.y * kTile + x1);
  noted.texel[2] = static_cast<std::uint16_t>(y1 * kTile + operation.x);
  noted.texel[3] = static_cast<std::uint16_t>(y1 * kTile + x1);
  std::uint32_t entry = weights.first_entry;
  const std::uint32_t entries_end = weights.first_entry + weights.entries;
  bool shares = true;
  // As many terms as there are tables for; mostly all at once.
  while (shares || entry < entries_end) {
    const std::uint32_t now = std::min<std::uint32_t>(entries_end - entry, kSlots - 4);
    if (vector_.size() + 4 + now > kSlots) flush();
    noted.first_row = static_cast<std::uint32_t>(rows_.size());
    noted.first_color = static_cast<std::uint32_t>(colors_.size());
    noted.shares = 0;
    noted.colors = static_cast<int>(now);
    std::uint64_t slots = 0;
    const auto want = [&](int slot) {
      slots |= std::uint64_t{1} << slot;
      rows_.push_back(table(slot));
    };
    if (shares)
      for (int i = 0; i < 4; ++i) {
        if (!(weights.share[i] > 0)) continue;
        noted.share[noted.shares++] = weights.share[i];
        want(slotOfVector(lights.vectors[weights.shared[i]]));
      }
    for (std::uint32_t e = entry; e < entry + now; ++e) {
      const LightEntry& light = lights.entries[e];
      want(slotOfLight(light.light));
      colors_.insert(colors_.end(), {light.weight[0], light.weight[1], light.weight[2], 0});
    }
    for (int t = 0; t < 4; ++t) {
      if (operation.tap[t] == 0) noted.texel[t] = noted.texel[operation.tap[0] != 0 ? 0 : t];
      wanted_[noted.texel[t]] |= slots;
    }
    noted_.push_back(noted);
    shares = false;
    entry += now;
  }
}

void TexelProducts::fill() {
  for (int texel = 0; texel < kTexels; ++texel) {
    if (!wanted_[texel]) continue;
    const std::uint16_t* halves = block_ + static_cast<std::size_t>(texel) * 3 * pad_;
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
        texelDots(halves, pad_, vectors, count, products);
        count = 0;
      }
    }
    if (count > 0) texelDots(halves, pad_, vectors, count, products);
    texelLights(halves, pad_, lights, light_count, of_light);
    wanted_[texel] = 0;
  }
}

void TexelProducts::flush() {
  fill();
  sums_.clear();
  for (const Noted& noted : noted_)
    sums_.push_back({noted.operation->tap,
                     {noted.texel[0], noted.texel[1], noted.texel[2], noted.texel[3]},
                     rows_.data() + noted.first_row,
                     noted.share,
                     noted.shares,
                     colors_.data() + noted.first_color,
                     noted.colors,
                     noted.result});
  sumProducts(sums_.data(), sums_.size());
  noted_.clear();
  rows_.clear();
  colors_.clear();
  for (std::size_t slot = 0; slot < vector_.size(); ++slot)
    if (!vector_[slot]) slot_of_light_[light_[slot]] = kNoSlot;
  std::fill(slot_of_hash_.begin(), slot_of_hash_.end(), kNoSlot);
  vector_.clear();
  light_.clear();
}

}  // namespace srf
