#include "render/light_kernels.h"

#include "base/numeric.h"
#include "field/lumigraph_weights.h"
#include "render/highway_targets.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "render/light_kernels.cpp"
#include <hwy/foreach_target.h>
#include <hwy/highway.h>
// After highway.h.
#include <hwy/contrib/math/math-inl.h>

#include "render/nearest_lanes-inl.h"

HWY_BEFORE_NAMESPACE();
namespace srf {
namespace HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

using F = hn::CappedTag<float, kVectorLanes>;
using I = hn::RebindToSigned<F>;

void cells(const float* x, const float* y, const float* z, std::size_t count, int resolution, std::int32_t* cell) {
  const F f;
  const I n;
  const auto half = hn::Set(f, 0.5f * static_cast<float>(resolution));
  const auto across = hn::Set(n, resolution), last = hn::Set(n, resolution - 1), none = hn::Zero(n);
  for (std::size_t i = 0; i < count; i += hn::Lanes(f)) {
    const auto dx = hn::LoadU(f, x + i), dy = hn::LoadU(f, y + i), dz = hn::LoadU(f, z + i);
    const auto ax = hn::Abs(dx), ay = hn::Abs(dy), az = hn::Abs(dz);
    const auto first = hn::And(hn::Ge(ax, ay), hn::Ge(ax, az));
    const auto second = hn::AndNot(first, hn::Ge(ay, az));
    const auto pick = [&](auto a, auto b, auto c) { return hn::IfThenElse(first, a, hn::IfThenElse(second, b, c)); };
    const auto major = pick(dx, dy, dz);
    const auto scale = hn::Div(half, hn::Abs(major));
    const auto index = [&](auto at) {
      return hn::Min(last, hn::Max(none, hn::ConvertTo(n, hn::MulAdd(at, scale, half))));
    };
    const auto s = index(pick(dy, dz, dx)), t = index(pick(dz, dx, dy));
    const auto axis = hn::IfThenElse(hn::RebindMask(n, first), none,
                                     hn::IfThenElse(hn::RebindMask(n, second), hn::Set(n, 2), hn::Set(n, 4)));
    const auto face = hn::Add(axis, hn::IfThenElseZero(hn::RebindMask(n, hn::Lt(major, hn::Zero(f))), hn::Set(n, 1)));
    hn::StoreU(hn::Add(hn::Mul(hn::Add(hn::Mul(face, across), t), across), s), n, cell + i);
  }
}

bool towards(const LitLanes& lit, const Vec3& position, double least_distance, std::size_t count, float* x, float* y,
             float* z, float* falloff) {
  const hn::CappedTag<double, kVectorLanes> d;
  const hn::Rebind<float, decltype(d)> f;
  const auto one = hn::Set(d, 1.0);
  float* const to[3] = {x, y, z};
  bool all = true;
  for (std::size_t i = 0; i < count; i += hn::Lanes(d)) {
    const auto tx = hn::Sub(hn::Set(d, position.x), hn::LoadU(d, lit.p_star[0] + i)),
               ty = hn::Sub(hn::Set(d, position.y), hn::LoadU(d, lit.p_star[1] + i)),
               tz = hn::Sub(hn::Set(d, position.z), hn::LoadU(d, lit.p_star[2] + i));
    const auto dotted = [&](auto ax, auto ay, auto az) {
      return hn::Add(hn::Add(hn::Mul(ax, tx), hn::Mul(ay, ty)), hn::Mul(az, tz));
    };
    const auto squared = dotted(tx, ty, tz);
    const auto ordinary =
        hn::And(hn::Gt(squared, hn::Set(d, kOrdinarySquares[0])), hn::Lt(squared, hn::Set(d, kOrdinarySquares[1])));
    all &= hn::AllTrue(d, hn::Or(ordinary, hn::Not(hn::FirstN(d, count - i))));
    const auto distance = hn::Sqrt(squared), inverse = hn::Div(one, distance);
    for (int k = 0; k < 3; ++k) {
      const double* const* const row = lit.l + 3 * k;
      const auto along = dotted(hn::LoadU(d, row[0] + i), hn::LoadU(d, row[1] + i), hn::LoadU(d, row[2] + i));
      hn::StoreU(hn::DemoteTo(f, hn::Mul(along, inverse)), f, to[k] + i);
    }
    const auto attenuated = hn::Max(distance, hn::Set(d, least_distance));
    hn::StoreU(hn::DemoteTo(f, hn::Div(one, hn::Mul(attenuated, attenuated))), f, falloff + i);
  }
  return all;
}

template <int kNearest>
void nearestOf(const LightCells& cells, const float* x, const float* y, const float* z, const std::int32_t* cell,
               std::size_t count, std::size_t stride, float* weight, std::uint32_t* light) {
  const F f;
  const I n;
  constexpr std::size_t kLanes = hn::MaxLanes(f);
  const auto far = hn::Set(f, 1e30f), least = hn::Set(f, static_cast<float>(kLeastPenalty)), zero = hn::Zero(f),
             one = hn::Set(f, 1.f);
  for (std::size_t i = 0; i < count; i += kLanes) {
    const auto dx = hn::LoadU(f, x + i), dy = hn::LoadU(f, y + i), dz = hn::LoadU(f, z + i);
    const auto cell_of = hn::LoadU(n, cell + i);
    hn::Vec<F> best[kNearest + 1];
    hn::Vec<I> source[kNearest + 1];
    for (int j = 0; j <= kNearest; ++j) best[j] = far, source[j] = hn::Zero(n);
    const auto look = [&](auto x, auto y, auto z, auto of, auto counts) {
      const auto cx = hn::Sub(dx, x), cy = hn::Sub(dy, y), cz = hn::Sub(dz, z);
      auto squared = hn::IfThenElse(counts, hn::MulAdd(cx, cx, hn::MulAdd(cy, cy, hn::Mul(cz, cz))), far);
      keepLeast(best, source, squared, of);
    };
    const std::size_t lanes = count - i < kLanes ? count - i : kLanes;
    std::int32_t distinct[kLanes];
    std::size_t cells_here = 0;
    for (std::size_t lane = 0; lane < lanes; ++lane) {
      bool known = false;
      for (std::size_t c = 0; c < cells_here; ++c) known |= distinct[c] == cell[i + lane];
      if (!known) distinct[cells_here++] = cell[i + lane];
    }
    if (cells_here <= 3) {
      // Neighbouring hits mostly lie in one cell or two: each cell's candidates are looked at for all lanes.
      for (std::size_t k = 0; k < cells_here; ++k) {
        const std::int32_t now = distinct[k];
        const auto here = hn::RebindMask(f, hn::Eq(cell_of, hn::Set(n, now)));
        for (std::uint32_t c = cells.begin[now]; c < cells.begin[now + 1]; ++c)
          look(hn::Set(f, cells.x[c]), hn::Set(f, cells.y[c]), hn::Set(f, cells.z[c]),
               hn::Set(n, static_cast<std::int32_t>(cells.candidates[c])), here);
      }
    } else {
      // Each lane has candidates of its own.
      std::int32_t first[kLanes], last[kLanes], most = 0;
      for (std::size_t lane = 0; lane < kLanes; ++lane) {
        const std::int32_t now = cell[i + (lane < lanes ? lane : 0)];
        first[lane] = static_cast<std::int32_t>(cells.begin[now]);
        last[lane] = static_cast<std::int32_t>(cells.begin[now + 1]) - 1;
        most = last[lane] - first[lane] > most ? last[lane] - first[lane] : most;
      }
      auto at = hn::LoadU(n, first);
      const auto end = hn::LoadU(n, last);
      for (std::int32_t c = 0; c <= most; ++c, at = hn::Add(at, hn::Set(n, 1))) {
        const auto valid = hn::Not(hn::Gt(at, end));
        const auto from = hn::Min(at, end);
        look(hn::GatherIndex(f, cells.x, from), hn::GatherIndex(f, cells.y, from), hn::GatherIndex(f, cells.z, from),
             hn::GatherIndex(n, reinterpret_cast<const std::int32_t*>(cells.candidates), from),
             hn::RebindMask(f, valid));
      }
    }
    const auto inverse = [&](auto squared) { return hn::Div(one, hn::Max(least, angleOfChord(f, squared))); };
    const auto threshold = inverse(best[kNearest]);
    hn::Vec<F> weights[kNearest];
    auto sum = zero;
    for (int j = 0; j < kNearest; ++j) {
      weights[j] = hn::Max(zero, hn::Sub(inverse(best[j]), threshold));
      sum = hn::Add(sum, weights[j]);
    }
    const auto scale = hn::IfThenElseZero(hn::Gt(sum, zero), hn::Div(one, sum));
    for (int j = 0; j < kNearest; ++j) {
      hn::StoreU(hn::Mul(weights[j], scale), f, weight + j * stride + i);
      hn::StoreU(source[j], n, reinterpret_cast<std::int32_t*>(light) + j * stride + i);
    }
  }
}

void nearest(const LightCells& cells, const float* x, const float* y, const float* z, const std::int32_t* cell,
             std::size_t count, int k, std::size_t stride, float* weight, std::uint32_t* light) {
  withCount<kMostNearest>(
      k, [&](auto n) { nearestOf<decltype(n)::value>(cells, x, y, z, cell, count, stride, weight, light); });
}

void orientations(const OrientationLanes& in, std::size_t count, std::int32_t half_cells, const OrientationCells& out) {
  const F f;
  const I n;
  const auto one = hn::Set(f, 1.f), zero = hn::Zero(f);
  const auto scale = hn::Set(f, static_cast<float>(half_cells / (kPi / 4)));
  const auto last = hn::Set(n, half_cells - 1), none = hn::Zero(n);
  for (std::size_t i = 0; i < count; i += hn::Lanes(f)) {
    hn::Vec<F> m[9];
    for (int j = 0; j < 9; ++j) m[j] = hn::LoadU(f, in.m[j] + i);
    const auto minor = [&](int a, int b, int c, int d) { return hn::Sub(hn::Mul(m[a], m[d]), hn::Mul(m[b], m[c])); };
    const auto determinant =
        hn::MulAdd(m[0], minor(4, 5, 7, 8), hn::NegMulAdd(m[1], minor(3, 5, 6, 8), hn::Mul(m[2], minor(3, 4, 6, 7))));
    const auto reflected = hn::Lt(determinant, zero);
    for (auto& of : m) of = hn::IfThenElse(reflected, hn::Neg(of), of);
    // 4 q_i^2 of each component, and 4 q_i q_j of the pairs (quaternionFromRotation): only ratios are needed.
    const auto xx = m[0], yy = m[4], zz = m[8];
    const auto w2 = hn::Add(hn::Add(one, xx), hn::Add(yy, zz)), x2 = hn::Sub(hn::Add(one, xx), hn::Add(yy, zz)),
               y2 = hn::Add(hn::Sub(one, xx), hn::Sub(yy, zz)), z2 = hn::Sub(hn::Sub(one, xx), hn::Sub(yy, zz));
    const auto wx = hn::Sub(m[7], m[5]), wy = hn::Sub(m[2], m[6]), wz = hn::Sub(m[3], m[1]);
    const auto xy = hn::Add(m[3], m[1]), xz = hn::Add(m[2], m[6]), yz = hn::Add(m[7], m[5]);
    const auto is_w = hn::And(hn::Ge(w2, x2), hn::And(hn::Ge(w2, y2), hn::Ge(w2, z2)));
    const auto is_x = hn::AndNot(is_w, hn::And(hn::Ge(x2, y2), hn::Ge(x2, z2)));
    const auto is_y = hn::AndNot(hn::Or(is_w, is_x), hn::Ge(y2, z2));
    const auto pick = [&](auto w, auto x, auto y, auto z) {
      return hn::IfThenElse(is_w, w, hn::IfThenElse(is_x, x, hn::IfThenElse(is_y, y, z)));
    };
    const auto inverse = hn::Div(one, pick(w2, x2, y2, z2));
    const hn::Vec<F> coordinate[3] = {hn::Mul(pick(wx, wx, wy, wz), inverse), hn::Mul(pick(wy, xy, xy, xz), inverse),
                                      hn::Mul(pick(wz, xz, yz, yz), inverse)};
    const auto bit = [&](auto mask, int value) {
      return hn::IfThenElseZero(hn::RebindMask(n, mask), hn::Set(n, value));
    };
    auto code = hn::Or(bit(reflected, 8), hn::Or(bit(is_x, 1 << 4), bit(is_y, 2 << 4)));
    code = hn::Or(code, bit(hn::Not(hn::Or(is_w, hn::Or(is_x, is_y))), 3 << 4));
    for (int j = 0; j < 3; ++j) {
      const auto at = hn::Mul(hn::Abs(hn::Atan(f, coordinate[j])), scale);
      const auto cell = hn::Min(last, hn::Max(none, hn::ConvertTo(n, at)));
      hn::StoreU(cell, n, out.cell[j] + i);
      hn::StoreU(hn::Min(one, hn::Max(zero, hn::Sub(at, hn::ConvertTo(f, cell)))), f, out.fraction[j] + i);
      code = hn::Or(code, bit(hn::Lt(coordinate[j], zero), 1 << j));
    }
    hn::StoreU(code, n, out.code + i);
  }
}

}  // namespace HWY_NAMESPACE
}  // namespace srf
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace srf {
HWY_EXPORT(cells);
HWY_EXPORT(towards);
HWY_EXPORT(nearest);
HWY_EXPORT(orientations);

void lightCells(const float* x, const float* y, const float* z, std::size_t count, int resolution, std::int32_t* cell) {
  HWY_DYNAMIC_DISPATCH(cells)(x, y, z, count, resolution, cell);
}
bool towardsLight(const LitLanes& lit, const Vec3& position, double least_distance, std::size_t count, float* x,
                  float* y, float* z, float* falloff) {
  return HWY_DYNAMIC_DISPATCH(towards)(lit, position, least_distance, count, x, y, z, falloff);
}
void nearestWeights(const LightCells& of, const float* x, const float* y, const float* z, const std::int32_t* cell,
                    std::size_t count, int k, std::size_t stride, float* weight, std::uint32_t* light) {
  HWY_DYNAMIC_DISPATCH(nearest)(of, x, y, z, cell, count, k, stride, weight, light);
}
void orientationCells(const OrientationLanes& lanes, std::size_t count, std::int32_t half_cells,
                      const OrientationCells& out) {
  HWY_DYNAMIC_DISPATCH(orientations)(lanes, count, half_cells, out);
}

}  // namespace srf
#endif
