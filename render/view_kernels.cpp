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
               std::int32_t* slot, float* rest) {
  const hn::CappedTag<float, kVectorLanes> f;
  const hn::RebindToSigned<decltype(f)> n;
  const hn::RebindToUnsigned<decltype(f)> u;
  const auto one = hn::Set(f, 1.f), zero = hn::Zero(f), half = hn::Set(f, 0.5f), three_halves = hn::Set(f, 1.5f);
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
      // The chord to v is at most the angle.
      const auto dx = hn::MulSub(tx, r, vx), dy = hn::MulSub(ty, r, vy), dz = hn::MulSub(tz, r, vz);
      const auto chord = hn::Sqrt(hn::MulAdd(dx, dx, hn::MulAdd(dy, dy, hn::Mul(dz, dz))));
      const auto ratio = hn::Mul(hn::Mul(squared, r), inverse_eye);
      const auto resolution = hn::Mul(share, hn::Max(zero, hn::Sub(ratio, one)));
      const auto least = hn::Sub(hn::Add(chord, resolution), hn::Mul(margin, hn::Add(one, ratio)));
      const auto word = hn::LoadU(u, hits.seen + views.view[s] / 32 * stride + i);
      const auto seen = hn::RebindMask(f, hn::TestBit(word, hn::Set(u, std::uint32_t{1} << views.view[s] % 32)));
      // Not a number where p lies in the camera, or beyond float's range: then nothing is known.
      auto value = hn::IfThenElse(seen, hn::IfThenElse(hn::Gt(least, zero), least, zero), infinite);
      hn::StoreU(value, f, bound + s * stride + i);
      auto view = hn::Set(n, static_cast<std::int32_t>(s));
      keepLeast(best, of, value, view);
      others = hn::Min(others, value);
    }
    for (int j = 0; j < kWanted; ++j) hn::StoreU(of[j], n, slot + j * stride + i);
    hn::StoreU(others, f, rest + i);
  }
}

void nearest(const NearViews& views, const NearLanes& hits, std::size_t count, std::size_t stride, int wanted,
             float* bound, std::int32_t* slot, float* rest) {
  withCount<kMostNearViews>(
      wanted, [&](auto n) { nearestOf<decltype(n)::value>(views, hits, count, stride, bound, slot, rest); });
}

void place(const Camera<AcquisitionSpace>& camera, const Vec2& crop, double least_foreshortening, const HitLanes& hits,
           std::size_t count, const ViewLanes& out) {
  const hn::CappedTag<double, kVectorLanes> d;
  const bool orthographic = camera.lens.isOrthographic();
  const Mat3& rotation = camera.pose.rotation().raw();  // columns: the camera's axes
  const Vec3 forward = camera.forward().raw(), center = camera.center().raw();
  const auto zero = hn::Zero(d), one = hn::Set(d, 1.0), half = hn::Set(d, 0.5);
  const auto dot = [&](auto ax, auto ay, auto az, auto bx, auto by, auto bz) {
    return hn::Add(hn::Add(hn::Mul(ax, bx), hn::Mul(ay, by)), hn::Mul(az, bz));
  };
  const auto axis = [&](int column, auto x, auto y, auto z) {
    return dot(x, y, z, hn::Set(d, rotation.row[0][column]), hn::Set(d, rotation.row[1][column]),
               hn::Set(d, rotation.row[2][column]));
  };
  for (std::size_t i = 0; i < count; i += hn::Lanes(d)) {
    // From p to the camera.
    auto tx = hn::Sub(hn::Set(d, center.x), hn::LoadU(d, hits.px + i));
    auto ty = hn::Sub(hn::Set(d, center.y), hn::LoadU(d, hits.py + i));
    auto tz = hn::Sub(hn::Set(d, center.z), hn::LoadU(d, hits.pz + i));
    const auto qx = hn::Neg(axis(0, tx, ty, tz)), qy = hn::Neg(axis(1, tx, ty, tz)), qz = hn::Neg(axis(2, tx, ty, tz));
    if (orthographic) tx = hn::Set(d, -forward.x), ty = hn::Set(d, -forward.y), tz = hn::Set(d, -forward.z);
    const auto length = hn::Sqrt(dot(tx, ty, tz, tx, ty, tz));
    const auto inverse = hn::Div(one, length);
    tx = hn::Mul(tx, inverse), ty = hn::Mul(ty, inverse), tz = hn::Mul(tz, inverse);
    const auto cx = hn::Sub(tx, hn::LoadU(d, hits.vx + i)), cy = hn::Sub(ty, hn::LoadU(d, hits.vy + i)),
               cz = hn::Sub(tz, hn::LoadU(d, hits.vz + i));
    const auto chord = hn::Sqrt(dot(cx, cy, cz, cx, cy, cz));
    const auto angle = hn::Asin(d, hn::Min(one, hn::Mul(half, chord)));
    hn::StoreU(hn::Add(angle, angle), d, out.angle + i);

    const auto eye = hn::LoadU(d, hits.eye_distance + i);
    const auto further = hn::Div(hn::Mul(hn::Set(d, kResolutionPenalty), hn::Sub(length, eye)), eye);
    const auto counts = orthographic ? hn::Lt(zero, zero) : hn::And(hn::Gt(length, eye), hn::Gt(eye, zero));
    hn::StoreU(hn::IfThenElseZero(counts, further), d, out.resolution + i);

    const auto facing =
        dot(hn::LoadU(d, hits.nx + i), hn::LoadU(d, hits.ny + i), hn::LoadU(d, hits.nz + i), tx, ty, tz);
    hn::StoreU(hn::Sqrt(hn::Min(one, hn::Max(hn::Set(d, least_foreshortening), facing))), d, out.foreshortening + i);

    const auto x = orthographic ? qx : hn::Div(qx, qz), y = orthographic ? qy : hn::Div(qy, qz);
    const Intrinsics& lens = camera.lens;
    const auto pixel_x =
        hn::Add(hn::Add(hn::Mul(hn::Set(d, lens.fl_x), x), hn::Mul(hn::Set(d, lens.skew), y)), hn::Set(d, lens.cx));
    const auto pixel_y = hn::Add(hn::Mul(hn::Set(d, lens.fl_y), y), hn::Set(d, lens.cy));
    hn::StoreU(pixel_x, d, out.pixel_x + i);
    hn::StoreU(pixel_y, d, out.pixel_y + i);
    hn::StoreU(hn::Min(hn::Min(pixel_x, pixel_y),
                       hn::Min(hn::Sub(hn::Set(d, lens.width), pixel_x), hn::Sub(hn::Set(d, lens.height), pixel_y))),
               d, out.border + i);
    const auto split = [&](auto pixel, double first, double* floor, double* part) {
      const auto at = hn::Sub(hn::Sub(pixel, half), hn::Set(d, first));
      const auto near = hn::Floor(hn::Add(at, half));
      const auto snapped = hn::IfThenElse(hn::Lt(hn::Abs(hn::Sub(at, near)), hn::Set(d, 1e-6)), near, at);
      const auto below = hn::Floor(snapped);
      hn::StoreU(below, d, floor);
      hn::StoreU(hn::Sub(snapped, below), d, part);
    };
    split(pixel_x, crop.x, out.floor_x + i, out.part_x + i);
    split(pixel_y, crop.y, out.floor_y + i, out.part_y + i);
    const auto before = orthographic ? hn::Gt(one, zero) : hn::Gt(qz, zero);
    hn::StoreU(hn::IfThenElseZero(hn::And(before, hn::Gt(length, zero)), one), d, out.usable + i);
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
                  float* bound, std::int32_t* slot, float* rest) {
  HWY_DYNAMIC_DISPATCH(nearest)(views, hits, count, stride, wanted, bound, slot, rest);
}
void placeViews(const Camera<AcquisitionSpace>& camera, const Vec2& crop, double least_foreshortening,
                const HitLanes& hits, std::size_t count, const ViewLanes& out) {
  HWY_DYNAMIC_DISPATCH(place)(camera, crop, least_foreshortening, hits, count, out);
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
