// Objects by formula: a closed surface with exact normals, and a reflectance. All in acquisition space; every object is
// centred at the origin and lies within the sphere of radius 1 unit.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "acquire/synthetic_material.h"
#include "base/camera.h"
#include "base/mesh.h"

namespace srf {

/// sphere: radius 1. ellipsoid: half axes 1, 0.75, 0.55. capsule: radius 0.45, length 2 along z. torus: radii 0.68 and
/// 0.28 about z. bumpy: a sphere of radius 0.85 with smooth bumps of +-0.09. box: half side 0.6, edges rounded by 0.08.
/// cylinder: radius 0.6, half height 0.75, edges rounded by 0.04. bowl: half a spherical shell, open upwards, radius
/// 0.84, thickness 0.12, rim rounded; no silhouette shows its hollow. slab: half sides 0.83, 0.59, 0.14, edges rounded
/// by 0.09. ball_on_plate: a ball of radius 0.45 that floats 0.03 above a square plate of half side 0.6.
enum class SyntheticShape { sphere, ellipsoid, capsule, torus, bumpy, box, cylinder, bowl, slab, ball_on_plate };
/// In the order of the enumeration.
const std::vector<std::string>& syntheticShapeNames();

class SyntheticObject {
 public:
  SyntheticObject(SyntheticShape shape, SyntheticMaterial material) : shape_(shape), material_(material) {}

  SyntheticShape shape() const { return shape_; }
  SyntheticMaterial material() const { return material_; }
  /// A convex object casts no shadow on itself.
  bool convex() const;

  /// A smooth function that is 0 on the surface and grows outwards, and its gradient. Valid near the surface.
  struct Implicit {
    double value;
    Vector<AcquisitionSpace> gradient;
  };
  Implicit implicit(const Point<AcquisitionSpace>& p) const;
  Direction<AcquisitionSpace> normal(const Point<AcquisitionSpace>& p) const;
  /// The surface point near p (p within a few per cent of a unit of the surface).
  Point<AcquisitionSpace> project(const Point<AcquisitionSpace>& p) const;
  /// Where the ray meets the surface near origin + distance * direction; nothing where it passes by.
  std::optional<Point<AcquisitionSpace>> meet(const Ray<AcquisitionSpace>& ray, double distance) const;

  /// Closed, manifold, outward; vertices on the surface with its normals. `cells`: 12 cells^2 triangles.
  AcquisitionMesh tessellate(int cells) const;

  /// Everything that brdf needs at a point of the surface.
  ShadingPoint shadingPoint(const Point<AcquisitionSpace>& p) const { return shadingPointOf(material_, p, normal(p)); }

 private:
  SyntheticShape shape_;
  SyntheticMaterial material_;
};

}  // namespace srf
