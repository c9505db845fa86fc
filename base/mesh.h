// Triangle meshes and what can be asked of them.
#pragma once

#include <array>
#include <cstdint>
#include <filesystem>
#include <span>
#include <string>
#include <vector>

#include "base/space.h"

namespace srf {

using Triangle = std::array<std::uint32_t, 3>;  ///< counter-clockwise seen from outside

template <class Space>
struct TriangleMesh {
  std::vector<Point<Space>> positions;
  std::vector<Triangle> triangles;
  std::vector<Direction<Space>> normals;  ///< per vertex, unit, outward; empty where the source has none

  Box<Space> bounds() const {
    Box<Space> box;
    for (const auto& p : positions) box.extend(p);
    return box;
  }
};

/// The point of a triangle at barycentrics (1 - b1 - b2, b1, b2).
template <class Space>
Point<Space> pointOfTriangle(const std::vector<Point<Space>>& positions, const Triangle& triangle, double b1,
                             double b2) {
  const auto& [a, b, c] = triangle;
  return positions[a] + (b1 * (positions[b] - positions[a]) + b2 * (positions[c] - positions[a]));
}

/// A mesh whose space is not stated in the file; readers of capture data name it.
using AcquisitionMesh = TriangleMesh<AcquisitionSpace>;

/// The triangle corners at each vertex, by rising number; corner c is corner c % 3 of triangle c / 3.
class VertexCorners {
 public:
  explicit VertexCorners(const AcquisitionMesh& mesh);
  std::span<const std::uint32_t> at(std::size_t vertex) const {
    return std::span<const std::uint32_t>(corners_).subspan(first_[vertex], first_[vertex + 1] - first_[vertex]);
  }

 private:
  std::vector<std::uint32_t> first_, corners_;
};

/// Vertex normals weighted by the corner angles (Thuermer and Wuethrich 1998); a vertex without area gets +z.
std::vector<Direction<AcquisitionSpace>> vertexNormals(const AcquisitionMesh& mesh);

/// What the connectivity says.
struct MeshTopology {
  bool closed = false;    ///< every edge has two triangles
  bool manifold = false;  ///< edges have at most two triangles, one fan a vertex
  bool oriented = false;  ///< neighbours agree on the winding
  int components = 0;
  long euler_characteristic = 0;  ///< V - E + F of the used vertices; 2 - 2 genus for one closed component
};
MeshTopology meshTopology(const AcquisitionMesh& mesh);
/// Of each vertex the number of its connected component, from 0 in the order of first vertices; unused vertices are
/// components of their own.
std::vector<std::uint32_t> vertexComponents(const AcquisitionMesh& mesh);
/// Signed volume in units cubed; positive when the winding is outward.
double meshVolume(const AcquisitionMesh& mesh);
double meshArea(const AcquisitionMesh& mesh);

/// The mesh with its roughness taken off (Taubin 1995): each step draws the vertices towards the mean of their
/// neighbours and then pushes them back a little more, so that it neither shrinks nor loses long waves. No normals.
AcquisitionMesh smoothed(const AcquisitionMesh& mesh, int steps);

/// Counts of what cleanMesh removed or mended.
struct MeshRepair {
  std::size_t not_finite = 0, degenerate = 0, duplicate = 0, unused_vertices = 0;
};
/// Drops triangles that are not finite, of zero area or repeated, and vertices that nothing uses.
MeshRepair cleanMesh(AcquisitionMesh& mesh);

}  // namespace srf
