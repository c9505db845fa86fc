// Surfels as a point cloud for other programs.
#pragma once

#include <filesystem>

#include "model/deformable_model.h"

namespace srf {

/// A PLY of the surfels at rest, in acquisition space: x y z (double), nx ny nz and radius (float), the names by which
/// MeshLab and CloudCompare know them. Appears when whole. Throws usage where the model is of triangles, or the name
/// does not end in .ply.
void writeSurfels(const std::filesystem::path& file, const DeformableModel& model);

}  // namespace srf
