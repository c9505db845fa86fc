// Marching cubes over bricks of cells: closed and manifold by construction.
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <vector>

#include "base/mesh.h"

namespace srf {

inline constexpr int kBrick = 4;  ///< cells along the side of a brick
inline constexpr int kBrickCorners = (kBrick + 1) * (kBrick + 1) * (kBrick + 1);

/// Index of a corner of a brick, x fastest.
constexpr int brickCorner(int x, int y, int z) {
  return (z * (kBrick + 1) + y) * (kBrick + 1) + x;
}

/// One brick: which of its corners are inside, and the surface vertices on the lattice edges it owns (those that start
/// at one of its kBrick^3 lower corners).
struct IsoBrick {
  std::array<std::uint32_t, 3> place;      ///< in bricks
  std::array<std::uint64_t, 2> inside{};   ///< bit brickCorner(x, y, z)
  std::array<std::uint64_t, 3> crossed{};  ///< by axis of the edge: bit (z kBrick + y) kBrick + x of its lower corner
  std::uint32_t first_vertex = 0;          ///< of its vertices, ordered by axis, then by bit

  bool isInside(int corner) const { return inside[corner / 64] >> (corner % 64) & 1; }
};

/// Joins the bricks into one mesh. `vertices` are those of the bricks; vertices in the middle of large polygons are
/// added. Nothing where two bricks disagree about a corner that they share.
std::optional<AcquisitionMesh> joinIsoBricks(const std::vector<IsoBrick>& bricks,
                                             std::vector<Point<AcquisitionSpace>> vertices);

}  // namespace srf
