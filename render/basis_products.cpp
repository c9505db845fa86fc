#include "render/basis_products.h"

#include <algorithm>

#include "base/check.h"
#include "render/texel_kernels.h"

namespace srf {
namespace {

constexpr int kCacheLine = 64 / sizeof(float);

}  // namespace

void BasisProducts::begin(const ReflectanceBlock& block, int light_count) {
  SRF_DCHECK(sums_.empty());
  block_ = &block;
  light_pad_ = lightPad(light_count);
  // It is read once its operations have been looked at.
  for (std::size_t i = 0; i < block.halves.size(); i += 2 * kCacheLine) __builtin_prefetch(&block.halves[i]);
  for (std::size_t i = 0; i < block.basis.size(); i += kCacheLine) __builtin_prefetch(&block.basis[i]);
}

void BasisProducts::add(const ShadingOperation& operation, const LightGather& lights, Rgb& result) {
  const LightWeights& weights = lights.weights[operation.lights];
  if (vectors_.size() + std::size(BasisSum().slot) > kSlots) flush();
  slot_of_vector_.sharedBy(lights);
  const auto add_slot = [this](const float* vector) {
    vectors_.push_back(vector);
    return static_cast<std::uint16_t>(vectors_.size() - 1);
  };
  const auto floats = 3 * static_cast<std::size_t>(light_pad_);
  BasisSum& sum = sums_.emplace_back();
  sum.operation = &operation;
  const auto share = [&](float part, std::uint16_t slot) {
    sum.shares[sum.share_count] = part;
    sum.slot[sum.share_count++] = slot;
  };
  for (int i = 0; i < 4; ++i) {
    if (!(weights.share[i] > 0)) continue;
    share(weights.share[i], slot_of_vector_.ofShared(weights.shared[i], vectors_.data(), floats, add_slot));
  }
  if (weights.own != LightWeights::kNone)
    share(1, slot_of_vector_.of(lights.own.data() + weights.own, vectors_.data(), floats, add_slot));
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
  slot_of_vector_.clear();
}

}  // namespace srf
