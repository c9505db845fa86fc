// Reflectances by formula, and what they depend on at a point of a surface. All in acquisition space.
#pragma once

#include <string>
#include <vector>

#include "base/space.h"

namespace srf {

/// Refractive index of coats and of glass.
inline constexpr double kDielectricIndex = 1.5;
/// Share of unpolarised light from the air that these reflect at this cosine between ray and facet (Fresnel's
/// equations).
double dielectricReflectance(double cosine);

/// lambert: textured, matt. plastic: the same texture under a rough dielectric coat (GGX, alpha 0.15). conductor:
/// brushed copper (GGX, alpha 0.1 along the tangent, 0.4 across). velvet: bright towards grazing angles, faint texture.
/// gloss: plastic with a coat that nearly mirrors (alpha 0.025): highlights narrower than the spacing of the lights.
/// mixed: patches of lambert, plastic, rougher plastic (alpha 0.35) and conductor. white: matt, without texture.
/// wax: textured, scatters light below its surface (synthetic_indirect.h). glass: see SyntheticObject::seenAt.
enum class SyntheticMaterial { lambert, plastic, conductor, velvet, gloss, mixed, white, wax, glass };
/// In the order of the enumeration.
const std::vector<std::string>& syntheticMaterialNames();

/// What a single lobe or mixture of lobes is made of; a material has one everywhere, `mixed` one a patch.
enum class SurfaceKind { matt, coated, brushed_metal, velvet, scattering };

/// What the reflectance at a surface point depends on, found once for all lights.
struct ShadingPoint {
  Point<AcquisitionSpace> p;
  Direction<AcquisitionSpace> normal;
  Direction<AcquisitionSpace> tangent;    ///< around the z axis, in the tangent plane; along x on the axis itself
  Direction<AcquisitionSpace> bitangent;  ///< normal x tangent
  Vec3 albedo;                            ///< of the texture, each within (0, 1)
  SurfaceKind kind = SurfaceKind::matt;
  double alpha = 0;  ///< GGX roughness of a coat
};

ShadingPoint shadingPointOf(SyntheticMaterial material, const Point<AcquisitionSpace>& p,
                            const Direction<AcquisitionSpace>& normal);
/// 1/sr per channel; 0 below the surface on the light's side, and of wax, whose light all comes from below. Reciprocal,
/// reflects at most what arrives. The viewing direction is taken as at least 0.06 degrees above the surface.
Vec3 brdf(const ShadingPoint& point, const Direction<AcquisitionSpace>& light, const Direction<AcquisitionSpace>& view);

}  // namespace srf
