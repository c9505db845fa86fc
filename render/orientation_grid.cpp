#include "render/orientation_grid.h"

#include <algorithm>
#include <cmath>

#include "base/numeric.h"

namespace srf {
namespace {

constexpr int kBits = 20;  // of a coordinate in a key, offset by half the range
constexpr std::int32_t kOffset = 1 << (kBits - 1);

std::uint64_t pack(int face, bool reflected, const std::array<std::int32_t, 3>& at) {
  std::uint64_t key = static_cast<std::uint64_t>(face) << 1 | (reflected ? 1 : 0);
  for (const std::int32_t c : at) key = key << kBits | static_cast<std::uint64_t>(c + kOffset);
  return key;
}

template <class Real>
std::array<int, 3> byFallingFraction(const std::array<Real, 3>& fraction) {
  std::array<int, 3> axis{0, 1, 2};
  if (fraction[axis[0]] < fraction[axis[1]]) std::swap(axis[0], axis[1]);
  if (fraction[axis[1]] < fraction[axis[2]]) std::swap(axis[1], axis[2]);
  if (fraction[axis[0]] < fraction[axis[1]]) std::swap(axis[0], axis[1]);
  return axis;
}

/// Of the corners along the axes.
template <class Real>
std::array<float, 4> sharesAlong(const std::array<int, 3>& axis, const std::array<Real, 3>& fraction) {
  std::array<float, 4> share;
  Real outer = 1;
  for (int i = 0; i < 4; ++i) {
    const Real next = i < 3 ? fraction[axis[i]] : 0;
    share[i] = static_cast<float>(outer - next);
    outer = next;
  }
  return share;
}

/// Kuhn's split: from the cell's inner corner outwards along the axes by falling fraction.
template <class Real>
OrientationGrid::Blend alongAxes(int face, bool reflected, std::array<std::int32_t, 3> at,
                                 const std::array<std::int32_t, 3>& step, const std::array<Real, 3>& fraction) {
  const std::array<int, 3> axis = byFallingFraction(fraction);
  OrientationGrid::Blend result;
  result.share = sharesAlong(axis, fraction);
  for (int i = 0; i < 4; ++i) {
    result.corner[i] = pack(face, reflected, at);
    if (i < 3) at[axis[i]] += step[axis[i]];
  }
  return result;
}

}  // namespace

OrientationGrid::OrientationGrid(double degrees) {
  // Along an edge of a cell the rotation angle grows by (pi / 2) / half_cells_ at most (twice the quaternion's angle);
  // a point of the cell is within half a diagonal of a corner.
  const double edge = radians(degrees) * 2 / std::sqrt(3.0);
  half_cells_ = static_cast<std::int32_t>(std::clamp(std::ceil(kPi / 2 / edge), 1.0, kOffset - 1.0));
}

OrientationGrid::Blend OrientationGrid::blend(const Orthogonal<AcquisitionSpace, ObjectSpace>& m) const {
  const bool reflected = determinant(m) < 0;
  const Quaternion q = quaternionFromRotation(reflected ? -1.0 * m.raw() : m.raw());
  const std::array<double, 4> component{q.w, q.x, q.y, q.z};
  int face = 0;
  for (int i = 1; i < 4; ++i)
    if (std::fabs(component[i]) > std::fabs(component[face])) face = i;

  std::array<std::int32_t, 3> at;    // the cell's corner nearest to the middle of the cube
  std::array<std::int32_t, 3> step;  // outwards
  std::array<double, 3> fraction;    // of the way outwards
  for (int i = 0, j = 0; i < 4; ++i) {
    if (i == face) continue;
    const double x = std::atan(component[i] / component[face]) * (half_cells_ / (kPi / 4));
    const std::int32_t cell = std::min(static_cast<std::int32_t>(std::fabs(x)), half_cells_ - 1);
    step[j] = x < 0 ? -1 : 1;
    at[j] = step[j] * cell;
    fraction[j++] = std::min(std::fabs(x) - cell, 1.0);
  }
  return alongAxes(face, reflected, at, step, fraction);
}

OrientationGrid::Blend OrientationGrid::blend(const Place& place) const {
  std::array<std::int32_t, 3> at, step;
  for (int j = 0; j < 3; ++j) {
    step[j] = place.code >> j & 1 ? -1 : 1;
    at[j] = step[j] * place.cell[j];
  }
  return alongAxes(place.code >> 4, place.code >> 3 & 1, at, step, place.fraction);
}

std::array<float, 4> OrientationGrid::shares(const Place& place) {
  return sharesAlong(byFallingFraction(place.fraction), place.fraction);
}

int OrientationGrid::tetrahedron(const Place& place) {
  const std::array<int, 3> axis = byFallingFraction(place.fraction);
  return 3 * axis[0] + axis[1];
}

Orthogonal<AcquisitionSpace, ObjectSpace> OrientationGrid::orientation(std::uint64_t corner) const {
  std::array<std::int32_t, 3> at;
  for (int j = 2; j >= 0; --j) {
    at[j] = static_cast<std::int32_t>(corner & ((1u << kBits) - 1)) - kOffset;
    corner >>= kBits;
  }
  const bool reflected = corner & 1;
  const int face = static_cast<int>(corner >> 1);
  std::array<double, 4> component;
  double norm2 = 1;
  for (int i = 0, j = 0; i < 4; ++i) {
    if (i == face) {
      component[i] = 1;
      continue;
    }
    component[i] = std::tan(at[j++] * (kPi / 4) / half_cells_);
    norm2 += square(component[i]);
  }
  for (double& c : component) c /= std::sqrt(norm2);
  const Mat3 rotation = rotationFromQuaternion({component[0], component[1], component[2], component[3]});
  return Orthogonal<AcquisitionSpace, ObjectSpace>(reflected ? -1.0 * rotation : rotation);
}

}  // namespace srf
