// Plain triples and 3x3 matrices of doubles, without a space. Code outside base/ works with the typed values of
// space.h and transform.h; these are what `.raw()` hands to adapters (Embree, OpenCV, CGAL).
#pragma once

#include <array>
#include <cmath>

namespace srf {

struct Vec2 {
  double x = 0, y = 0;
  friend constexpr bool operator==(const Vec2&, const Vec2&) = default;
};

struct Vec3 {
  double x = 0, y = 0, z = 0;

  constexpr double operator[](int i) const { return i == 0 ? x : i == 1 ? y : z; }
  constexpr double& operator[](int i) { return i == 0 ? x : i == 1 ? y : z; }
  friend constexpr bool operator==(const Vec3&, const Vec3&) = default;

  constexpr Vec3& operator+=(const Vec3& b) { return *this = {x + b.x, y + b.y, z + b.z}; }
  constexpr Vec3& operator-=(const Vec3& b) { return *this = {x - b.x, y - b.y, z - b.z}; }
  constexpr Vec3& operator*=(double s) { return *this = {x * s, y * s, z * s}; }
};

constexpr Vec3 operator+(Vec3 a, const Vec3& b) {
  return a += b;
}
constexpr Vec3 operator-(Vec3 a, const Vec3& b) {
  return a -= b;
}
constexpr Vec3 operator-(const Vec3& a) {
  return {-a.x, -a.y, -a.z};
}
constexpr Vec3 operator*(Vec3 a, double s) {
  return a *= s;
}
constexpr Vec3 operator*(double s, Vec3 a) {
  return a *= s;
}
constexpr Vec3 operator/(const Vec3& a, double s) {
  return {a.x / s, a.y / s, a.z / s};
}
/// As files, kernels and pictures hold them.
constexpr std::array<float, 3> floats(const Vec3& a) {
  return {static_cast<float>(a.x), static_cast<float>(a.y), static_cast<float>(a.z)};
}
/// Component by component: products of colours.
constexpr Vec3 operator*(const Vec3& a, const Vec3& b) {
  return {a.x * b.x, a.y * b.y, a.z * b.z};
}
constexpr Vec3 operator/(const Vec3& a, const Vec3& b) {
  return {a.x / b.x, a.y / b.y, a.z / b.z};
}

constexpr double dot(const Vec3& a, const Vec3& b) {
  return a.x * b.x + a.y * b.y + a.z * b.z;
}

/// a b - c d with an error of at most 1.5 ulp (Kahan): the plain difference loses every digit when the products agree.
inline double differenceOfProducts(double a, double b, double c, double d) {
  const double cd = c * d;
  const double error = std::fma(-c, d, cd);
  return std::fma(a, b, -cd) + error;
}

inline Vec3 cross(const Vec3& a, const Vec3& b) {
  return {differenceOfProducts(a.y, b.z, a.z, b.y), differenceOfProducts(a.z, b.x, a.x, b.z),
          differenceOfProducts(a.x, b.y, a.y, b.x)};
}

/// Euclidean length, without overflow or underflow of the squares: the plain root where they are far from either.
inline double length(const Vec3& a) {
  const double squared = dot(a, a);
  return squared > 1e-250 && squared < 1e250 ? std::sqrt(squared) : std::hypot(a.x, a.y, a.z);
}
inline bool isFinite(const Vec3& a) {
  return std::isfinite(a.x) && std::isfinite(a.y) && std::isfinite(a.z);
}
constexpr double maxComponent(const Vec3& a) {
  return a.x > a.y ? (a.x > a.z ? a.x : a.z) : (a.y > a.z ? a.y : a.z);
}
constexpr double minComponent(const Vec3& a) {
  return a.x < a.y ? (a.x < a.z ? a.x : a.z) : (a.y < a.z ? a.y : a.z);
}

/// Row-major 3x3 matrix acting on column vectors.
struct Mat3 {
  std::array<Vec3, 3> row{Vec3{1, 0, 0}, Vec3{0, 1, 0}, Vec3{0, 0, 1}};

  static constexpr Mat3 fromColumns(const Vec3& a, const Vec3& b, const Vec3& c) {
    return {{Vec3{a.x, b.x, c.x}, Vec3{a.y, b.y, c.y}, Vec3{a.z, b.z, c.z}}};
  }
  constexpr Vec3 column(int i) const { return {row[0][i], row[1][i], row[2][i]}; }
  constexpr Mat3 transposed() const { return {{column(0), column(1), column(2)}}; }
  friend constexpr bool operator==(const Mat3&, const Mat3&) = default;
};

constexpr Vec3 operator*(const Mat3& m, const Vec3& a) {
  return {dot(m.row[0], a), dot(m.row[1], a), dot(m.row[2], a)};
}
constexpr Mat3 operator*(const Mat3& a, const Mat3& b) {
  return Mat3::fromColumns(a * b.column(0), a * b.column(1), a * b.column(2));
}
constexpr Mat3 operator*(double s, const Mat3& m) {
  return {{s * m.row[0], s * m.row[1], s * m.row[2]}};
}
constexpr Mat3 operator+(const Mat3& a, const Mat3& b) {
  return {{a.row[0] + b.row[0], a.row[1] + b.row[1], a.row[2] + b.row[2]}};
}
inline double determinant(const Mat3& m) {
  return dot(m.row[0], cross(m.row[1], m.row[2]));
}
/// Inverse by cofactors; entries are not finite where the determinant is 0.
inline Mat3 inverse(const Mat3& m) {
  const Vec3 a = cross(m.row[1], m.row[2]), b = cross(m.row[2], m.row[0]), c = cross(m.row[0], m.row[1]);
  return (1.0 / dot(m.row[0], a)) * Mat3::fromColumns(a, b, c);
}
/// The matrix of x -> a cross x.
constexpr Mat3 crossMatrix(const Vec3& a) {
  return {{Vec3{0, -a.z, a.y}, Vec3{a.z, 0, -a.x}, Vec3{-a.y, a.x, 0}}};
}
/// Right-handed rotation about the unit vector `axis` by `angle` radians.
inline Mat3 rotationAbout(const Vec3& axis, double angle) {
  const Mat3 k = crossMatrix(axis);
  return Mat3{} + std::sin(angle) * k + (1 - std::cos(angle)) * (k * k);
}

}  // namespace srf
