// What a mesh that moves vertex by vertex does to tangents on it (M8): deformation gradients, and where it is mirrored.
#pragma once

#include <cstdint>
#include <vector>

#include "base/mesh.h"
#include "base/transform.h"

namespace srf {

/// The connected parts of a rest mesh.
struct MeshParts {
  std::vector<std::uint32_t> part_of_vertex;
  std::vector<std::uint8_t> closed;  ///< of each part: every edge has two triangles, so that it has a volume
  std::vector<double> volume;        ///< of each part at rest, signed, units^3 about its centroid
};
MeshParts meshParts(const AcquisitionMesh& rest);

struct MeshMotion {
  std::vector<Linear<ObjectSpace, AcquisitionSpace>>
      gradient;                         ///< of each vertex: its triangles' weighted by rest area
  std::vector<std::int8_t> handedness;  ///< of each vertex: -1 where its closed part was turned inside out, else +1
  std::size_t unsure = 0;               ///< vertices of open parts, whose handedness cannot be told and is taken as +1
};
/// `moved`: the vertices of `rest`, moved.
MeshMotion meshMotion(const AcquisitionMesh& rest, const MeshParts& parts,
                      const std::vector<Point<ObjectSpace>>& moved);

}  // namespace srf
