// A glTF at one time: where its nodes are, and where that puts a mesh's vertices (linear-blend skinning and morph
// targets; glTF 2.0 specification 3.7, 3.11 and appendix C). In double, in the file's space.
#pragma once

#include "model/gltf_file.h"

namespace srf {

struct GltfPose {
  std::vector<AffineTransform> world;        ///< of each node
  std::vector<std::vector<double>> weights;  ///< of each node's morph targets
};
/// `animation` null: as the file stands. Before the first and after the last key a value holds.
GltfPose poseAt(const Gltf& gltf, const GltfAnimation* animation, double seconds);

struct PosedMesh {
  std::vector<Vec3> positions;
  /// Of each vertex: the sign of the determinant of the transform that moved it; morph targets count as none.
  std::vector<std::int8_t> handedness;
};
/// The vertices of the mesh at `node` (which has one).
PosedMesh posedMesh(const Gltf& gltf, int node, const GltfPose& pose);

/// The file's mesh as it stands, turned to our axes: a shape to make a model of. Throws as readGltf and meshNode do.
AcquisitionMesh meshFromGltf(const std::filesystem::path& file);

}  // namespace srf
