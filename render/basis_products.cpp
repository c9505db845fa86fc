#include "render/basis_products.h"

#include <algorithm>

#include "base/check.h"
#include "render/texel_kernels.h"

namespace srf {
namespace {

constexpr std::uint16_t kNoSlot = 0xffff;
constexpr int kCacheLine = 64 / sizeof(float);
constexpr int kHashBits = 10;  // several times the slots
constexpr std::size_t kHash = std::size_t{1} << kHashBits;

}  // namespace

BasisProducts::BasisProducts() : slot_of_hash_(kHash, kNoSlot) {}

void BasisProducts::begin(const ReflectanceBlock& block, int light_count) {
  SRF_DCHECK(sums_.empty());
  block_ = &block;
  light_pad_ = lightPad(light_count);
  // It is read once its operations have been looked at.
  for (std::size_t i = 0; i < block.halves.size(); i += 2 * kCacheLine) __builtin_prefetch(&block.halves[i]);
  for (std::size_t i = 0; i < block.basis.size(); i += kCacheLine) __builtin_prefetch(&block.basis[i]);
}

std::uint16_t BasisProducts::slotOf(const float* vector) {
  std::size_t at = (reinterpret_cast<std::uintptr_t>(vector) * 0x9e3779b97f4a7c15u) >> (64 - kHashBits);
  for (;; at = (at + 1) % kHash) {
    std::uint16_t& slot = slot_of_hash_[at];
    if (slot != kNoSlot && vectors_[slot] != vector) continue;
    if (slot == kNoSlot) {
      slot = static_cast<std::uint16_t>(vectors_.size());
      vectors_.push_back(vector);
      // It is read once the block's other operations have been looked at.
      for (const float *line = vector, *end = vector + 3 * light_pad_; line < end; line += kCacheLine)
        __builtin_prefetch(line);
    }
    return slot;
  }
}

void BasisProducts::add(const ShadingOperation& operation, const LightGather& lights, Rgb& result) {
  const LightWeights& weights = lights.weights[operation.lights];
  if (vectors_.size() + std::size(BasisSum().slot) > kSlots) flush();
  if (lights_ != &lights) {
    lights_ = &lights;
    slot_of_wanted_.assign(lights.vectors.size(), kNoSlot);
  }
  BasisSum& sum = sums_.emplace_back();
  sum.operation = &operation;
  const auto share = [&](float part, std::uint16_t slot) {
    sum.shares[sum.share_count] = part;
    sum.slot[sum.share_count++] = slot;
  };
  for (int i = 0; i < 4; ++i) {
    if (!(weights.share[i] > 0)) continue;
    std::uint16_t& slot = slot_of_wanted_[weights.shared[i]];
    if (slot == kNoSlot) slot = slotOf(lights.vectors[weights.shared[i]]);
    share(weights.share[i], slot);
  }
  if (weights.own != LightWeights::kNone) share(1, slotOf(lights.own.data() + weights.own));
  sum.entries = lights.entries.data() + weights.first_entry;
  sum.entry_count = weights.entries;
  sum.result = &result;
}

void BasisProducts::flush() {
  const std::size_t size = 3 * static_cast<std::size_t>(block_->pad);
  projected_.resize(std::max(projected_.size(), vectors_.size() * size));
  for (std::size_t first = 0; first < vectors_.size(); first += kProductVectors) {
    const int now = static_cast<int>(std::min<std::size_t>(kProductVectors, vectors_.size() - first));
    float* projected[kProductVectors];
    for (int i = 0; i < now; ++i) projected[i] = projected_.data() + (first + i) * size;
    projectVectors(block_->basis.data(), block_->pad, block_->lit, vectors_.data() + first, light_pad_, now, projected);
  }
  basisSums(block_->halves.data(), block_->basis.data(), block_->pad, projected_.data(), sums_);
  sums_.clear();
  vectors_.clear();
  lights_ = nullptr;
  std::fill(slot_of_hash_.begin(), slot_of_hash_.end(), kNoSlot);
}

}  // namespace srf
