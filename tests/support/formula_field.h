// A small SRF of the unit sphere whose reflectance is a formula: written straight into a store, so that a picture of it
// has a known answer which no other stage of the program had a part in.
#pragma once

#include <filesystem>
#include <functional>

#include "field/reflectance_store.h"
#include "field/srf_folder.h"
#include "model/deformable_model.h"

namespace srf::test {

/// Reflectance (1/sr, cosine inside) of the surface point whose normal is p: p0 itself for the unit sphere.
using ReflectanceFormula = std::function<Vec3(const Vec3& p, const Vec3& l, const Vec3& v)>;

struct FormulaFieldOptions {
  int views = 24, lights = 64;  ///< on Fibonacci spheres
  int size = 64;                ///< pixels a side
  int samples = 1;              ///< rays a side of a pixel, which holds their mean, or nothing where one misses
  int subdivision = 5;          ///< of an octahedron: 8 * 4^n triangles
  double view_distance = 4;
  bool near_lights = false;  ///< point lights at distance 3 instead of directional ones
  Vec3 middle;               ///< of the sphere in acquisition space
  double radius = 1;         ///< of it; distances above are in radii
  ModelOptions model;
  bool levels = false;  ///< coarser ones of each view
  StoreCoding coding;
  bool parallel = false;  ///< the formula may be asked by several threads at once
};

struct FormulaField {
  std::filesystem::path folder;
  SrfManifest manifest;
  DeformableModel model;
};

FormulaField makeSphereField(const std::filesystem::path& srf_folder, const FormulaFieldOptions& options,
                             const ReflectanceFormula& reflectance);

/// Point i of n on a Fibonacci sphere.
Vec3 fibonacci(int i, int n);
/// The unit sphere as a subdivided octahedron with exact normals.
AcquisitionMesh unitSphere(int subdivision);

}  // namespace srf::test
