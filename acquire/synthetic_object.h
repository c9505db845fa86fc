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

/// How light reaches a point: from its source alone; by way of other points of the surface too; below the surface.
enum class SyntheticTransport { direct, interreflection, subsurface };

class SyntheticObject {
 public:
  SyntheticObject(SyntheticShape shape, SyntheticMaterial material, bool interreflection = false)
      : shape_(shape), material_(material), interreflection_(interreflection) {}
  /// What is wrong with a combination, for people; empty where nothing is: interreflection is that of matt surfaces,
  /// and only ball_on_plate has a ball of glass.
  static std::string faultOf(SyntheticShape shape, SyntheticMaterial material, bool interreflection);

  SyntheticShape shape() const { return shape_; }
  SyntheticMaterial material() const { return material_; }
  SyntheticTransport transport() const;
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
  ShadingPoint shadingPoint(const Point<AcquisitionSpace>& p) const;
  /// What is seen of the surface point p from the direction `view`: itself. Of a ball of glass (index 1.5) besides: the
  /// plate's points that are met along the ray refracted through the ball (Snell; once in, once out; weight: what
  /// Fresnel's equations let through) and along the mirrored ray (weight: what they reflect). Light passes the ball as
  /// if it were not there: it casts neither shadow nor caustic.
  struct Seen {
    ShadingPoint point;
    Direction<AcquisitionSpace> view;
    double weight;
  };
  std::vector<Seen> seenAt(const Point<AcquisitionSpace>& p, const Direction<AcquisitionSpace>& view) const;
  /// The triangles of this object's tessellation that cast shadows: all but a ball of glass.
  std::vector<Triangle> casters(const AcquisitionMesh& tessellation) const;

 private:
  SyntheticShape shape_;
  SyntheticMaterial material_;
  bool interreflection_;
};

}  // namespace srf
