#include <algorithm>
#include <cmath>

#include "base/error.h"
#include "base/numeric.h"
#include "model/deformable_model.h"
#include "model/direction_field.h"
#include "model/surface_sampling.h"
#include "model/visibility.h"

namespace srf {
namespace {

constexpr std::size_t kFewestSurfels = 20'000, kMostSurfels = 400'000;
constexpr std::size_t kSurfelLimit = 20'000'000;  // what an option may ask for

void checkSurface(const AcquisitionMesh& surface, const std::string& shape) {
  if (surface.triangles.empty()) throw badInput(shape, "has no triangles, expected a surface");
  for (std::size_t i = 0; i < surface.positions.size(); ++i)
    if (!isFinite(surface.positions[i])) throw badInput(shape, "vertex " + std::to_string(i) + " is not finite");
  for (std::size_t t = 0; t < surface.triangles.size(); ++t)
    for (const std::uint32_t corner : surface.triangles[t])
      if (corner >= surface.positions.size())
        throw badInput(shape, "triangle " + std::to_string(t) + " names vertex " + std::to_string(corner) + " of " +
                                  std::to_string(surface.positions.size()));
  if (!(meshArea(surface) > 0)) throw badInput(shape, "has no area, expected a surface");
}

// With normals, and turned outwards where it is closed. The order of vertices and triangles stays: mesh sequences rely
// on it.
AcquisitionMesh outward(AcquisitionMesh mesh) {
  const MeshTopology topology = meshTopology(mesh);
  if (topology.closed && topology.oriented && meshVolume(mesh) < 0)
    for (Triangle& t : mesh.triangles) std::swap(t[1], t[2]);
  if (mesh.normals.size() != mesh.positions.size()) {
    mesh.normals = vertexNormals(mesh);
    return mesh;
  }
  // A file's normals may point the other way than its winding; on a closed surface the winding is known to be right.
  double agreement = 0;
  for (const auto& [a, b, c] : mesh.triangles) {
    const auto face = cross(mesh.positions[b] - mesh.positions[a], mesh.positions[c] - mesh.positions[a]);
    agreement += dot(mesh.normals[a], face) + dot(mesh.normals[b], face) + dot(mesh.normals[c], face);
  }
  if (topology.closed && topology.oriented && agreement < 0)
    for (auto& normal : mesh.normals) normal = -normal;
  return mesh;
}

// As many surfels as make their radius one pixel of the median view at the object.
std::size_t surfelsForPixels(const AcquisitionMesh& mesh, const SrfManifest& field) {
  const Point<AcquisitionSpace> center = mesh.bounds().center();
  std::vector<double> footprints;
  for (const StoredView& view : field.views) {
    const double depth = view.camera.depthOf(center);
    if (depth > 0 || view.camera.lens.isOrthographic()) footprints.push_back(view.camera.pixelFootprint(depth));
  }
  if (footprints.empty()) return kFewestSurfels;
  std::nth_element(footprints.begin(), footprints.begin() + footprints.size() / 2, footprints.end());
  const double wanted = meshArea(mesh) / square(footprints[footprints.size() / 2]);
  return static_cast<std::size_t>(std::clamp(wanted, double{kFewestSurfels}, double{kMostSurfels}));
}

// u0 of samples of a mesh, blended from its corners'.
std::vector<Direction<AcquisitionSpace>> directionsAt(const SurfaceSamples& samples, const AcquisitionMesh& mesh,
                                                      const std::vector<Direction<AcquisitionSpace>>& corner) {
  std::vector<Direction<AcquisitionSpace>> result;
  result.reserve(samples.points.size());
  for (std::size_t i = 0; i < samples.points.size(); ++i) {
    const Triangle& t = mesh.triangles[samples.triangle[i]];
    const double b1 = samples.weights[i][0], b2 = samples.weights[i][1], weight[3] = {1 - b1 - b2, b1, b2};
    const Vec3 normal = samples.normals[i].raw();
    Vec3 sum;
    for (int k = 0; k < 3; ++k) sum += weight[k] * carriedTangent(corner[t[k]].raw(), mesh.normals[t[k]].raw(), normal);
    sum -= dot(sum, normal) * normal;
    // About a point where the field turns round, the corners' may cancel.
    const double size = length(sum);
    result.push_back(size > 1e-6 ? Direction<AcquisitionSpace>::fromUnit(sum / size)
                                 : anyPerpendicular(samples.normals[i]));
  }
  return result;
}

}  // namespace

DeformableModel buildModel(const AcquisitionMesh& surface, const std::string& shape, double positional_error,
                           const SrfManifest& field, const ModelOptions& options, Reporter& reporter) {
  checkSurface(surface, shape);
  const double diameter = surface.bounds().diameter();
  AcquisitionMesh mesh = outward(surface);
  DeformableModel model;
  model.kind = options.kind;
  model.shape = shape;
  model.positional_error = positional_error;

  std::vector<Direction<AcquisitionSpace>> normals, directions = smoothDirections(mesh);
  if (options.kind == ModelKind::mesh) {
    model.p0 = mesh.positions;
    model.triangles = mesh.triangles;
    normals = mesh.normals;
  } else {
    if (options.surfels > kSurfelLimit)
      throw Error(ErrorKind::usage,
                  "found " + std::to_string(options.surfels) + ", expected at most " + std::to_string(kSurfelLimit),
                  "--surfels");
    const std::size_t count = options.surfels > 0 ? options.surfels : surfelsForPixels(mesh, field);
    SurfaceSamples samples = sampleSurface(mesh, count, reporter);
    directions = directionsAt(samples, mesh, directions);
    model.p0 = std::move(samples.points);
    model.radius.assign(model.p0.size(), static_cast<float>(samples.radius));
    model.anchor_triangle = std::move(samples.triangle);
    model.anchor_weights = std::move(samples.weights);
    normals = std::move(samples.normals);
  }
  model.r0.resize(model.size());
  for (std::size_t i = 0; i < model.size(); ++i)
    model.r0[i] = rodriguesFromRotation(restFrame(normals[i], directions[i]));
  // A carved or scanned surface is bumpy by as much as it is off: nothing nearer than that counts as an occluder.
  const double least_distance = options.visibility_bias * diameter + positional_error;
  const auto scene = RayScene<AcquisitionSpace>::ofTriangles(mesh.positions, mesh.triangles);
  model.visible = findVisibility(model.p0, normals, scene, field.views, least_distance, reporter);
  model.visible = withoutMixedTexels(model.visible, model.p0, normals, scene, field.views, least_distance, reporter);
  if (options.kind == ModelKind::surfels) model.rest_mesh = std::move(mesh);

  std::size_t unseen = 0;
  for (std::size_t i = 0; i < model.size(); ++i) {
    const std::uint64_t* row = model.visible.row(i);
    unseen += std::all_of(row, row + model.visible.wordsPerPoint(), [](std::uint64_t word) { return word == 0; });
  }
  reporter.figure("model.points", static_cast<double>(model.size()));
  reporter.count("model.unseen_points", unseen);
  return model;
}

}  // namespace srf
