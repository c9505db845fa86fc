// Surfaces from elsewhere (M5): meshes, point clouds (laser range data), parametric shapes. shape_import.cpp alone
// includes CGAL.
#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "base/mesh.h"
#include "base/mesh_io.h"
#include "base/reporter.h"

namespace srf {

struct ImportedShape {
  AcquisitionMesh mesh;
  double positional_error = 0;  ///< how far the surface may be off, units
};

/// "sphere", "box", "cylinder", "plane", "torus" fitted into `bounds` (the object's box, e.g. of the hull; the axis of
/// cylinder and torus is the box's odd one out, else z), finely tessellated with exact normals. Nothing for another
/// name.
std::optional<ImportedShape> parametricShape(const std::string& name, const Box<AcquisitionSpace>& bounds,
                                             Reporter& reporter);
/// Reads a PLY/OBJ. With faces: cleaned, oriented outwards, holes reported. Without: a point cloud becomes a surface
/// (normals estimated and oriented where absent, outliers dropped, Poisson reconstruction). A folder: its PLY files are
/// range views of one object (claim 6), see importRangeViews.
ImportedShape importShape(const std::filesystem::path& file, Reporter& reporter);
/// The same for a mesh that was read already; `name` stands for the file in messages.
ImportedShape importShape(AcquisitionMesh mesh, const std::string& name, Reporter& reporter);
/// Points that a scanner saw from several places, in one space, become one surface: outliers go, normals are found and
/// face the sensor that saw the point, then as above. Views without a sensor are oriented by their neighbours.
ImportedShape importRangeViews(const std::vector<RangeView>& views, const std::string& name, Reporter& reporter);

}  // namespace srf
