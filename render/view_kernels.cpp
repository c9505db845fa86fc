#include "render/view_kernels.h"

#include <limits>

#include "base/numeric.h"
#include "field/lumigraph_weights.h"
#include "render/highway_targets.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "render/view_kernels.cpp"
#include <hwy/foreach_target.h>
#include <hwy/highway.h>
// After highway.h.
#include <hwy/contrib/math/math-inl.h>

#include "render/nearest_lanes-inl.h"

HWY_BEFORE_NAMESPACE();
namespace srf {
namespace HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

template <int kWanted>
void nearestOf(const NearViews& views, const NearLanes& hits, std::size_t count, std::size_t stride, float* bound,
               std::int32_t* nearest, float* rest) {
  const hn::CappedTag<float, kVectorLanes> f;
  const hn::RebindToSigned<decltype(f)> n;
  const hn::RebindToUnsigned<decltype(f)> u;
  const auto one = hn::Set(f, 1.f), zero = hn::Zero(f), half = hn::Set(f, 0.5f), three_halves = hn::Set(f, 1.5f);
  const auto cubic = hn::Set(f, 1.f / 24), quintic = hn::Set(f, 3.f / 640);
  const auto share = hn::Set(f, static_cast<float>(kResolutionPenalty)), margin = hn::Set(f, 1e-5f);
  const auto infinite = hn::Set(f, std::numeric_limits<float>::infinity());
  for (std::size_t i = 0; i < count; i += hn::Lanes(f)) {
    const auto px = hn::LoadU(f, hits.px + i), py = hn::LoadU(f, hits.py + i), pz = hn::LoadU(f, hits.pz + i);
    const auto vx = hn::LoadU(f, hits.vx + i), vy = hn::LoadU(f, hits.vy + i), vz = hn::LoadU(f, hits.vz + i);
    const auto inverse_eye = hn::LoadU(f, hits.inverse_eye + i);
    hn::Vec<decltype(f)> best[kWanted], others = infinite;
    hn::Vec<decltype(n)> of[kWanted];
    for (int j = 0; j < kWanted; ++j) best[j] = infinite, of[j] = hn::Set(n, -1);
    for (std::size_t s = 0; s < views.count; ++s) {
      const auto tx = hn::Sub(hn::Set(f, views.x[s]), px), ty = hn::Sub(hn::Set(f, views.y[s]), py),
                 tz = hn::Sub(hn::Set(f, views.z[s]), pz);
      const auto squared = hn::MulAdd(tx, tx, hn::MulAdd(ty, ty, hn::Mul(tz, tz)));
      auto r = hn::ApproximateReciprocalSqrt(squared);  // and a step of Newton's: some 1e-7
      r = hn::Mul(r, hn::NegMulAdd(hn::Mul(half, squared), hn::Mul(r, r), three_halves));
      // Of the chord to v: the series of 2 asin(chord / 2), all of whose terms are positive, up to the fifth power.
      const auto dx = hn::MulSub(tx, r, vx), dy = hn::MulSub(ty, r, vy), dz = hn::MulSub(tz, r, vz);
      const auto chord = hn::Sqrt(hn::MulAdd(dx, dx, hn::MulAdd(dy, dy, hn::Mul(dz, dz))));
      const auto chord2 = hn::Mul(chord, chord);
      const auto angle = hn::MulAdd(hn::Mul(chord, chord2), hn::MulAdd(chord2, quintic, cubic), chord);
      const auto ratio = hn::Mul(hn::Mul(squared, r), inverse_eye);
      const auto resolution = hn::Mul(share, hn::Max(zero, hn::Sub(ratio, one)));
      const auto least = hn::Sub(hn::Add(angle, resolution), hn::Mul(margin, hn::Add(one, ratio)));
      const auto word = hn::LoadU(u, hits.seen + views.view[s] / 32 * stride + i);
      const auto seen = hn::RebindMask(f, hn::TestBit(word, hn::Set(u, std::uint32_t{1} << views.view[s] % 32)));
      // Not a number where p lies in the camera, or beyond float's range: then nothing is known.
      auto value = hn::IfThenElse(seen, hn::IfThenElse(hn::Gt(least, zero), least, zero), infinite);
      hn::StoreU(value, f, bound + s * stride + i);
      auto view = hn::Set(n, static_cast<std::int32_t>(views.view[s]));
      keepLeast(best, of, value, view);
      others = hn::Min(others, value);
    }
    // Neighbours mostly have the same views, not always in the same order.
    for (int last = kWanted - 1; last > 0; --last)
      for (int j = 0; j < last; ++j) {
        const auto less = hn::Min(of[j], of[j + 1]);
        of[j + 1] = hn::Max(of[j], of[j + 1]);
        of[j] = less;
      }
    for (int j = 0; j < kWanted; ++j) hn::StoreU(of[j], n, nearest + j * stride + i);
    hn::StoreU(others, f, rest + i);
  }
}

void nearest(const NearViews& views, const NearLanes& hits, std::size_t count, std::size_t stride, int wanted,
             float* bound, std::int32_t* views_nearest, float* rest) {
  withCount<kMostNearViews>(
      wanted, [&](auto n) { nearestOf<decltype(n)::value>(views, hits, count, stride, bound, views_nearest, rest); });
}

/// What of views the placing of a vector of hits needs, lane by lane.
template <class D>
struct LensLanes {
  using V = hn::Vec<D>;
  V center[3], forward[3], rotation[3][3];
  V fl_x, skew, cx, fl_y, cy, width, height, crop_x, crop_y, across, down, tiles_x, first_tile;
  hn::Mask<D> orthographic, bends, by_all;
  bool any_orthographic = false;

  /// All lanes of one view.
  HWY_INLINE LensLanes(D d, const PlacedView& view) {
    const auto never = hn::Lt(hn::Zero(d), hn::Zero(d));
    orthographic = bends = by_all = never;
    put(view, hn::Not(never), [d](double value, V& to) { to = hn::Set(d, value); });
  }
  HWY_INLINE void take(D d, const PlacedView& view, hn::Mask<D> where) {
    orthographic = hn::AndNot(where, orthographic), bends = hn::AndNot(where, bends);
    put(view, where, [d, where](double value, V& to) { to = hn::IfThenElse(where, hn::Set(d, value), to); });
  }

 private:
  template <class Put>
  HWY_INLINE void put(const PlacedView& view, hn::Mask<D> where, const Put& to) {
    for (int row = 0; row < 3; ++row) {
      to(view.center[row], center[row]);
      for (int column = 0; column < 3; ++column) to(view.rotation.row[row][column], rotation[row][column]);
    }
    to(view.fl_x, fl_x), to(view.skew, skew), to(view.cx, cx), to(view.fl_y, fl_y), to(view.cy, cy);
    to(view.width, width), to(view.height, height), to(view.crop_x, crop_x), to(view.crop_y, crop_y);
    to(view.across, across), to(view.down, down), to(view.tiles_x, tiles_x), to(view.first_tile, first_tile);
    for (int row = 0; row < 3 && view.orthographic; ++row) to(view.forward[row], forward[row]);
    if (view.orthographic) orthographic = hn::Or(orthographic, where), any_orthographic = true;
    if (view.bends) bends = hn::Or(bends, where);
  }
};

/// hn::Asin of what is not negative, without the part for beyond 1/2 where there is none: the same bits.
template <class D, class V>
HWY_INLINE V arcsine(D d, V x) {
  if (!hn::AllTrue(d, hn::Lt(x, hn::Set(d, 0.5)))) return hn::Asin(d, x);
  const V squared = hn::Mul(x, x);
  return hn::MulAdd(hn::impl::AsinImpl<double>().AsinPoly(d, squared, x), hn::Mul(squared, x), x);
}

/// Lanes where bit `bit` of a vector of words is set.
template <class D, class U>
HWY_INLINE hn::Mask<D> bitSet(D d, U words, U bit) {
  const hn::DFromV<U> u;
  const hn::RebindToSigned<decltype(u)> n;
  return hn::Ne(hn::PromoteTo(d, hn::BitCast(n, hn::And(hn::Shr(words, bit), hn::Set(u, 1u)))), hn::Zero(d));
}

void place(const PlacedView* views, const WholeTexels& texels, const std::int32_t* view, double least_foreshortening,
           double fades, const HitLanes& hits, std::size_t count, const ViewLanes& out) {
  const hn::CappedTag<double, kVectorLanes> d;
  const hn::RebindToSigned<decltype(d)> wide;
  const hn::Rebind<std::int32_t, decltype(d)> n;
  const hn::Rebind<std::uint32_t, decltype(d)> u;
  const hn::Rebind<float, decltype(d)> f;
  const auto zero = hn::Zero(d), one = hn::Set(d, 1.0), half = hn::Set(d, 0.5), cap = hn::Set(d, kPenaltyCap);
  const auto dot = [](auto ax, auto ay, auto az, auto bx, auto by, auto bz) {
    return hn::Add(hn::Add(hn::Mul(ax, bx), hn::Mul(ay, by)), hn::Mul(az, bz));
  };
  for (std::size_t i = 0; i < count; i += hn::Lanes(d)) {
    const auto of = hn::PromoteTo(wide, hn::LoadU(n, view + i));
    const auto some = hn::And(hn::FirstN(wide, count - i), hn::Gt(of, hn::Set(wide, -1)));
    if (hn::AllFalse(wide, some)) {
      hn::StoreU(cap, d, out.penalty + i);
      hn::StoreU(hn::Zero(n), n, out.state + i);
      continue;
    }
    const auto views_of = [&](auto lanes) { return view[i + hn::FindKnownFirstTrue(wide, lanes)]; };
    std::int32_t next = views_of(some);
    LensLanes lens(d, views[next]);
    for (auto rest = some;;) {
      const auto same = hn::And(rest, hn::Eq(of, hn::Set(wide, next)));
      const auto word = hn::LoadU(u, hits.by_all + next / 32 * hits.stride + i);
      const auto all = bitSet(d, word, hn::Set(u, static_cast<std::uint32_t>(next % 32)));
      lens.by_all = hn::Or(lens.by_all, hn::And(hn::RebindMask(d, same), all));
      rest = hn::AndNot(same, rest);
      if (hn::AllFalse(wide, rest)) break;
      next = views_of(rest);
      lens.take(d, views[next], hn::RebindMask(d, hn::Eq(of, hn::Set(wide, next))));
    }

    // From p to the camera.
    auto tx = hn::Sub(lens.center[0], hn::LoadU(d, hits.px + i));
    auto ty = hn::Sub(lens.center[1], hn::LoadU(d, hits.py + i));
    auto tz = hn::Sub(lens.center[2], hn::LoadU(d, hits.pz + i));
    const auto axis = [&](int column) {
      return hn::Neg(dot(tx, ty, tz, lens.rotation[0][column], lens.rotation[1][column], lens.rotation[2][column]));
    };
    const auto qx = axis(0), qy = axis(1), qz = axis(2);
    if (lens.any_orthographic) {
      tx = hn::IfThenElse(lens.orthographic, hn::Neg(lens.forward[0]), tx);
      ty = hn::IfThenElse(lens.orthographic, hn::Neg(lens.forward[1]), ty);
      tz = hn::IfThenElse(lens.orthographic, hn::Neg(lens.forward[2]), tz);
    }
    const auto length = hn::Sqrt(dot(tx, ty, tz, tx, ty, tz));
    const auto inverse = hn::Div(one, length);
    tx = hn::Mul(tx, inverse), ty = hn::Mul(ty, inverse), tz = hn::Mul(tz, inverse);
    const auto cx = hn::Sub(tx, hn::LoadU(d, hits.vx + i)), cy = hn::Sub(ty, hn::LoadU(d, hits.vy + i)),
               cz = hn::Sub(tz, hn::LoadU(d, hits.vz + i));
    const auto chord = hn::Sqrt(dot(cx, cy, cz, cx, cy, cz));
    const auto half_angle = arcsine(d, hn::Min(one, hn::Mul(half, chord)));
    const auto angle = hn::Add(half_angle, half_angle);
    hn::StoreU(angle, d, out.angle + i);

    const auto eye = hn::LoadU(d, hits.eye_distance + i);
    const auto counts = hn::AndNot(lens.orthographic, hn::And(hn::Gt(length, eye), hn::Gt(eye, zero)));
    auto seen_whole = angle;
    if (!hn::AllFalse(d, counts)) {
      const auto further = hn::Div(hn::Mul(hn::Set(d, kResolutionPenalty), hn::Sub(length, eye)), eye);
      seen_whole = hn::Add(angle, hn::IfThenElseZero(counts, further));
    }
    seen_whole = hn::Max(seen_whole, hn::Set(d, kLeastPenalty));

    const auto facing =
        dot(hn::LoadU(d, hits.nx + i), hn::LoadU(d, hits.ny + i), hn::LoadU(d, hits.nz + i), tx, ty, tz);
    hn::StoreU(hn::Sqrt(hn::Min(one, hn::Max(hn::Set(d, least_foreshortening), facing))), d, out.foreshortening + i);

    const auto along = hn::IfThenElse(lens.orthographic, one, hn::Div(one, qz));
    const auto x = hn::Mul(qx, along), y = hn::Mul(qy, along);
    const auto pixel_x = hn::Add(hn::Add(hn::Mul(lens.fl_x, x), hn::Mul(lens.skew, y)), lens.cx);
    const auto pixel_y = hn::Add(hn::Mul(lens.fl_y, y), lens.cy);
    hn::StoreU(pixel_x, d, out.pixel_x + i);
    hn::StoreU(pixel_y, d, out.pixel_y + i);
    const auto border =
        hn::Min(hn::Min(pixel_x, pixel_y), hn::Min(hn::Sub(lens.width, pixel_x), hn::Sub(lens.height, pixel_y)));
    hn::StoreU(border, d, out.border + i);
    const auto in_picture = hn::Gt(hn::IfThenElse(lens.orthographic, border, hn::Min(border, qz)), zero);

    // The four texels about the pixel, as bilinearFetch has them.
    const auto split = [&](auto pixel, auto first, auto& part) {
      const auto at = hn::Sub(hn::Sub(pixel, half), first);
      const auto near = hn::Floor(hn::Add(at, half));
      const auto snapped = hn::IfThenElse(hn::Lt(hn::Abs(hn::Sub(at, near)), hn::Set(d, 1e-6)), near, at);
      const auto below = hn::Floor(snapped);
      part = hn::Sub(snapped, below);
      return below;
    };
    auto part_x = zero, part_y = zero;
    auto texel_x = split(pixel_x, lens.crop_x, part_x), texel_y = split(pixel_y, lens.crop_y, part_y);
    const auto inside =
        hn::And(hn::And(hn::Ge(texel_x, zero), hn::Ge(texel_y, zero)),
                hn::And(hn::Lt(texel_x, hn::Sub(lens.across, one)), hn::Lt(texel_y, hn::Sub(lens.down, one))));
    texel_x = hn::IfThenElseZero(inside, texel_x), texel_y = hn::IfThenElseZero(inside, texel_y);
    const auto column = hn::DemoteTo(n, texel_x), row = hn::DemoteTo(n, texel_y);
    const auto in_tiles = hn::Set(d, 1.0 / kTile);
    const auto tile = hn::Add(hn::MulAdd(hn::Floor(hn::Mul(texel_y, in_tiles)), lens.tiles_x, lens.first_tile),
                              hn::Floor(hn::Mul(texel_x, in_tiles)));
    static_assert(kTile == 16 && WholeTexels::kTileWords == 8);
    const auto words = hn::ShiftLeft<3>(hn::GatherIndex(n, texels.tiles(), hn::DemoteTo(n, tile)));
    const auto word =
        hn::GatherIndex(u, texels.words(), hn::Add(words, hn::And(hn::ShiftRight<1>(row), hn::Set(n, 7))));
    const auto bit = hn::Or(hn::And(column, hn::Set(n, 15)), hn::ShiftLeft<4>(hn::And(row, hn::Set(n, 1))));
    const auto whole = hn::AndNot(lens.bends, hn::And(inside, bitSet(d, word, hn::BitCast(u, bit))));
    hn::StoreU(column, n, out.x + i);
    hn::StoreU(row, n, out.y + i);
    const auto other_x = hn::Sub(one, part_x), other_y = hn::Sub(one, part_y);
    hn::StoreInterleaved4(hn::DemoteTo(f, hn::Mul(other_x, other_y)), hn::DemoteTo(f, hn::Mul(part_x, other_y)),
                          hn::DemoteTo(f, hn::Mul(other_x, part_y)), hn::DemoteTo(f, hn::Mul(part_x, part_y)), f,
                          out.tap + 4 * i);

    const auto signed_weight = hn::LoadU(d, hits.weight + i), weight = hn::Abs(signed_weight);
    const auto known = hn::And(hn::RebindMask(d, some), hn::And(hn::Gt(length, zero), hn::Ne(weight, zero)));
    const auto usable = hn::And(known, hn::Or(lens.bends, in_picture));
    const auto in_part = hn::AndNot(lens.by_all, hn::Lt(signed_weight, zero));
    const auto ask = hn::Or(hn::Or(in_part, lens.bends), hn::Lt(border, hn::Set(d, fades)));
    const auto state =
        hn::IfThenElse(whole, hn::IfThenElse(ask, hn::Set(d, double{kViewAsked}), one), hn::Set(d, double{kViewMixed}));
    hn::StoreU(hn::DemoteTo(n, hn::IfThenElseZero(usable, state)), n, out.state + i);
    const auto penalty = hn::IfThenElse(hn::And(whole, hn::Not(ask)), hn::Div(seen_whole, weight), seen_whole);
    hn::StoreU(hn::IfThenElse(hn::And(usable, hn::Lt(penalty, cap)), penalty, cap), d, out.penalty + i);
  }
}

template <int k>
void weighOf(const RankedLanes& lanes, std::size_t count, std::int64_t* pair, double* weights, std::int64_t* taken) {
  const hn::CappedTag<double, kVectorLanes> d;
  const hn::RebindToSigned<decltype(d)> n;
  const hn::Rebind<float, decltype(d)> f;
  const auto one = hn::Set(d, 1.0), cap = hn::Set(d, kPenaltyCap), least = hn::Set(d, kLeastPenalty);
  const std::size_t stride = lanes.stride;
  for (std::size_t i = 0; i < count; i += hn::Lanes(d)) {
    hn::Vec<decltype(d)> best[k + 1];
    hn::Vec<decltype(n)> of[k + 1];
    for (int j = 0; j <= k; ++j) best[j] = cap, of[j] = hn::Zero(n);
    for (std::size_t j = 0; j < lanes.ranks; ++j) {
      auto penalty = hn::LoadU(d, lanes.penalty + j * stride + i);
      auto which = hn::Iota(n, static_cast<std::int64_t>(j * stride + i));
      keepLeast(best, of, penalty, which);
    }
    const auto beyond = hn::Div(one, hn::Max(best[k], least));
    hn::Vec<decltype(d)> weight[k], sum = hn::Zero(d);
    auto number = hn::Zero(n);
    for (int r = 0; r < k; ++r) {
      auto w = hn::Sub(hn::Div(one, hn::Max(best[r], least)), beyond);
      const auto counts = hn::And(hn::Lt(best[r], cap), hn::Gt(w, hn::Zero(d)));
      w = hn::Mul(w, hn::GatherIndex(d, lanes.foreshortening, of[r]));
      weight[r] = hn::IfThenElseZero(counts, w);
      sum = hn::Add(sum, weight[r]);
      number = hn::Add(number, hn::IfThenElseZero(hn::RebindMask(n, counts), hn::Set(n, 1)));
    }
    for (int r = 0; r < k; ++r) {
      hn::StoreU(hn::Div(weight[r], sum), d, weights + r * stride + i);
      hn::StoreU(of[r], n, pair + r * stride + i);
    }
    const auto rest = hn::PromoteTo(d, hn::LoadU(f, lanes.rest + i));
    const auto others =
        hn::And(hn::Lt(rest, hn::Set(d, std::numeric_limits<double>::infinity())), hn::Not(hn::Gt(rest, best[k])));
    hn::StoreU(hn::IfThenZeroElse(hn::RebindMask(n, others), number), n, taken + i);
  }
}

void weigh(const RankedLanes& lanes, std::size_t count, int k, std::int64_t* pair, double* weight,
           std::int64_t* taken) {
  withCount<kMostNearViews - 1>(
      k, [&](auto views) { weighOf<decltype(views)::value>(lanes, count, pair, weight, taken); });
}

void chords(const Vec3& from, const double* x, const double* y, const double* z, std::size_t count, double* squared) {
  const hn::CappedTag<double, kVectorLanes> d;
  const auto fx = hn::Set(d, from.x), fy = hn::Set(d, from.y), fz = hn::Set(d, from.z);
  std::size_t i = 0;
  for (; i + hn::Lanes(d) <= count; i += hn::Lanes(d)) {
    const auto dx = hn::Sub(fx, hn::LoadU(d, x + i)), dy = hn::Sub(fy, hn::LoadU(d, y + i)),
               dz = hn::Sub(fz, hn::LoadU(d, z + i));
    hn::StoreU(hn::Add(hn::Add(hn::Mul(dx, dx), hn::Mul(dy, dy)), hn::Mul(dz, dz)), d, squared + i);
  }
  for (; i < count; ++i) {
    const double dx = from.x - x[i], dy = from.y - y[i], dz = from.z - z[i];
    squared[i] = dx * dx + dy * dy + dz * dz;
  }
}

void angles(double* chord2, std::size_t count) {
  const hn::CappedTag<double, kVectorLanes> d;
  for (std::size_t i = 0; i < count; i += hn::Lanes(d))
    hn::StoreU(angleOfChord(d, hn::LoadU(d, chord2 + i)), d, chord2 + i);
}

}  // namespace HWY_NAMESPACE
}  // namespace srf
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace srf {
HWY_EXPORT(nearest);
HWY_EXPORT(place);
HWY_EXPORT(weigh);
HWY_EXPORT(chords);
HWY_EXPORT(angles);

void nearestViews(const NearViews& views, const NearLanes& hits, std::size_t count, std::size_t stride, int wanted,
                  float* bound, std::int32_t* views_nearest, float* rest) {
  HWY_DYNAMIC_DISPATCH(nearest)(views, hits, count, stride, wanted, bound, views_nearest, rest);
}

PlacedView::PlacedView(const Camera<AcquisitionSpace>& camera)
    : center(camera.center().raw()),
      forward(camera.forward().raw()),
      rotation(camera.pose.rotation().raw()),
      fl_x(camera.lens.fl_x),
      skew(camera.lens.skew),
      cx(camera.lens.cx),
      fl_y(camera.lens.fl_y),
      cy(camera.lens.cy),
      width(camera.lens.width),
      height(camera.lens.height),
      orthographic(camera.lens.isOrthographic()),
      bends(bendsLines(camera.lens)) {}

void placeViews(const PlacedView* views, const WholeTexels& whole, const std::int32_t* view,
                double least_foreshortening, double border, const HitLanes& hits, std::size_t count,
                const ViewLanes& out) {
  HWY_DYNAMIC_DISPATCH(place)(views, whole, view, least_foreshortening, border, hits, count, out);
}
void weighViews(const RankedLanes& lanes, std::size_t count, int k, std::int64_t* pair, double* weight,
                std::int64_t* taken) {
  HWY_DYNAMIC_DISPATCH(weigh)(lanes, count, k, pair, weight, taken);
}
void squaredChords(const Vec3& d, const double* x, const double* y, const double* z, std::size_t count,
                   double* squared) {
  HWY_DYNAMIC_DISPATCH(chords)(d, x, y, z, count, squared);
}
void chordAngles(double* chord2, std::size_t count) {
  HWY_DYNAMIC_DISPATCH(angles)(chord2, count);
}

}  // namespace srf
#endif
