// Objects by formula: a closed surface with exact normals, and a reflectance. All in acquisition space; every object is
// centred at the origin and lies within the sphere of radius 1 unit.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "base/camera.h"
#include "base/mesh.h"

namespace srf {

/// sphere: radius 1. ellipsoid: half axes 1, 0.75, 0.55. capsule: radius 0.45, length 2 along z. torus: radii 0.68 and
/// 0.28 about z. bumpy: a sphere of radius 0.85 with smooth bumps of +-0.09. box: half side 0.6, edges rounded by 0.08.
/// cylinder: radius 0.6, half height 0.75, edges rounded by 0.04.
enum class SyntheticShape { sphere, ellipsoid, capsule, torus, bumpy, box, cylinder };
/// lambert: textured, matt. plastic: the same texture under a rough dielectric coat (GGX, alpha 0.15). conductor:
/// brushed copper (GGX, alpha 0.1 along the tangent, 0.4 across). velvet: bright towards grazing angles, faint texture.
enum class SyntheticMaterial { lambert, plastic, conductor, velvet };
/// In the order of the enumerations.
const std::vector<std::string>& syntheticShapeNames();
const std::vector<std::string>& syntheticMaterialNames();

/// What the reflectance at a surface point depends on, found once for all lights.
struct ShadingPoint {
  Point<AcquisitionSpace> p;
  Direction<AcquisitionSpace> normal;
  Direction<AcquisitionSpace> tangent;    ///< around the z axis, in the tangent plane; along x on the axis itself
  Direction<AcquisitionSpace> bitangent;  ///< normal x tangent
  Vec3 albedo;                            ///< of the texture, each within (0, 1)
};

class SyntheticObject {
 public:
  SyntheticObject(SyntheticShape shape, SyntheticMaterial material) : shape_(shape), material_(material) {}

  SyntheticShape shape() const { return shape_; }
  SyntheticMaterial material() const { return material_; }
  bool convex() const { return shape_ != SyntheticShape::torus && shape_ != SyntheticShape::bumpy; }

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
  ShadingPoint shadingPoint(const Point<AcquisitionSpace>& p) const;
  /// 1/sr per channel; 0 below the surface on the light's side. Reciprocal, reflects at most what arrives. The viewing
  /// direction is taken as at least 0.06 degrees above the surface.
  Vec3 brdf(const ShadingPoint& point, const Direction<AcquisitionSpace>& light,
            const Direction<AcquisitionSpace>& view) const;

 private:
  SyntheticShape shape_;
  SyntheticMaterial material_;
};

}  // namespace srf
