#include "model/local_frame.h"

#include <algorithm>
#include <cmath>
#include <optional>

#include "base/numeric.h"

namespace srf {
namespace {

// Smallest scalar part of the quaternion behind a Rodrigues vector (theory of the half turn: the frame of every normal
// of exactly -z is a half turn, whatever its phase). Turns R0 by at most twice this.
constexpr double kLeastScalarPart = 0x1p-20;
// Sine between a normal and the tangent asked for below which the tangent says nothing.
constexpr double kParallelSine = 1e-6;

// Unit vector along `a`; nothing for zero, infinite and NaN vectors. Scaled first by a power of two, which is exact.
std::optional<Vec3> unitAlong(const Vec3& a) {
  const double squared = dot(a, a);
  if (squared > 1e-250 && squared < 1e250) return a / std::sqrt(squared);  // the same bits, unscaled
  const double largest = std::max({std::fabs(a.x), std::fabs(a.y), std::fabs(a.z)});
  if (!isFinite(a) || !(largest > 0)) return std::nullopt;
  const int exponent = -std::ilogb(largest);
  const Vec3 scaled{std::scalbn(a.x, exponent), std::scalbn(a.y, exponent), std::scalbn(a.z, exponent)};
  return scaled / std::sqrt(dot(scaled, scaled));
}

Vec3 perpendicularTo(const Vec3& unit) {
  return anyPerpendicular(Direction<TangentSpace>::fromUnit(unit)).raw();
}

struct Pair {
  Vec3 u, v;  ///< orthonormal
};

// Eq. 8 and 9 by the sum s and the difference m of the unit tangents, which are perpendicular; b-bar is s normalised
// and b-bar x n-bar is m normalised. The longer of the two is exact to rounding; the other follows from it and the
// normal.
Pair bisectorPair(const Vec3& u_hat, const Vec3& v_hat, const Vec3& n_bar) {
  Vec3 s = u_hat + v_hat, m = u_hat - v_hat;
  if (dot(s, s) >= dot(m, m)) {
    s = s / std::sqrt(dot(s, s));
    m = cross(s, n_bar);
  } else {
    m = m / std::sqrt(dot(m, m));
    s = cross(n_bar, m);
  }
  return {std::sqrt(0.5) * (s + m), std::sqrt(0.5) * (s - m)};
}

// The orthonormal pair nearest to (u, v) in the Frobenius norm. The two summands never cancel: their dot product is
// |u x v|.
Pair polarPair(const Vec3& u, const Vec3& v, const Vec3& n_bar) {
  const double largest =
      std::max({std::fabs(u.x), std::fabs(u.y), std::fabs(u.z), std::fabs(v.x), std::fabs(v.y), std::fabs(v.z)});
  const int exponent = -std::ilogb(largest);
  const auto scaled = [exponent](const Vec3& a) {
    return Vec3{std::scalbn(a.x, exponent), std::scalbn(a.y, exponent), std::scalbn(a.z, exponent)};
  };
  const Vec3 sum = scaled(u) + cross(scaled(v), n_bar);
  const Vec3 u_bar = sum / std::sqrt(dot(sum, sum));
  return {u_bar, cross(n_bar, u_bar)};
}

}  // namespace

Orthogonal<AcquisitionSpace, TangentSpace> rotationFromRodrigues(const Vec3& r0) {
  // The quaternion (1, r0) divided by its largest component: no square overflows.
  const double largest = std::max({1.0, std::fabs(r0.x), std::fabs(r0.y), std::fabs(r0.z)});
  return Orthogonal<AcquisitionSpace, TangentSpace>(
      rotationFromQuaternion({1 / largest, r0.x / largest, r0.y / largest, r0.z / largest}));  // Eq. 5
}

Vec3 rodriguesFromRotation(const Orthogonal<AcquisitionSpace, TangentSpace>& acquisition_from_tangent) {
  const Quaternion q = quaternionFromRotation(acquisition_from_tangent.raw());
  return Vec3{q.x, q.y, q.z} / std::max(q.w, kLeastScalarPart);  // Eq. 5, M7
}

Orthogonal<AcquisitionSpace, TangentSpace> restFrame(const Direction<AcquisitionSpace>& normal,
                                                     const Direction<AcquisitionSpace>& tangent) {
  const Vec3 n0 = normal.raw();
  Vec3 v0 = cross(n0, tangent.raw());
  if (!(dot(v0, v0) > kParallelSine * kParallelSine)) v0 = cross(n0, anyPerpendicular(normal).raw());
  v0 = v0 / std::sqrt(dot(v0, v0));
  return Orthogonal<AcquisitionSpace, TangentSpace>(Mat3::fromColumns(cross(v0, n0), v0, n0));
}

Orthogonal<AcquisitionSpace, TangentSpace> restFrame(const Direction<AcquisitionSpace>& normal) {
  return restFrame(normal, anyPerpendicular(normal));
}

template <class Space>
TangentChange tangentChange(const Tangents<Space>& tangents) {
  // Singular values of the matrix (u v); the lesser one from the area, which keeps its digits.
  const Vec3 &u = tangents.u.raw(), &v = tangents.v.raw();
  const double uu = dot(u, u), vv = dot(v, v), uv = dot(u, v);
  TangentChange change;
  change.longest = std::sqrt(0.5 * (uu + vv) + std::hypot(0.5 * (uu - vv), uv));
  change.shortest = change.longest > 0 ? length(cross(u, v)) / change.longest : 0;
  change.shear = std::atan2(uv, length(cross(u, v)));
  return change;
}
template TangentChange tangentChange(const Tangents<ObjectSpace>&);

template <class Space>
DeformedFrame<Space> deformedFrame(const Tangents<Space>& tangents, FrameMode mode,
                                   const Orthogonal<TangentSpace, Space>& at_rest) {
  // sigma turns the normal last: turning it first would swap u-bar and v-bar (M11).
  const double sigma = tangents.handedness < 0 ? -1 : 1;
  const Vec3 &u = tangents.u.raw(), &v = tangents.v.raw();
  const auto u_hat = unitAlong(u), v_hat = unitAlong(v);
  if (u_hat && v_hat) {
    const Vec3 normal = cross(*u_hat, *v_hat);
    const double sine = std::sqrt(dot(normal, normal));
    if (sine > kCollapsedSine) {
      const Vec3 n_bar = normal / sine;  // Eq. 7
      const Pair pair = mode == FrameMode::bisector ? bisectorPair(*u_hat, *v_hat, n_bar) : polarPair(u, v, n_bar);
      return {Orthogonal<TangentSpace, Space>(Mat3{{pair.u, pair.v, sigma * n_bar}}), false};
    }
  }
  Mat3 rows = at_rest.raw();
  if (u_hat || v_hat) {
    // All tangents were carried onto the line along d; the one that kept most of its length is a u0 + b v0.
    const bool by_u = u_hat && !(v_hat && length(v) > length(u));
    const Vec3 d = by_u ? *u_hat : *v_hat;
    const double other = by_u ? (v_hat ? dot(v / length(u), d) : 0) : (u_hat ? dot(u / length(v), d) : 0);
    const double norm = std::hypot(1, other), a = (by_u ? 1 : other) / norm, b = (by_u ? other : 1) / norm;
    const Vec3 kept = a * rows.row[0] + b * rows.row[1];
    // The shortest turn that takes it there; through a perpendicular axis where it is a half turn.
    const Vec3 across = cross(kept, d);
    const Vec3 axis = dot(across, across) > 0 ? across / length(across) : perpendicularTo(d);
    const Mat3 turn = rotationAbout(axis, std::atan2(length(across), dot(kept, d)));
    for (Vec3& row : rows.row) row = turn * row;
  }
  rows.row[2] = sigma * rows.row[2];
  return {Orthogonal<TangentSpace, Space>(rows), true};
}

template DeformedFrame<ObjectSpace> deformedFrame(const Tangents<ObjectSpace>&, FrameMode,
                                                  const Orthogonal<TangentSpace, ObjectSpace>&);
template DeformedFrame<AcquisitionSpace> deformedFrame(const Tangents<AcquisitionSpace>&, FrameMode,
                                                       const Orthogonal<TangentSpace, AcquisitionSpace>&);

}  // namespace srf
