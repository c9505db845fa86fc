// What a carved hull holds beside the object: dust, and pieces that the silhouettes do not need.
#pragma once

#include <span>

#include "base/camera.h"
#include "base/mesh.h"
#include "base/reporter.h"

namespace srf {

/// Takes components away from a hull's mesh: dust, below a millionth of the volume, and phantoms. A phantom is a piece
/// of at most a twentieth of the volume that lies before or behind the rest in every picture (to a sample of 256 along
/// the longer side), so that the silhouettes are the same without it: cones of few views meet beside the object too.
/// Seen by fewer than two pictures a piece stays. Counts `hull.dust` and `hull.phantoms`.
void dropUnneededComponents(AcquisitionMesh& mesh, std::span<const Camera<AcquisitionSpace>> cameras,
                            Reporter& reporter);

}  // namespace srf
