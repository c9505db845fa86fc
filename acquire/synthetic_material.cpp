// GGX: Walter et al. 2007, with the height-correlated Smith term (Heitz 2014). Velvet: the inverted Gaussian of
// Ashikhmin, Premoze and Shirley 2000, with the denominator of Ashikhmin and Premoze 2007.
#include "acquire/synthetic_material.h"

#include <algorithm>
#include <cmath>

#include "base/numeric.h"

namespace srf {
namespace {

constexpr double kGrazing = 1e-3;  // least n.v: at silhouettes a sampled point may lie a hair beyond the horizon
constexpr double kPlasticAlpha = 0.15, kRoughAlpha = 0.35, kGlossAlpha = 0.025, kGlassAlpha = 0.05;
constexpr double kBrushAlong = 0.1, kBrushAcross = 0.4;
constexpr Vec3 kCopperF0{0.95, 0.64, 0.54};
constexpr double kVelvetWidth = 0.5;
constexpr Vec3 kVelvetTint{0.9, 0.16, 0.3};
constexpr Vec3 kWhite{0.85, 0.85, 0.85};

// Smooth colours and a soft checker. Nothing changes within less than 0.06 units, some 3 pixels of a usual capture, so
// that photographs of it are not aliased.
Vec3 textureColor(const Vec3& p) {
  const double s = std::sin(5.5 * p.x + 0.8) * std::sin(5.5 * p.y + 1.9) * std::sin(5.5 * p.z + 0.5);
  const double check = 0.5 + 0.5 * s / std::sqrt(s * s + 0.03);
  const double w1 = 0.5 + 0.5 * std::sin(3.1 * p.x + 2.3 * p.z), w2 = 0.5 + 0.5 * std::sin(4.2 * p.y - 1.7 * p.x + 1);
  const double w3 = 0.5 + 0.5 * std::sin(3.7 * p.z + 2.9 * p.y + 2);
  const Vec3 warm{0.80, 0.34 + 0.30 * w1, 0.12 + 0.14 * w2}, cold{0.06 + 0.16 * w3, 0.22 + 0.20 * w2, 0.45 + 0.30 * w1};
  return check * warm + (1 - check) * cold;
}

double power5(double x) {
  return square(square(x)) * x;
}

// Directions in the frame of a shading point, and their unscaled half vector.
struct Local {
  Vec3 l, v, h;
  double hh;  // |h|^2; for unit l and v, l.h / |h| = |h| / 2
};

// D V = D G2 / (4 n.l n.v) of GGX.
double ggx(const Local& d, double ax, double ay) {
  const double q = square(d.h.x / ax) + square(d.h.y / ay) + square(d.h.z);
  const double distribution = square(d.hh / q) / (kPi * ax * ay);
  const double mask_v = d.l.z * std::sqrt(square(ax * d.v.x) + square(ay * d.v.y) + square(d.v.z));
  const double mask_l = d.v.z * std::sqrt(square(ax * d.l.x) + square(ay * d.l.y) + square(d.l.z));
  return distribution * 0.5 / (mask_v + mask_l);
}

double velvetLobe(const Local& d) {
  const double cos2 = square(d.h.z) / d.hh, sin2 = std::max(1 - cos2, 1e-6), width2 = square(kVelvetWidth);
  const double distribution = (1 + 4 * std::exp(-cos2 / (sin2 * width2)) / square(sin2)) / (kPi * (1 + 4 * width2));
  return distribution / (4 * (d.l.z + d.v.z - d.l.z * d.v.z));
}

// Which of four materials covers a point: patches some 0.5 units across, whose borders are sharp.
int patchAt(const Vec3& p) {
  const double a = std::sin(4.6 * p.x + 0.7 * std::sin(4 * p.y) + 0.4) + 0.8 * std::sin(4.1 * p.z + 1.1);
  const double b = std::sin(4.3 * p.y + 0.7 * std::sin(4 * p.z) + 1.2) - 0.8 * std::sin(3.9 * p.x + 0.3 + 2 * p.z);
  return (a > 0 ? 1 : 0) + (b > 0 ? 2 : 0);
}

void setKind(SyntheticMaterial material, ShadingPoint& point) {
  const auto coat = [&](double alpha) { point.kind = SurfaceKind::coated, point.alpha = alpha; };
  switch (material) {
    case SyntheticMaterial::plastic:
      return coat(kPlasticAlpha);
    case SyntheticMaterial::gloss:
      return coat(kGlossAlpha);
    case SyntheticMaterial::conductor:
      point.kind = SurfaceKind::brushed_metal;
      return;
    case SyntheticMaterial::velvet:
      point.kind = SurfaceKind::velvet;
      return;
    case SyntheticMaterial::mixed:
      switch (patchAt(point.p.raw())) {
        case 0:
          return setKind(SyntheticMaterial::lambert, point);
        case 1:
          return setKind(SyntheticMaterial::plastic, point);
        case 2:
          return coat(kRoughAlpha);
        default:
          return setKind(SyntheticMaterial::conductor, point);
      }
    case SyntheticMaterial::white:
      point.albedo = kWhite;
      return;
    case SyntheticMaterial::glass:
      point.albedo = {};
      return coat(kGlassAlpha);
    case SyntheticMaterial::wax:
      point.kind = SurfaceKind::scattering;
      return;
    case SyntheticMaterial::lambert:
      return;
  }
}

}  // namespace

const std::vector<std::string>& syntheticMaterialNames() {
  static const std::vector<std::string> names{"lambert", "plastic", "conductor", "velvet", "gloss",
                                              "mixed",   "white",   "wax",       "glass"};
  return names;
}

ShadingPoint shadingPointOf(SyntheticMaterial material, const Point<AcquisitionSpace>& p,
                            const Direction<AcquisitionSpace>& normal) {
  const Vec3& n = normal.raw();
  Vec3 around{-p.raw().y, p.raw().x, 0};
  if (length(around) < 1e-9) around = {1, 0, 0};
  around = around - dot(around, n) * n;
  const Vec3 t = around / length(around);
  ShadingPoint point{p, normal, Direction<AcquisitionSpace>::fromUnit(t),
                     Direction<AcquisitionSpace>::fromUnit(cross(n, t)), textureColor(p.raw())};
  setKind(material, point);
  return point;
}

double dielectricReflectance(double cosine) {
  const double inside = std::sqrt(1 - (1 - cosine * cosine) / square(kDielectricIndex));
  const double along = (kDielectricIndex * cosine - inside) / (kDielectricIndex * cosine + inside);
  const double across = (cosine - kDielectricIndex * inside) / (cosine + kDielectricIndex * inside);
  return 0.5 * (square(along) + square(across));
}

Vec3 brdf(const ShadingPoint& point, const Direction<AcquisitionSpace>& light,
          const Direction<AcquisitionSpace>& view) {
  const double nl = dot(point.normal, light);
  if (nl <= 0 || point.kind == SurfaceKind::scattering) return {};
  const Vec3 matt = (1 / kPi) * point.albedo;
  if (point.kind == SurfaceKind::matt) return matt;
  Local d{{dot(point.tangent, light), dot(point.bitangent, light), nl},
          {dot(point.tangent, view), dot(point.bitangent, view), std::max(dot(point.normal, view), kGrazing)},
          {},
          0};
  d.h = d.l + d.v;
  d.hh = dot(d.h, d.h);
  const double l_h = std::min(0.5 * std::sqrt(d.hh), 1.0);
  switch (point.kind) {
    case SurfaceKind::coated: {
      const auto enters = [](double cosine) { return 1 - dielectricReflectance(cosine); };
      const double coat = dielectricReflectance(l_h) * ggx(d, point.alpha, point.alpha);
      return enters(d.l.z) * enters(std::min(d.v.z, 1.0)) * matt + Vec3{coat, coat, coat};
    }
    case SurfaceKind::brushed_metal:  // Schlick's
      return ggx(d, kBrushAlong, kBrushAcross) * (kCopperF0 + power5(1 - l_h) * (Vec3{1, 1, 1} - kCopperF0));
    default:  // velvet
      return 0.3 * matt + velvetLobe(d) * kVelvetTint;
  }
}

}  // namespace srf
