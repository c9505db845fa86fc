// A mesh that moves vertex by vertex: by a mesh for each frame, or by a glTF skin (skinning.h); and what that does to
// tangents on it (M8): deformation gradients, and where it is mirrored.
#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "base/mesh.h"
#include "base/transform.h"

namespace srf {

/// The vertices of a rest mesh at one frame.
struct MovedVertices {
  std::vector<Point<ObjectSpace>> positions;
  /// Of each vertex, -1 where the motion mirrors; empty: nobody knows, the volumes of closed parts tell.
  std::vector<std::int8_t> handedness;
};

/// What moves the vertices of a rest mesh over the frames, before the maps of space. Immutable and thread-safe.
class VertexMotion {
 public:
  virtual ~VertexMotion() = default;
  /// Throws bad_input that names file, frame and vertex where the frame does not fit the rest mesh.
  virtual MovedVertices at(double frame) const = 0;
};

/// One PLY or OBJ mesh a frame (the last run of # in the pattern's file name is the frame) with the topology of `rest`;
/// between whole frames the vertices move straight. `where` names the pattern's place in errors of missing files.
std::unique_ptr<const VertexMotion> sequenceMotion(const std::string& pattern, const AcquisitionMesh& rest,
                                                   const std::string& where);

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
  std::vector<std::int8_t> handedness;  ///< of each vertex: as given, or -1 where its closed part was turned inside out
  std::size_t unsure = 0;               ///< vertices of open parts, whose handedness cannot be told and is taken as +1
};
MeshMotion meshMotion(const AcquisitionMesh& rest, const MeshParts& parts, const MovedVertices& moved);

}  // namespace srf
