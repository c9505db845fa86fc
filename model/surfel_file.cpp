#include "model/surfel_file.h"

#include "base/error.h"
#include "base/mesh_io.h"

namespace srf {

void writeSurfels(const std::filesystem::path& file, const DeformableModel& model) {
  const char* const option = "--export-surfels";
  if (model.kind != ModelKind::surfels)
    throw Error(ErrorKind::usage, "the model is of triangles; make one with --kind surfels, or use --export", option);
  if (file.extension() != ".ply")
    throw Error(ErrorKind::usage, "found '" + file.string() + "', expected a name that ends in .ply", option);
  AcquisitionMesh cloud;
  cloud.positions = model.p0;
  cloud.normals.reserve(model.size());
  for (const Vec3& r0 : model.r0)
    cloud.normals.push_back(Direction<AcquisitionSpace>::fromUnit(rotationFromRodrigues(r0).raw().column(2)));
  writePly(file, cloud, {{"radius", model.radius}});
}

}  // namespace srf
