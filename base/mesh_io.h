// PLY (ascii and binary, any properties) and OBJ. Hostile files end in an Error, never in a crash.
#pragma once

#include <filesystem>
#include <map>
#include <string>
#include <vector>

#include "base/mesh.h"

namespace srf {

/// Reads a PLY or OBJ mesh; polygons are fanned into triangles; normals are taken where the file has them. A file
/// without faces gives a mesh without triangles (a point cloud). Throws bad_input naming file and place.
AcquisitionMesh readMesh(const std::filesystem::path& file);

/// Extra per-vertex columns of a PLY by property name, each as long as the vertices.
using PlyColumns = std::map<std::string, std::vector<float>>;
/// Binary little-endian PLY, double positions, float normals when present; written beside and renamed.
void writePly(const std::filesystem::path& file, const AcquisitionMesh& mesh, const PlyColumns& extra = {});

}  // namespace srf
