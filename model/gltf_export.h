// The rest mesh of a model as a file for other programs, to be rigged and animated there and to come back as a glTF.
#pragma once

#include <filesystem>

#include "base/mesh.h"

namespace srf {

/// .glb: glTF 2.0, +y up, float positions and normals, and the number of each vertex twice over, as the attribute
/// `_SRF_INDEX` and as u of the second texture coordinate: one of them survives every program we know, also where it
/// splits vertices. .ply: our own axes, double positions, property `_SRF_INDEX`. Appears when whole. Throws usage for
/// another suffix, and for a .glb of more vertices than a float counts (2^24).
void exportRestMesh(const AcquisitionMesh& rest, const std::filesystem::path& file);

}  // namespace srf
