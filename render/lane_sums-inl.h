// Sums over lanes that give the same bits in every instruction set: 16 lanes, folded in halves. Included by kernels
// alone, once for each instruction set, as Highway has it.
#if defined(SRF_RENDER_LANE_SUMS_INL_H) == defined(HWY_TARGET_TOGGLE)
#ifdef SRF_RENDER_LANE_SUMS_INL_H
#undef SRF_RENDER_LANE_SUMS_INL_H
#else
#define SRF_RENDER_LANE_SUMS_INL_H
#endif

#include <hwy/highway.h>

#include <type_traits>

#include "render/texel_kernels.h"

HWY_BEFORE_NAMESPACE();
namespace srf {
namespace HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

constexpr std::size_t kSumLanes = 16;
using F = hn::CappedTag<float, kSumLanes>;
constexpr std::size_t kParts = kSumLanes / hn::MaxLanes(F());
using Part = hn::Vec<F>;

// 16 lanes to 4, in halves.
template <class D>
HWY_INLINE hn::Vec<hn::FixedTag<float, 4>> fold(D, hn::Vec<D>* parts) {
  for (std::size_t left = kParts; left > 1; left /= 2)
    for (std::size_t i = 0; i < left / 2; ++i) parts[i] = hn::Add(parts[i], parts[i + left / 2]);
  const hn::FixedTag<float, 4> four;
  if constexpr (hn::MaxLanes(D()) == 16) {
    const hn::Half<D> eight;
    const auto half = hn::Add(hn::LowerHalf(eight, parts[0]), hn::UpperHalf(eight, parts[0]));
    return hn::Add(hn::LowerHalf(four, half), hn::UpperHalf(four, half));
  } else if constexpr (hn::MaxLanes(D()) == 8) {
    return hn::Add(hn::LowerHalf(four, parts[0]), hn::UpperHalf(four, parts[0]));
  } else {
    return parts[0];
  }
}

/// Four lanes each of r, g and b to their sums r, g, b, 0: lanes 0 and 2, 1 and 3 first, then the two sums.
template <class V>
HWY_INLINE V foldedRgb(V r, V g, V b) {
  const hn::FixedTag<float, 4> four;
  const auto zero = hn::Zero(four);
  const auto rb = hn::Add(hn::InterleaveLower(four, r, b), hn::InterleaveUpper(four, r, b));
  const auto g0 = hn::Add(hn::InterleaveLower(four, g, zero), hn::InterleaveUpper(four, g, zero));
  return hn::Add(hn::InterleaveLower(four, rb, g0), hn::InterleaveUpper(four, rb, g0));
}

/// Calls run with `count` <= kProductVectors as a constant: a kernel keeps its sums in registers.
template <class Run>
HWY_INLINE void withCount(int count, const Run& run) {
  static_assert(kProductVectors == 4);
  switch (count) {
    case 1:
      return run(std::integral_constant<int, 1>());
    case 2:
      return run(std::integral_constant<int, 2>());
    case 3:
      return run(std::integral_constant<int, 3>());
    default:
      return run(std::integral_constant<int, 4>());
  }
}

}  // namespace HWY_NAMESPACE
}  // namespace srf
HWY_AFTER_NAMESPACE();

#endif
