#include "apps/make_model.h"

#include <algorithm>
#include <vector>

#include "acquire/shape_import.h"
#include "base/error.h"
#include "base/json.h"
#include "base/mesh_io.h"
#include "model/gltf_pose.h"

namespace srf {
namespace {

AcquisitionMesh readHull(const std::filesystem::path& srf_folder, const SrfManifest& field) {
  const StoredFile* hull = field.shape("hull");
  if (!hull)
    throw badInput(srf_folder.string(),
                   "holds no hull; run srf acquire with its masks, or give --shape a mesh or point file");
  verifyFile(srf_folder, *hull);
  return readMesh(srf_folder / hull->file);
}

// The edges of a carved surface are about as long as the cells it was carved with; it may be off by half of one.
double halfTypicalEdge(const AcquisitionMesh& mesh) {
  std::vector<double> edges;
  edges.reserve(3 * mesh.triangles.size());
  for (const Triangle& t : mesh.triangles)
    for (int k = 0; k < 3; ++k) edges.push_back(distance(mesh.positions[t[k]], mesh.positions[t[(k + 1) % 3]]));
  if (edges.empty()) return 0;
  const auto middle = edges.begin() + static_cast<std::ptrdiff_t>(edges.size() / 2);
  std::nth_element(edges.begin(), middle, edges.end());
  return 0.5 * *middle;
}

ImportedShape shapeFor(const std::string& shape, const std::filesystem::path& srf_folder, const SrfManifest& field,
                       Reporter& reporter) {
  static const std::vector<std::string> kParametric{"sphere", "box", "cylinder", "plane", "torus"};
  if (shape == "hull") {
    ImportedShape hull{readHull(srf_folder, field)};
    hull.positional_error = halfTypicalEdge(hull.mesh);
    return hull;
  }
  if (std::find(kParametric.begin(), kParametric.end(), shape) != kParametric.end())
    return parametricShape(shape, readHull(srf_folder, field).bounds(), reporter).value();
  if (!std::filesystem::exists(shape)) {
    const std::string near = nearestWord(shape, kParametric);
    throw badInput(shape,
                   "is no file and no shape this program knows; expected hull, sphere, box, cylinder, plane, torus "
                   "or a PLY, OBJ or glTF file" +
                       (near.empty() ? "" : "; did you mean '" + near + "'?"));
  }
  const std::string suffix = std::filesystem::path(shape).extension().string();
  if (suffix == ".glb" || suffix == ".gltf") return importShape(meshFromGltf(shape), shape, reporter);
  return importShape(shape, reporter);
}

}  // namespace

DeformableModel makeModel(const std::filesystem::path& srf_folder, const std::string& shape,
                          const ModelOptions& options, const std::optional<FitOptions>& fit, Reporter& reporter,
                          const std::string& name) {
  const SrfManifest field = readManifest(srf_folder);
  const ImportedShape imported = shapeFor(shape, srf_folder, field, reporter);
  DeformableModel model = buildModel(imported.mesh, shape, imported.positional_error, field, options, reporter);
  const std::string stored = !name.empty() ? name : options.kind == ModelKind::mesh ? "mesh" : "surfels";
  storeModel(srf_folder, model, stored);
  if (!fit) return model;
  // A run that ends here leaves the model whole, without a fit: rendering is then plain.
  if (const auto fitted = fitReflectance(srf_folder, readManifest(srf_folder), model, *fit, reporter))
    storeFit(srf_folder, *fitted, stored);
  return model;
}

}  // namespace srf
