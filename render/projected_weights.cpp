#include "render/projected_weights.h"

#include <algorithm>

namespace srf {

void projectWeights(const float* basis, int rank_pad, int lights, const float* weights, int light_pad, float* out) {
  // Components side by side: eight sums of each channel at a time, each in the order of the lights.
  for (int k = 0; k < rank_pad; k += kRankGroup) {
    float sum[3][kRankGroup] = {};
    for (int j = 0; j < lights; ++j) {
      const float* row = basis + static_cast<std::size_t>(j) * rank_pad + k;
      for (int c = 0; c < 3; ++c) {
        const float weight = weights[c * light_pad + j];
        for (int i = 0; i < kRankGroup; ++i) sum[c][i] += weight * row[i];
      }
    }
    for (int c = 0; c < 3; ++c) std::copy_n(sum[c], kRankGroup, out + c * rank_pad + k);
  }
}

ProjectedWeights::ProjectedWeights(const ReflectanceBlock& block, const StoreGeometry& geometry)
    : block_(block),
      lights_(geometry.light_count),
      light_pad_(geometry.lightPad()),
      size_(3 * static_cast<std::size_t>(block.pad)),
      result_(size_) {}

std::size_t ProjectedWeights::shared(const float* vector) {
  const auto [entry, added] = where_.try_emplace(vector, held_.size());
  if (added) {
    held_.resize(held_.size() + size_);
    projectWeights(block_.basis.data(), block_.pad, lights_, vector, light_pad_, &held_[entry->second]);
  }
  return entry->second;
}

const float* ProjectedWeights::of(const LightGather& lights, const LightWeights& w) {
  if (w.own != LightWeights::kNone)
    projectWeights(block_.basis.data(), block_.pad, lights_, lights.own.data() + w.own, light_pad_, result_.data());
  else
    std::fill(result_.begin(), result_.end(), 0.f);
  for (int i = 0; i < 4; ++i) {
    if (!(w.share[i] > 0)) continue;
    const float* vector = lights.vectors[w.shared[i]];
    if (last_[i].first != vector) last_[i] = {vector, shared(vector)};
    const float* projected = &held_[last_[i].second];
    for (std::size_t k = 0; k < size_; ++k) result_[k] += w.share[i] * projected[k];
  }
  for (std::uint32_t e = w.first_entry; e < w.first_entry + w.entries; ++e) {
    const LightEntry& entry = lights.entries[e];
    const float* row = block_.basis.data() + static_cast<std::size_t>(entry.light) * block_.pad;
    for (int c = 0; c < 3; ++c)
      for (int k = 0; k < block_.pad; ++k) result_[c * block_.pad + k] += entry.weight[c] * row[k];
  }
  return result_.data();
}

}  // namespace srf
