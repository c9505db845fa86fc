#include "render/basis_kernels.h"

#include "field/reflectance_block.h"
#include "render/highway_targets.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "render/basis_kernels.cpp"
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

#include "render/lane_sums-inl.h"

HWY_BEFORE_NAMESPACE();
namespace srf {
namespace HWY_NAMESPACE {
static_assert(kRankGroup == kSumLanes);

template <int kVectors>
void projectOf(const float* basis, int rank_pad, std::span<const std::uint32_t> lit, const float* const* vectors,
               int light_pad, float* const* projected) {
  const F f;
  const auto pad = static_cast<std::size_t>(light_pad);
  for (int k = 0; k < rank_pad; k += static_cast<int>(hn::Lanes(f))) {
    Part sum[kVectors][3];
    for (auto& of_vector : sum)
      for (Part& channel : of_vector) channel = hn::Zero(f);
    for (const std::uint32_t j : lit) {
      const auto row = hn::LoadU(f, basis + static_cast<std::size_t>(j) * rank_pad + k);
      const std::size_t at[3] = {j, j + pad, j + 2 * pad};
      for (int v = 0; v < kVectors; ++v)
        for (int c = 0; c < 3; ++c) sum[v][c] = hn::MulAdd(row, hn::Set(f, vectors[v][at[c]]), sum[v][c]);
    }
    for (int v = 0; v < kVectors; ++v)
      for (int c = 0; c < 3; ++c) hn::StoreU(sum[v][c], f, projected[v] + c * rank_pad + k);
  }
}

void project(const float* basis, int rank_pad, std::span<const std::uint32_t> lit, const float* const* vectors,
             int light_pad, int count, float* const* projected) {
  withCount(count, [&](auto number) { projectOf<number.value>(basis, rank_pad, lit, vectors, light_pad, projected); });
}

void sum(const std::uint16_t* block, const float* basis, int rank_pad, const float* projected,
         std::span<const BasisSum> sums) {
  const F f;
  const hn::Rebind<hwy::float16_t, F> h;
  const hn::FixedTag<float, 4> four;
  const std::size_t texel = 3 * static_cast<std::size_t>(rank_pad);
  for (const BasisSum& one : sums) {
    const ShadingOperation& o = *one.operation;
    // A texel beyond the tile has weight 0 and is read from inside it instead.
    const std::size_t right = o.x + 1 < kTile ? texel : 0, below = o.y + 1 < kTile ? kTile * texel : 0;
    const auto* at = reinterpret_cast<const hwy::float16_t*>(block) + (o.y * kTile + o.x) * texel;
    const auto t0 = hn::Set(f, o.tap[0]), t1 = hn::Set(f, o.tap[1]), t2 = hn::Set(f, o.tap[2]),
               t3 = hn::Set(f, o.tap[3]);
    Part total[3][kParts];
    for (auto& channel : total)
      for (Part& part : channel) part = hn::Zero(f);
    for (int first = 0; first < rank_pad; first += static_cast<int>(kSumLanes))
      for (std::size_t p = 0; p < kParts; ++p) {
        const std::size_t k = static_cast<std::size_t>(first) + p * hn::Lanes(f);
        Part weight[3] = {hn::Zero(f), hn::Zero(f), hn::Zero(f)};
        for (int i = 0; i < one.share_count; ++i) {
          const auto share = hn::Set(f, one.shares[i]);
          const float* const vector = projected + one.slot[i] * texel + k;
          for (int c = 0; c < 3; ++c) weight[c] = hn::MulAdd(share, hn::LoadU(f, vector + c * rank_pad), weight[c]);
        }
        for (std::uint32_t i = 0; i < one.entry_count; ++i) {
          const LightEntry& entry = one.entries[i];
          const auto row = hn::LoadU(f, basis + static_cast<std::size_t>(entry.light) * rank_pad + k);
          for (int c = 0; c < 3; ++c) weight[c] = hn::MulAdd(row, hn::Set(f, entry.weight[c]), weight[c]);
        }
        for (int c = 0; c < 3; ++c) {
          const auto* const halves = at + c * rank_pad + k;
          const auto load = [&](std::size_t offset) { return hn::PromoteTo(f, hn::LoadU(h, halves + offset)); };
          auto value = hn::Mul(t0, load(0));
          value = hn::MulAdd(t1, load(right), value);
          value = hn::MulAdd(t2, load(below), value);
          value = hn::MulAdd(t3, load(below + right), value);
          total[c][p] = hn::MulAdd(value, weight[c], total[c][p]);
        }
      }
    alignas(16) float rgb[4];
    hn::Store(foldedRgb(fold(f, total[0]), fold(f, total[1]), fold(f, total[2])), four, rgb);
    *one.result = {rgb[0], rgb[1], rgb[2]};
  }
}

}  // namespace HWY_NAMESPACE
}  // namespace srf
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace srf {
HWY_EXPORT(project);
HWY_EXPORT(sum);

void projectVectors(const float* basis, int rank_pad, std::span<const std::uint32_t> lit, const float* const* vectors,
                    int light_pad, int count, float* const* projected) {
  HWY_DYNAMIC_DISPATCH(project)(basis, rank_pad, lit, vectors, light_pad, count, projected);
}
void basisSums(const std::uint16_t* block, const float* basis, int rank_pad, const float* projected,
               std::span<const BasisSum> sums) {
  HWY_DYNAMIC_DISPATCH(sum)(block, basis, rank_pad, projected, sums);
}

}  // namespace srf
#endif
