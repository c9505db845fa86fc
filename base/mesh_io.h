// PLY (ascii and binary, any properties) and OBJ. Hostile files end in an Error, never in a crash.
#pragma once

#include <filesystem>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "base/mesh.h"

namespace srf {

/// Reads a PLY or OBJ mesh; polygons are fanned into triangles; normals are taken where the file has them. A file
/// without faces gives a mesh without triangles (a point cloud). Throws bad_input naming file and place.
AcquisitionMesh readMesh(const std::filesystem::path& file);

/// A laser scanner's points from one place.
struct RangeView {
  AcquisitionMesh points;                         ///< without triangles, where it is a range view
  std::optional<Point<AcquisitionSpace>> sensor;  ///< where the scanner stood, where the file tells
};
/// As readMesh, and a PLY's element "camera" with view_px, view_py, view_pz, as the Point Cloud Library writes it.
RangeView readRangeView(const std::filesystem::path& file);
/// Binary little-endian PLY of the points (double) and the sensor's place; written beside and renamed.
void writeRangeView(const std::filesystem::path& file, const RangeView& view);

/// Extra per-vertex columns of a PLY by property name, each as long as the vertices.
using PlyColumns = std::map<std::string, std::vector<float>>;
/// Binary little-endian PLY, double positions, float normals when present; written beside and renamed.
void writePly(const std::filesystem::path& file, const AcquisitionMesh& mesh, const PlyColumns& extra = {});

}  // namespace srf
