// A fixed grid over all orientations of L, for sharing what depends on L alone (M18, light_sharing). The grid does not
// depend on the frame, the pixels or their order.
//
// Unit quaternions up to sign are the surface of a 4-cube up to sign: four cubes of coordinates atan(q_j / q_a), a the
// largest component. A cube is split evenly and each cell into six tetrahedra that mirror in every coordinate, so that
// neighbouring cubes fit together and the blend is continuous everywhere.
#pragma once

#include <array>
#include <cstdint>

#include "base/transform.h"

namespace srf {

class OrientationGrid {
 public:
  /// Every orientation lies within `degrees` of a corner of the grid.
  explicit OrientationGrid(double degrees);

  /// L as a convex blend of the grid's corners: of a function f of orientations, f(L) ~ sum share[i] f(corner[i]).
  struct Blend {
    std::array<std::uint64_t, 4> corner;  ///< keys for orientation(); those with share 0 are not meant to be used
    std::array<float, 4> share;
  };
  Blend blend(const Orthogonal<AcquisitionSpace, ObjectSpace>& acquisition_from_object) const;
  /// Where an orientation lies: its cell, as orientationCells finds them for many.
  struct Place {
    std::int32_t code;
    std::array<std::int32_t, 3> cell;
    std::array<float, 3> fraction;
  };
  Blend blend(const Place& place) const;
  /// Its shares alone.
  static std::array<float, 4> shares(const Place& place);
  /// The cell's tetrahedron that holds the place: an order of the three axes. Places of one tetrahedron have the same
  /// corners.
  static int tetrahedron(const Place& place);
  std::int32_t halfCells() const { return half_cells_; }
  /// The orientation at a corner; a reflection where the blended L is one.
  Orthogonal<AcquisitionSpace, ObjectSpace> orientation(std::uint64_t corner) const;

 private:
  std::int32_t half_cells_;  ///< cells from the middle of a cube to its side
};

}  // namespace srf
