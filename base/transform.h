// Maps between spaces. Names and types read right to left: object_from_camera is Orthogonal<ObjectSpace, CameraSpace>.
#pragma once

#include "base/space.h"

namespace srf {

/// A linear map, e.g. the Jacobian of a deformation.
template <class To, class From>
class Linear {
 public:
  constexpr Linear() = default;
  constexpr explicit Linear(const Mat3& raw) : raw_(raw) {}
  constexpr const Mat3& raw() const { return raw_; }
  friend constexpr Vector<To> operator*(const Linear& m, const Vector<From>& a) { return Vector<To>(m.raw_ * a.raw()); }
  friend double determinant(const Linear& m) { return srf::determinant(m.raw_); }

 private:
  Mat3 raw_;
};
template <class To, class Mid, class From>
constexpr Linear<To, From> operator*(const Linear<To, Mid>& a, const Linear<Mid, From>& b) {
  return Linear<To, From>(a.raw() * b.raw());
}

/// A rotation or, with determinant -1, a reflection: keeps lengths and angles.
template <class To, class From>
class Orthogonal {
 public:
  constexpr Orthogonal() = default;
  /// `raw` must be orthonormal to rounding; rows are the axes of To in From's coordinates.
  constexpr explicit Orthogonal(const Mat3& raw) : raw_(raw) {}
  constexpr const Mat3& raw() const { return raw_; }
  constexpr Orthogonal<From, To> inverse() const { return Orthogonal<From, To>(raw_.transposed()); }
  friend constexpr Vector<To> operator*(const Orthogonal& m, const Vector<From>& a) {
    return Vector<To>(m.raw_ * a.raw());
  }
  friend constexpr Direction<To> operator*(const Orthogonal& m, const Direction<From>& a) {
    return Direction<To>::fromUnit(m.raw_ * a.raw());
  }
  friend double determinant(const Orthogonal& m) { return srf::determinant(m.raw_); }

 private:
  Mat3 raw_;
};
template <class To, class Mid, class From>
constexpr Orthogonal<To, From> operator*(const Orthogonal<To, Mid>& a, const Orthogonal<Mid, From>& b) {
  return Orthogonal<To, From>(a.raw() * b.raw());
}

/// Rotation and translation: x_to = rotation * x_from + translation.
template <class To, class From>
class Rigid {
 public:
  constexpr Rigid() = default;
  constexpr Rigid(const Orthogonal<To, From>& rotation, const Point<To>& origin)
      : rotation_(rotation), origin_(origin) {}
  constexpr const Orthogonal<To, From>& rotation() const { return rotation_; }
  /// Where From's origin lies in To.
  constexpr const Point<To>& origin() const { return origin_; }
  friend constexpr Point<To> operator*(const Rigid& m, const Point<From>& p) {
    return m.origin_ + m.rotation_ * Vector<From>(p.raw());
  }
  friend constexpr Direction<To> operator*(const Rigid& m, const Direction<From>& d) { return m.rotation_ * d; }
  /// The inverse map, applied without forming R^T t: keeps its digits far from the origin.
  constexpr Point<From> inverseTimes(const Point<To>& p) const {
    return Point<From>((rotation_.inverse() * (p - origin_)).raw());
  }

 private:
  Orthogonal<To, From> rotation_;
  Point<To> origin_;
};

/// Unit quaternion (w, x, y, z), w >= 0.
struct Quaternion {
  double w = 1, x = 0, y = 0, z = 0;
};
/// Quaternion of a proper rotation matrix by Shepperd's largest-component method; accurate at every angle.
Quaternion quaternionFromRotation(const Mat3& rotation);
Mat3 rotationFromQuaternion(const Quaternion& q);

}  // namespace srf
