// Points, vectors and directions that know the space they live in. The spaces coincide in the rest pose, so a
// mix-up would pass every undeformed test; here it does not compile.
#pragma once

#include <optional>

#include "base/vec.h"

namespace srf {

struct AcquisitionSpace;  ///< the world of the capture: p0, l, v, u0, v0, n0, R0
struct ObjectSpace;       ///< the world of the rendered scene: p*, l*, v*, u, v
struct TangentSpace;      ///< coordinates along a local frame (u, v, n)
struct CameraSpace;       ///< x right, y down, z forward (COLMAP's and OpenCV's), origin at the centre of projection

template <class Space>
class Vector {
 public:
  constexpr Vector() = default;
  constexpr explicit Vector(const Vec3& raw) : raw_(raw) {}
  constexpr Vector(double x, double y, double z) : raw_{x, y, z} {}
  constexpr const Vec3& raw() const { return raw_; }

  constexpr Vector& operator+=(const Vector& b) {
    raw_ += b.raw_;
    return *this;
  }
  constexpr Vector& operator-=(const Vector& b) {
    raw_ -= b.raw_;
    return *this;
  }
  constexpr Vector& operator*=(double s) {
    raw_ *= s;
    return *this;
  }
  friend constexpr Vector operator+(Vector a, const Vector& b) { return a += b; }
  friend constexpr Vector operator-(Vector a, const Vector& b) { return a -= b; }
  friend constexpr Vector operator-(const Vector& a) { return Vector(-a.raw_); }
  friend constexpr Vector operator*(double s, Vector a) { return a *= s; }
  friend constexpr Vector operator*(Vector a, double s) { return a *= s; }
  friend constexpr Vector operator/(const Vector& a, double s) { return Vector(a.raw_ / s); }
  friend constexpr bool operator==(const Vector&, const Vector&) = default;
  friend constexpr double dot(const Vector& a, const Vector& b) { return srf::dot(a.raw_, b.raw_); }
  friend Vector cross(const Vector& a, const Vector& b) { return Vector(srf::cross(a.raw_, b.raw_)); }
  friend double length(const Vector& a) { return srf::length(a.raw_); }
  friend bool isFinite(const Vector& a) { return srf::isFinite(a.raw_); }

 private:
  Vec3 raw_;
};

/// A unit vector. As a light or viewing direction it points away from the surface.
template <class Space>
class Direction {
 public:
  constexpr Direction() : raw_{0, 0, 1} {}
  /// For values known to have length 1 (to rounding); everything else goes through normalize.
  static constexpr Direction fromUnit(const Vec3& unit) {
    Direction d;
    d.raw_ = unit;
    return d;
  }
  constexpr const Vec3& raw() const { return raw_; }
  constexpr operator Vector<Space>() const { return Vector<Space>(raw_); }  // NOLINT(google-explicit-constructor)
  constexpr Direction operator-() const { return fromUnit(-raw_); }
  friend constexpr bool operator==(const Direction&, const Direction&) = default;
  friend constexpr double dot(const Direction& a, const Direction& b) { return srf::dot(a.raw_, b.raw_); }
  friend constexpr double dot(const Direction& a, const Vector<Space>& b) { return srf::dot(a.raw_, b.raw()); }
  friend constexpr double dot(const Vector<Space>& a, const Direction& b) { return srf::dot(a.raw(), b.raw_); }
  friend Vector<Space> cross(const Direction& a, const Direction& b) {
    return Vector<Space>(srf::cross(a.raw_, b.raw_));
  }
  friend Vector<Space> cross(const Direction& a, const Vector<Space>& b) {
    return Vector<Space>(srf::cross(a.raw_, b.raw()));
  }
  friend Vector<Space> cross(const Vector<Space>& a, const Direction& b) {
    return Vector<Space>(srf::cross(a.raw(), b.raw_));
  }
  friend constexpr Vector<Space> operator*(double s, const Direction& a) { return Vector<Space>(s * a.raw_); }

 private:
  Vec3 raw_;
};

template <class Space>
class Point {
 public:
  constexpr Point() = default;
  constexpr explicit Point(const Vec3& raw) : raw_(raw) {}
  constexpr Point(double x, double y, double z) : raw_{x, y, z} {}
  constexpr const Vec3& raw() const { return raw_; }

  friend constexpr Point operator+(const Point& p, const Vector<Space>& d) { return Point(p.raw_ + d.raw()); }
  friend constexpr Point operator-(const Point& p, const Vector<Space>& d) { return Point(p.raw_ - d.raw()); }
  friend constexpr Vector<Space> operator-(const Point& a, const Point& b) { return Vector<Space>(a.raw_ - b.raw_); }
  friend constexpr bool operator==(const Point&, const Point&) = default;
  friend double distance(const Point& a, const Point& b) { return srf::length(a.raw_ - b.raw_); }
  friend bool isFinite(const Point& a) { return srf::isFinite(a.raw_); }

 private:
  Vec3 raw_;
};

/// The direction of `a`, or nothing where `a` is zero or not finite. Safe for lengths from 1e-300 to 1e300.
template <class Space>
std::optional<Direction<Space>> normalize(const Vector<Space>& a) {
  const double len = length(a);
  if (!(len > 0) || !std::isfinite(len)) return std::nullopt;
  Vec3 unit = a.raw() / len;
  if (len < 1e-290) unit = (a.raw() * 1e290) / (len * 1e290);
  return Direction<Space>::fromUnit(unit);
}

/// Axis-aligned box; empty until something is put into it.
template <class Space>
struct Box {
  Vec3 min{INFINITY, INFINITY, INFINITY}, max{-INFINITY, -INFINITY, -INFINITY};

  void extend(const Point<Space>& p) {
    for (int i = 0; i < 3; ++i) {
      min[i] = std::fmin(min[i], p.raw()[i]);
      max[i] = std::fmax(max[i], p.raw()[i]);
    }
  }
  bool empty() const { return !(min.x <= max.x && min.y <= max.y && min.z <= max.z); }
  Point<Space> center() const { return Point<Space>(0.5 * (min + max)); }
  /// Length of the diagonal: the object's diameter in every tolerance of the project.
  double diameter() const { return empty() ? 0.0 : length(max - min); }
};

}  // namespace srf
