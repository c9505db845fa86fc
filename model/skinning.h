// A glTF mesh drives the model (deformation `skin`): linear-blend skinning, morph targets and moving nodes
// (gltf_pose.h) carried to the vertices of the model's rest mesh. Either each of them is a vertex of the glTF's mesh,
// or the glTF's mesh is a coarse proxy whose motion is spread over the model.
#pragma once

#include <memory>
#include <string>

#include "base/reporter.h"
#include "model/gltf_file.h"
#include "model/mesh_motion.h"

namespace srf {

/// What an entry of the scene names.
struct SkinSource {
  std::shared_ptr<const Gltf> gltf;
  int node = 0;                              ///< that carries the mesh
  const GltfAnimation* animation = nullptr;  ///< null: as the file stands
  bool proxy = false;
  bool loop = false;  ///< the animation repeats, from its last key on with its first
  std::string where;  ///< what errors name
};

/// Without `proxy`, the vertices of `rest` are found in the glTF's mesh, in this order: by `_SRF_INDEX`; by the second
/// texture coordinate, where its u counts the vertices of `rest`; by the place of the vertex (as the file stands or as
/// its mesh is bound), in the same order where there are as many. Throws bad_input naming the vertex that has no
/// partner and what was found instead.
///
/// With `proxy`, a point x of `rest` goes to the mean of q_k' + F_k (x - q_k) over the nearest vertices q_k of the
/// glTF's mesh, F_k their deformation gradients: smooth weights that fall to 0 at the next vertex further off, and
/// where the proxy faces another way.
///
/// `at` throws where copies of one vertex (a seam that the exporter split) move apart.
std::unique_ptr<const VertexMotion> skinMotion(const SkinSource& source, const AcquisitionMesh& rest, double fps,
                                               Reporter& reporter);

}  // namespace srf
