// What the kernels that look for the nearest of many share, one lane a hit. Included by kernels alone, once for each
// instruction set, as Highway has it.
#if defined(SRF_RENDER_NEAREST_LANES_INL_H) == defined(HWY_TARGET_TOGGLE)
#ifdef SRF_RENDER_NEAREST_LANES_INL_H
#undef SRF_RENDER_NEAREST_LANES_INL_H
#else
#define SRF_RENDER_NEAREST_LANES_INL_H
#endif

#include <hwy/highway.h>
// After highway.h.
#include <hwy/contrib/math/math-inl.h>

#include <type_traits>

#include "base/numeric.h"

HWY_BEFORE_NAMESPACE();
namespace srf {
namespace HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

/// Puts a value and what it is of among the least so far, in rising order, the earlier first where they are equal;
/// leaves in both what falls out.
template <class V, class N, int kCount>
HWY_INLINE void keepLeast(V (&best)[kCount], N (&of)[kCount], V& value, N& which) {
  const hn::DFromV<N> n;
  auto moves = hn::Lt(value, best[0]);  // whether what stood here is moved on: from where the value goes onwards
  for (int j = 0; j < kCount; ++j) {
    if (j > 0) moves = hn::Or(moves, hn::Lt(value, best[j]));
    const auto moves_of = hn::RebindMask(n, moves);
    const auto next = hn::IfThenElse(moves, best[j], value);
    const auto next_of = hn::IfThenElse(moves_of, of[j], which);
    best[j] = hn::IfThenElse(moves, value, best[j]);
    of[j] = hn::IfThenElse(moves_of, which, of[j]);
    value = next;
    which = next_of;
  }
}

/// The angle between unit vectors from the square of their chord: beyond a right angle by the chord to the opposite
/// direction, for an arcsine near 1 loses digits.
template <class D>
HWY_INLINE hn::Vec<D> angleOfChord(D d, hn::Vec<D> squared) {
  using T = hn::TFromD<D>;
  const auto two = hn::Set(d, T{2});
  const auto small = hn::Le(squared, two);
  const auto near = hn::IfThenElse(small, squared, hn::Max(hn::Sub(hn::Set(d, T{4}), squared), hn::Zero(d)));
  const auto angle = hn::Mul(two, hn::Asin(d, hn::Mul(hn::Set(d, static_cast<T>(0.5)), hn::Sqrt(near))));
  return hn::IfThenElse(small, angle, hn::Sub(hn::Set(d, static_cast<T>(kPi)), angle));
}

/// run(std::integral_constant<int, count>()), count from 1 to kMost.
template <int kMost, class Run>
void withCount(int count, const Run& run) {
  if constexpr (kMost > 1)
    if (count < kMost) return withCount<kMost - 1>(count, run);
  run(std::integral_constant<int, kMost>());
}

}  // namespace HWY_NAMESPACE
}  // namespace srf
HWY_AFTER_NAMESPACE();
#endif
