// The small reflectance model that guides interpolation: Lambert, Lambert with Fresnel transmission, and one
// anisotropic GGX lobe, cosine inside. It says how reflectance moves between samples; the photographs say what it is.
// All in acquisition space, after L, so that no deformation touches it.
//
//   M(l, v) = (n.l)+ [ kd / pi + kt / pi (1 - (1 - n.l)^5) (1 - (1 - n.v)^5)
//                      + (ks + kf F(1 - v.h)) D(h) G1(l) G1(v) / (4 n.l n.v) ]
//
// D: Trowbridge-Reitz (GGX) with alpha along t and b = n x t (Burley 2012, appendix B); G1: Smith, separable (Walter et
// al. 2007, Heitz 2014). F rises from 0 to 1 at grazing angles as Fresnel's equations have it for refractive index 1.5,
// where ks is 0.04; between 1.3 and 1.8 its shape differs little. (Schlick's fifth power is up to a quarter too low
// between 40 and 60 degrees; a fit makes up for that with a higher, narrower lobe.) Each coefficient is one per
// channel, so M is linear in them: four scalar functions a light.
#pragma once

#include <array>
#include <cstdint>

#include "base/space.h"

namespace srf {

inline constexpr int kModelTerms = 4;  ///< kd, kt, ks, kf
/// Coefficients of x^3, x^4, x^5 and x^6 in F: what is reflected is within 2 % of Fresnel's.
inline constexpr std::array<float, 4> kFresnelRise{0.455f, 0.096f, -1.175f, 1.624f};

/// The model at one point of the surface. Floats: what is fitted to photographs has no more digits.
struct PointReflectance {
  std::array<float, 3> normal{0, 0, 1};                         ///< n, acquisition space, unit
  std::array<float, 3> tangent{1, 0, 0};                        ///< t, unit, perpendicular to n; its sign means nothing
  float alpha_x = 0.3f, alpha_y = 0.3f;                         ///< GGX roughness along t and n x t
  std::array<std::array<float, 3>, kModelTerms> coefficient{};  ///< [kd kt ks kf][channel], all >= 0
};

/// Directions to lights as three arrays, so that many are evaluated at once. Unit, acquisition space.
struct LightDirections {
  const float *x, *y, *z;
  int count;  ///< the arrays hold a multiple of 8; what lies beyond is finite and of no matter
};

/// A view as the model takes it: one below the horizon is the one at it of the same azimuth.
struct ModelSight {
  std::array<float, 3> v;
  float nv, tv, bv;  ///< its products with n, t and b = n x t
};
ModelSight modelSight(const std::array<float, 3>& n, const std::array<float, 3>& t, const std::array<float, 3>& b,
                      const std::array<float, 3>& view);

/// The four functions of (l, v) that the coefficients multiply, for each light: term[k][i], each of at least `count`
/// rounded up to 8 floats. 0 where n.l <= 0; v as modelSight has it. Always finite for alpha >= 0.005. Relative error
/// against the double twin: 2e-5 of the largest value of that term.
void modelTerms(const PointReflectance& point, const std::array<float, 3>& view, const LightDirections& lights,
                const std::array<float*, kModelTerms>& term);

/// The same for one light in double: the oracle.
std::array<double, kModelTerms> modelTermsReference(const PointReflectance& point,
                                                    const Direction<AcquisitionSpace>& light,
                                                    const Direction<AcquisitionSpace>& view);

}  // namespace srf
