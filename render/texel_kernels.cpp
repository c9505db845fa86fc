#include "render/texel_kernels.h"

#include "base/image_io.h"
#include "render/highway_targets.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "render/texel_kernels.cpp"
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

#include "render/lane_sums-inl.h"

HWY_BEFORE_NAMESPACE();
namespace srf {
namespace HWY_NAMESPACE {

template <int kVectors>
void dotsOf(const std::uint16_t* texel, int pad, const float* const* vectors, float* const* products) {
  const F f;
  const hn::Rebind<hwy::float16_t, F> h;
  const hn::FixedTag<float, 4> four;
  hn::Vec<hn::FixedTag<float, 4>> sums[3][kVectors];
  const auto* halves = reinterpret_cast<const hwy::float16_t*>(texel);
  for (int c = 0; c < 3; ++c) {
    Part parts[kVectors][kParts];
    for (auto& of_vector : parts)
      for (Part& part : of_vector) part = hn::Zero(f);
    for (int i = c * pad; i < (c + 1) * pad; i += static_cast<int>(kSumLanes))
      for (std::size_t p = 0; p < kParts; ++p) {
        const std::size_t at = static_cast<std::size_t>(i) + p * hn::Lanes(f);
        const auto value = hn::PromoteTo(f, hn::LoadU(h, halves + at));
        for (int v = 0; v < kVectors; ++v) parts[v][p] = hn::MulAdd(value, hn::LoadU(f, vectors[v] + at), parts[v][p]);
      }
    for (int v = 0; v < kVectors; ++v) sums[c][v] = fold(f, parts[v]);
  }
  for (int v = 0; v < kVectors; ++v) hn::StoreU(foldedRgb(sums[0][v], sums[1][v], sums[2][v]), four, products[v]);
}

void dots(const std::uint16_t* texel, int pad, const float* const* vectors, int count, float* const* products) {
  withCount(count, [&](auto number) { dotsOf<number.value>(texel, pad, vectors, products); });
}

void lights(const std::uint16_t* texel, int pad, const std::uint32_t* light, int count, float* const* products) {
  const hn::FixedTag<float, 4> four;
  const hn::Rebind<hwy::float16_t, decltype(four)> h;
  for (int i = 0; i < count; ++i) {
    const std::uint16_t* at = texel + light[i];
    alignas(8) const std::uint16_t rgb[4] = {at[0], at[pad], at[2 * pad], 0};
    hn::StoreU(hn::PromoteTo(four, hn::LoadU(h, reinterpret_cast<const hwy::float16_t*>(rgb))), four, products[i]);
  }
}

// The sum of the two halves of 8 lanes.
template <class D>
hn::Vec<hn::FixedTag<float, 4>> halves(D, const hn::Vec<D>* parts) {
  const hn::FixedTag<float, 4> four;
  if constexpr (hn::MaxLanes(D()) == 8)
    return hn::Add(hn::LowerHalf(four, parts[0]), hn::UpperHalf(four, parts[0]));
  else
    return hn::Add(parts[0], parts[1]);
}

void sum(const float* tables, const ProductSum* sums, std::size_t count) {
  // Two rows of a table, in one vector or two.
  const hn::CappedTag<float, 2 * kProductRow> two;
  constexpr std::size_t kWide = hn::MaxLanes(two), kTwo = 2 * kProductRow / kWide;
  const hn::FixedTag<float, 4> four;
  constexpr std::size_t kBelow = 16 * kProductRow;
  for (std::size_t s = 0; s < count; ++s) {
    const ProductSum& one = sums[s];
    alignas(32) const float upper[8] = {one.tap[0], one.tap[0], one.tap[0], one.tap[0],
                                        one.tap[1], one.tap[1], one.tap[1], one.tap[1]};
    alignas(32) const float lower[8] = {one.tap[2], one.tap[2], one.tap[2], one.tap[2],
                                        one.tap[3], one.tap[3], one.tap[3], one.tap[3]};
    const float* at = tables + static_cast<std::size_t>(one.texel) * kProductRow;
    hn::Vec<decltype(two)> total[kTwo];
    for (std::size_t p = 0; p < kTwo; ++p) {
      const auto t01 = hn::Load(two, upper + p * kWide), t23 = hn::Load(two, lower + p * kWide);
      const auto term = [&](int i) {
        const float* row = at + static_cast<std::size_t>(one.slot[i]) * kProductTable + p * kWide;
        return hn::MulAdd(t23, hn::LoadU(two, row + kBelow), hn::Mul(t01, hn::LoadU(two, row)));
      };
      // Three sums side by side: of the first terms, and of every other one of the rest.
      hn::Vec<decltype(two)> of_entries[2] = {hn::Zero(two), hn::Zero(two)};
      total[p] = hn::Zero(two);
      const int shares = one.share_count, entries = one.entry_count;
      for (int i = 0; i < shares; ++i) total[p] = hn::MulAdd(hn::Set(two, one.shares[i]), term(i), total[p]);
      const auto entry = [&](int i) {
        // light, r, g, b to r, g, b, 0
        const auto of = hn::LoadDup128(two, reinterpret_cast<const float*>(one.entries + i));
        of_entries[i % 2] = hn::MulAdd(hn::ShiftRightLanes<1>(two, of), term(shares + i), of_entries[i % 2]);
      };
      int i = 0;
      for (; i + 2 <= entries; i += 2) entry(i), entry(i + 1);
      if (i < entries) entry(i);
      total[p] = hn::Add(total[p], hn::Add(of_entries[0], of_entries[1]));
    }
    auto sum = halves(two, total);
    if (one.continues) {
      alignas(16) const float own[4] = {(*one.result)[0], (*one.result)[1], (*one.result)[2], 0};
      sum = hn::Add(hn::Load(four, own), sum);
    }
    alignas(16) float rgb[4];
    hn::Store(sum, four, rgb);
    *one.result = {rgb[0], rgb[1], rgb[2]};
  }
}

}  // namespace HWY_NAMESPACE
}  // namespace srf
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace srf {
HWY_EXPORT(dots);
HWY_EXPORT(lights);
HWY_EXPORT(sum);

void texelDots(const std::uint16_t* texel, int light_pad, const float* const* vectors, int count,
               float* const* products) {
  HWY_DYNAMIC_DISPATCH(dots)(texel, light_pad, vectors, count, products);
}
std::array<double, 3> texelDotReference(const std::uint16_t* texel, int light_pad, const float* vector) {
  std::array<double, 3> sum{};
  for (int c = 0; c < 3; ++c)
    for (int j = c * light_pad; j < (c + 1) * light_pad; ++j)
      sum[c] += static_cast<double>(floatFromHalf(texel[j])) * vector[j];
  return sum;
}
void texelLights(const std::uint16_t* texel, int light_pad, const std::uint32_t* lights, int count,
                 float* const* products) {
  HWY_DYNAMIC_DISPATCH(lights)(texel, light_pad, lights, count, products);
}
void sumProducts(const float* tables, const ProductSum* sums, std::size_t count) {
  HWY_DYNAMIC_DISPATCH(sum)(tables, sums, count);
}

}  // namespace srf
#endif
