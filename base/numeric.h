// Angles and small formulas that keep their digits.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <numbers>
#include <vector>

#include "base/space.h"

namespace srf {

inline constexpr double kPi = std::numbers::pi;
constexpr double degrees(double radians) {
  return radians * (180.0 / kPi);
}
constexpr double radians(double degrees) {
  return degrees * (kPi / 180.0);
}
constexpr double square(double x) {
  return x * x;
}
constexpr double lerp(double a, double b, double t) {
  return a + t * (b - a);
}
/// 0 at or below `edge0`, 1 at or above `edge1`, a cubic with flat ends in between.
constexpr double smoothstep(double edge0, double edge1, double x) {
  const double t = std::clamp((x - edge0) / (edge1 - edge0), 0.0, 1.0);
  return t * t * (3 - 2 * t);
}

/// The middle one by size, of two the larger; 0 where there is none.
inline double median(std::vector<double> values) {
  if (values.empty()) return 0;
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

/// Angle in radians between unit vectors by their chord. acos(dot) is off by 15 % at 1e-3 rad in float and may
/// be NaN; this form is accurate to a few ulp from 0 to pi.
inline double angleBetweenUnit(const Vec3& a, const Vec3& b) {
  if (dot(a, b) < 0) return kPi - 2 * std::asin(std::min(1.0, 0.5 * length(a + b)));
  return 2 * std::asin(std::min(1.0, 0.5 * length(a - b)));
}
template <class Space>
double angleBetween(const Direction<Space>& a, const Direction<Space>& b) {
  return angleBetweenUnit(a.raw(), b.raw());
}

/// A unit vector perpendicular to `n`: cross(z, n), or cross(x, n) where |n.z| >= 0.9. The free choice of u0.
template <class Space>
Direction<Space> anyPerpendicular(const Direction<Space>& n) {
  const Vec3 axis = std::fabs(n.raw().z) < 0.9 ? Vec3{0, 0, 1} : Vec3{1, 0, 0};
  return *normalize(Vector<Space>(cross(axis, n.raw())));
}

}  // namespace srf
