// Triangle meshes and what can be asked of them.
#pragma once

#include <array>
#include <cstdint>
#include <filesystem>
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

/// A mesh whose space is not stated in the file; readers of capture data name it.
using AcquisitionMesh = TriangleMesh<AcquisitionSpace>;

/// Vertex normals weighted by the corner angles (Thuermer and Wuethrich 1998); a vertex without area gets +z.
std::vector<Direction<AcquisitionSpace>> vertexNormals(const AcquisitionMesh& mesh);

/// What the connectivity says.
struct MeshTopology {
  bool closed = false;            ///< every edge has two triangles
  bool manifold = false;          ///< edges have at most two triangles, one fan a vertex
  bool oriented = false;          ///< neighbours agree on the winding
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

/// Counts of what cleanMesh removed or mended.
struct MeshRepair {
  std::size_t not_finite = 0, degenerate = 0, duplicate = 0, unused_vertices = 0;
};
/// Drops triangles that are not finite, of zero area or repeated, and vertices that nothing uses.
MeshRepair cleanMesh(AcquisitionMesh& mesh);

}  // namespace srf
