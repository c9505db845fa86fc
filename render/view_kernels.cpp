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
    for (int j = 0; j < kWanted; ++j) hn::StoreU(of[j], n, nearest + j * stride + i);
    hn::StoreU(others, f, rest + i);
  }
}

void nearest(const NearViews& views, const NearLanes& hits, std::size_t count, std::size_t stride, int wanted,
             float* bound, std::int32_t* views_nearest, float* rest) {
  withCount<kMostNearViews>(
      wanted, [&](auto n) { nearestOf<decltype(n)::value>(views, hits, count, stride, bound, views_nearest, rest); });
}

/// One view against a vector of hits; results go to the lanes `where`.
template <class D>
HWY_INLINE void placeOne(D d, const PlacedView& view, hn::Mask<D> where, double least_foreshortening, double fades,
                         const HitLanes& hits, std::size_t i, const ViewLanes& out) {
  const Camera<AcquisitionSpace>& camera = view.camera;
  const Intrinsics& lens = camera.lens;
  const bool orthographic = lens.isOrthographic();
  const Mat3& rotation = camera.pose.rotation().raw();  // columns: the camera's axes
  const Vec3& center = camera.center().raw();
  const auto zero = hn::Zero(d), one = hn::Set(d, 1.0), half = hn::Set(d, 0.5);
  const auto put = [&](auto value, double* to) { hn::BlendedStore(value, where, d, to + i); };
  const auto dot = [&](auto ax, auto ay, auto az, auto bx, auto by, auto bz) {
    return hn::Add(hn::Add(hn::Mul(ax, bx), hn::Mul(ay, by)), hn::Mul(az, bz));
  };
  const auto axis = [&](int column, auto x, auto y, auto z) {
    return dot(x, y, z, hn::Set(d, rotation.row[0][column]), hn::Set(d, rotation.row[1][column]),
               hn::Set(d, rotation.row[2][column]));
  };
  // From p to the camera.
  auto tx = hn::Sub(hn::Set(d, center.x), hn::LoadU(d, hits.px + i));
  auto ty = hn::Sub(hn::Set(d, center.y), hn::LoadU(d, hits.py + i));
  auto tz = hn::Sub(hn::Set(d, center.z), hn::LoadU(d, hits.pz + i));
  const auto qx = hn::Neg(axis(0, tx, ty, tz)), qy = hn::Neg(axis(1, tx, ty, tz)), qz = hn::Neg(axis(2, tx, ty, tz));
  if (orthographic) {
    const Vec3 forward = camera.forward().raw();
    tx = hn::Set(d, -forward.x), ty = hn::Set(d, -forward.y), tz = hn::Set(d, -forward.z);
  }
  const auto length = hn::Sqrt(dot(tx, ty, tz, tx, ty, tz));
  const auto inverse = hn::Div(one, length);
  tx = hn::Mul(tx, inverse), ty = hn::Mul(ty, inverse), tz = hn::Mul(tz, inverse);
  const auto cx = hn::Sub(tx, hn::LoadU(d, hits.vx + i)), cy = hn::Sub(ty, hn::LoadU(d, hits.vy + i)),
             cz = hn::Sub(tz, hn::LoadU(d, hits.vz + i));
  const auto chord = hn::Sqrt(dot(cx, cy, cz, cx, cy, cz));
  const auto half_angle = hn::Asin(d, hn::Min(one, hn::Mul(half, chord)));
  const auto angle = hn::Add(half_angle, half_angle);
  put(angle, out.angle);

  const auto eye = hn::LoadU(d, hits.eye_distance + i);
  const auto further = hn::Div(hn::Mul(hn::Set(d, kResolutionPenalty), hn::Sub(length, eye)), eye);
  const auto counts = orthographic ? hn::Lt(zero, zero) : hn::And(hn::Gt(length, eye), hn::Gt(eye, zero));
  const auto seen_whole = hn::Max(hn::Add(angle, hn::IfThenElseZero(counts, further)), hn::Set(d, kLeastPenalty));

  const auto facing = dot(hn::LoadU(d, hits.nx + i), hn::LoadU(d, hits.ny + i), hn::LoadU(d, hits.nz + i), tx, ty, tz);
  put(hn::Sqrt(hn::Min(one, hn::Max(hn::Set(d, least_foreshortening), facing))), out.foreshortening);

  const auto x = orthographic ? qx : hn::Div(qx, qz), y = orthographic ? qy : hn::Div(qy, qz);
  const auto pixel_x =
      hn::Add(hn::Add(hn::Mul(hn::Set(d, lens.fl_x), x), hn::Mul(hn::Set(d, lens.skew), y)), hn::Set(d, lens.cx));
  const auto pixel_y = hn::Add(hn::Mul(hn::Set(d, lens.fl_y), y), hn::Set(d, lens.cy));
  put(pixel_x, out.pixel_x);
  put(pixel_y, out.pixel_y);
  const auto border = hn::Min(hn::Min(pixel_x, pixel_y), hn::Min(hn::Sub(hn::Set(d, lens.width), pixel_x),
                                                                 hn::Sub(hn::Set(d, lens.height), pixel_y)));
  put(border, out.border);
  const auto split = [&](auto pixel, double first, double* floor, double* part) {
    const auto at = hn::Sub(hn::Sub(pixel, half), hn::Set(d, first));
    const auto near = hn::Floor(hn::Add(at, half));
    const auto snapped = hn::IfThenElse(hn::Lt(hn::Abs(hn::Sub(at, near)), hn::Set(d, 1e-6)), near, at);
    const auto below = hn::Floor(snapped);
    put(below, floor);
    put(hn::Sub(snapped, below), part);
  };
  split(pixel_x, view.crop.x, out.floor_x, out.part_x);
  split(pixel_y, view.crop.y, out.floor_y, out.part_y);
  const auto in_picture = hn::Gt(orthographic ? border : hn::Min(border, qz), zero);
  const auto weight = hn::LoadU(d, hits.weight + i), cap = hn::Set(d, kPenaltyCap);
  const auto known = hn::And(hn::Gt(length, zero), hn::Ne(weight, zero)), always = hn::Eq(one, one);
  const auto usable = hn::And(known, view.bends ? always : in_picture);
  const auto ask = hn::Or(hn::Lt(weight, zero), view.bends ? always : hn::Lt(border, hn::Set(d, fades)));
  put(hn::IfThenElseZero(usable, hn::IfThenElse(ask, hn::Set(d, 2.0), one)), out.usable);
  const auto penalty = hn::IfThenElse(ask, seen_whole, hn::Div(seen_whole, weight));
  put(hn::IfThenElse(hn::And(usable, hn::Lt(penalty, cap)), penalty, cap), out.penalty);
}

void place(const PlacedView* views, const std::int32_t* view, double least_foreshortening, double border,
           const HitLanes& hits, std::size_t count, const ViewLanes& out) {
  const hn::CappedTag<double, kVectorLanes> d;
  const hn::RebindToSigned<decltype(d)> wide;
  const hn::Rebind<std::int32_t, decltype(d)> narrow;
  for (std::size_t i = 0; i < count; i += hn::Lanes(d)) {
    const auto of = hn::PromoteTo(wide, hn::LoadU(narrow, view + i));
    auto rest = hn::And(hn::FirstN(wide, count - i), hn::Gt(of, hn::Set(wide, -1)));
    while (!hn::AllFalse(wide, rest)) {
      const std::int32_t next = view[i + hn::FindKnownFirstTrue(wide, rest)];
      const auto same = hn::And(rest, hn::Eq(of, hn::Set(wide, next)));
      placeOne(d, views[next], hn::RebindMask(d, same), least_foreshortening, border, hits, i, out);
      rest = hn::AndNot(same, rest);
    }
  }
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
HWY_EXPORT(chords);
HWY_EXPORT(angles);

void nearestViews(const NearViews& views, const NearLanes& hits, std::size_t count, std::size_t stride, int wanted,
                  float* bound, std::int32_t* views_nearest, float* rest) {
  HWY_DYNAMIC_DISPATCH(nearest)(views, hits, count, stride, wanted, bound, views_nearest, rest);
}
void placeViews(const PlacedView* views, const std::int32_t* view, double least_foreshortening, double border,
                const HitLanes& hits, std::size_t count, const ViewLanes& out) {
  HWY_DYNAMIC_DISPATCH(place)(views, view, least_foreshortening, border, hits, count, out);
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
