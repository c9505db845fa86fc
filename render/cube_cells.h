// The directions of space cut into the cells of a cube's faces.
#pragma once

#include <algorithm>
#include <cmath>

#include "base/vec.h"

namespace srf {

struct CubeCell {
  int face, x, y;
  /// Position in an array of all cells.
  std::size_t index(int resolution) const { return (static_cast<std::size_t>(face) * resolution + y) * resolution + x; }
};

/// The cell of a direction of any length above 0, on faces of resolution x resolution cells.
inline CubeCell cubeCell(const Vec3& d, int resolution) {
  const double ax = std::fabs(d.x), ay = std::fabs(d.y), az = std::fabs(d.z);
  const double half = 0.5 * resolution;
  const auto cell = [&](int axis, double major, double s, double t) {
    const double scale = half / std::fabs(major);
    const auto index = [&](double x) { return std::clamp(static_cast<int>(x * scale + half), 0, resolution - 1); };
    return CubeCell{2 * axis + (major < 0 ? 1 : 0), index(s), index(t)};
  };
  if (ax >= ay && ax >= az) return cell(0, d.x, d.y, d.z);
  if (ay >= az) return cell(1, d.y, d.z, d.x);
  return cell(2, d.z, d.x, d.y);
}

/// Unit vector at face coordinates (s, t) in [-1, 1].
inline Vec3 cubeDirection(int face, double s, double t) {
  const int axis = face / 2;
  Vec3 d;
  d[axis] = face % 2 ? -1 : 1;
  d[(axis + 1) % 3] = s;
  d[(axis + 2) % 3] = t;
  return d / length(d);
}

}  // namespace srf
