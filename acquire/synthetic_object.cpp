// GGX: Walter et al. 2007, with the height-correlated Smith term (Heitz 2014). Velvet: the inverted Gaussian of
// Ashikhmin, Premoze and Shirley 2000, with the denominator of Ashikhmin and Premoze 2007.
#include "acquire/synthetic_object.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "base/check.h"
#include "base/numeric.h"

namespace srf {
namespace {

constexpr Vec3 kEllipsoid{1, 0.75, 0.55};
constexpr double kTorusRing = 0.68, kTorusTube = 0.28;
constexpr double kBumpyRadius = 0.85, kBumpHeight = 0.09 / 0.85, kBumpFrequency = 5;
constexpr double kCylinderRadius = 0.6, kCylinderHalfHeight = 0.75, kCylinderEdge = 0.04;

constexpr double kGrazing = 1e-3;  // least n.v: at silhouettes a sampled point may lie a hair beyond the horizon
constexpr double kPlasticAlpha = 0.15, kPlasticF0 = 0.04;
constexpr double kBrushAlong = 0.1, kBrushAcross = 0.4;
constexpr Vec3 kCopperF0{0.95, 0.64, 0.54};
constexpr double kVelvetWidth = 0.5;
constexpr Vec3 kVelvetTint{0.9, 0.16, 0.3};

// Plain square root: these lengths are near 1, and std::hypot costs more than the rest of the formula.
double norm(const Vec3& a) {
  return std::sqrt(dot(a, a));
}

// Sphere, capsule, box and cylinder are all the points at one distance from a convex core.
struct Rounded {
  Vec3 core_half;  // of the core's box; the cylinder's core is the disc-ended cylinder inside it
  double radius;
};
Rounded rounded(SyntheticShape shape) {
  switch (shape) {
    case SyntheticShape::capsule:
      return {{0, 0, 0.55}, 0.45};
    case SyntheticShape::box:
      return {{0.52, 0.52, 0.52}, 0.08};
    case SyntheticShape::cylinder: {
      const double r = kCylinderRadius - kCylinderEdge;
      return {{r, r, kCylinderHalfHeight - kCylinderEdge}, kCylinderEdge};
    }
    default:
      return {{0, 0, 0}, 1};
  }
}
Vec3 nearestOfCore(SyntheticShape shape, const Vec3& half, const Vec3& p) {
  Vec3 q{std::clamp(p.x, -half.x, half.x), std::clamp(p.y, -half.y, half.y), std::clamp(p.z, -half.z, half.z)};
  if (shape != SyntheticShape::cylinder) return q;
  const double r = std::sqrt(p.x * p.x + p.y * p.y), shrink = r > half.x ? half.x / r : 1;
  return {p.x * shrink, p.y * shrink, q.z};
}

// The bumps over unit directions, and their gradient as a function of space.
double bump(const Vec3& d) {
  const double k = kBumpFrequency;
  return std::sin(k * d.x + 0.6) * std::sin(k * d.y + 1.1) * std::sin(k * d.z + 0.2);
}
Vec3 bumpGradient(const Vec3& d) {
  const double k = kBumpFrequency;
  const double a = k * d.x + 0.6, b = k * d.y + 1.1, c = k * d.z + 0.2;
  return k * Vec3{std::cos(a) * std::sin(b) * std::sin(c), std::sin(a) * std::cos(b) * std::sin(c),
                  std::sin(a) * std::sin(b) * std::cos(c)};
}

// A point of the surface from a point of the surface of the cube [-1, 1]^3, one to one.
Vec3 fromCube(SyntheticShape shape, const Vec3& c) {
  if (shape == SyntheticShape::ellipsoid) return kEllipsoid * (c / norm(c));
  if (shape == SyntheticShape::bumpy) {
    const Vec3 d = c / norm(c);
    return kBumpyRadius * (1 + kBumpHeight * bump(d)) * d;
  }
  const auto [half, radius] = rounded(shape);
  const Vec3 outer = (half + Vec3{radius, radius, radius}) * c;
  const Vec3 q = nearestOfCore(shape, half, outer), away = outer - q;
  return q + (radius / norm(away)) * away;
}

// The triangles of an n x n lattice over each side of a cube; vertices on edges are shared.
AcquisitionMesh cubeMesh(SyntheticShape shape, int n) {
  // Even angles suit round shapes; even steps suit those with flat sides and narrow rounded edges.
  const bool flat = shape == SyntheticShape::box || shape == SyntheticShape::cylinder;
  std::vector<double> step(n + 1);
  for (int i = 0; i <= n; ++i) step[i] = flat ? 2.0 * i / n - 1 : std::tan(kPi / 4 * (2.0 * i / n - 1));
  AcquisitionMesh mesh;
  constexpr std::uint32_t kNone = 0xffffffffu;
  const std::size_t side = n + 1;
  std::vector<std::uint32_t> id(side * side * side, kNone);
  const auto vertex = [&](const std::array<int, 3>& at) {
    std::uint32_t& i = id[(at[2] * side + at[1]) * side + at[0]];
    if (i == kNone) {
      i = static_cast<std::uint32_t>(mesh.positions.size());
      mesh.positions.emplace_back(fromCube(shape, {step[at[0]], step[at[1]], step[at[2]]}));
    }
    return i;
  };
  for (int axis = 0; axis < 3; ++axis)
    for (const bool far_side : {false, true})
      for (int j = 0; j < n; ++j)
        for (int i = 0; i < n; ++i) {
          const auto corner = [&](int di, int dj) {
            std::array<int, 3> at{};
            at[axis] = far_side ? n : 0;
            at[(axis + 1) % 3] = far_side ? i + di : j + dj;  // exchanged on the near side: outward winding
            at[(axis + 2) % 3] = far_side ? j + dj : i + di;
            return vertex(at);
          };
          const std::uint32_t a = corner(0, 0), b = corner(1, 0), c = corner(1, 1), d = corner(0, 1);
          mesh.triangles.push_back({a, b, c});
          mesh.triangles.push_back({a, c, d});
        }
  return mesh;
}

AcquisitionMesh torusMesh(int n) {
  const std::uint32_t around = 4 * n, across = (3 * n + 1) / 2;
  AcquisitionMesh mesh;
  for (std::uint32_t i = 0; i < around; ++i)
    for (std::uint32_t j = 0; j < across; ++j) {
      const double a = 2 * kPi * i / around, b = 2 * kPi * j / across;
      const double r = kTorusRing + kTorusTube * std::cos(b);
      mesh.positions.emplace_back(r * std::cos(a), r * std::sin(a), kTorusTube * std::sin(b));
      const std::uint32_t i1 = (i + 1) % around, j1 = (j + 1) % across;
      const std::uint32_t p = i * across + j, q = i1 * across + j, s = i1 * across + j1, t = i * across + j1;
      mesh.triangles.push_back({p, q, s});
      mesh.triangles.push_back({p, s, t});
    }
  return mesh;
}

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

}  // namespace

const std::vector<std::string>& syntheticShapeNames() {
  static const std::vector<std::string> names{"sphere", "ellipsoid", "capsule", "torus", "bumpy", "box", "cylinder"};
  return names;
}
const std::vector<std::string>& syntheticMaterialNames() {
  static const std::vector<std::string> names{"lambert", "plastic", "conductor", "velvet"};
  return names;
}

SyntheticObject::Implicit SyntheticObject::implicit(const Point<AcquisitionSpace>& at) const {
  const Vec3& p = at.raw();
  switch (shape_) {
    case SyntheticShape::ellipsoid: {
      const double scaled = norm(p / kEllipsoid);
      return {scaled - 1, Vector<AcquisitionSpace>(p / (kEllipsoid * kEllipsoid) / scaled)};
    }
    case SyntheticShape::torus: {
      const double r = std::sqrt(p.x * p.x + p.y * p.y), ring = kTorusRing / r;
      const Vec3 away = p - Vec3{ring * p.x, ring * p.y, 0};
      const double distance = norm(away);
      return {distance - kTorusTube, Vector<AcquisitionSpace>(away / distance)};
    }
    case SyntheticShape::bumpy: {
      const double r = norm(p);
      const Vec3 d = p / r, slope = bumpGradient(d);
      // The bumps are a function of d alone: only the part of the slope across d counts.
      return {r - kBumpyRadius * (1 + kBumpHeight * bump(d)),
              Vector<AcquisitionSpace>(d - (kBumpyRadius * kBumpHeight / r) * (slope - dot(slope, d) * d))};
    }
    default: {
      const auto [half, radius] = rounded(shape_);
      const Vec3 away = p - nearestOfCore(shape_, half, p);
      const double distance = norm(away);
      return {distance - radius, Vector<AcquisitionSpace>(away / distance)};
    }
  }
}

Direction<AcquisitionSpace> SyntheticObject::normal(const Point<AcquisitionSpace>& p) const {
  return normalize(implicit(p).gradient).value_or(Direction<AcquisitionSpace>());
}

Point<AcquisitionSpace> SyntheticObject::project(const Point<AcquisitionSpace>& p) const {
  Point<AcquisitionSpace> q = p;
  for (int i = 0; i < 4; ++i) {  // Newton: from 1e-2 off, three steps reach rounding
    const Implicit f = implicit(q);
    q = q - (f.value / dot(f.gradient, f.gradient)) * f.gradient;
  }
  return q;
}

std::optional<Point<AcquisitionSpace>> SyntheticObject::meet(const Ray<AcquisitionSpace>& ray, double distance) const {
  const double first = distance;
  for (int i = 0; i < 12; ++i) {  // grazing rays converge slowly: there the root is nearly double
    const Point<AcquisitionSpace> p = ray.origin + distance * ray.direction;
    const Implicit f = implicit(p);
    if (std::fabs(f.value) < 1e-13) return p;
    const double slope = dot(f.gradient, ray.direction);
    if (slope == 0) return std::nullopt;
    distance -= f.value / slope;
    if (!(std::fabs(distance - first) < 0.05)) return std::nullopt;
  }
  return std::nullopt;
}

AcquisitionMesh SyntheticObject::tessellate(int cells) const {
  SRF_CHECK(cells >= 2);
  AcquisitionMesh mesh = shape_ == SyntheticShape::torus ? torusMesh(cells) : cubeMesh(shape_, cells);
  mesh.normals.reserve(mesh.positions.size());
  for (const auto& p : mesh.positions) mesh.normals.push_back(normal(p));
  return mesh;
}

ShadingPoint SyntheticObject::shadingPoint(const Point<AcquisitionSpace>& p) const {
  const Vec3 gradient = implicit(p).gradient.raw(), n = gradient / norm(gradient);
  Vec3 around{-p.raw().y, p.raw().x, 0};
  if (norm(around) < 1e-9) around = {1, 0, 0};
  around = around - dot(around, n) * n;
  const Vec3 t = around / norm(around);
  return {p, Direction<AcquisitionSpace>::fromUnit(n), Direction<AcquisitionSpace>::fromUnit(t),
          Direction<AcquisitionSpace>::fromUnit(cross(n, t)), textureColor(p.raw())};
}

Vec3 SyntheticObject::brdf(const ShadingPoint& point, const Direction<AcquisitionSpace>& light,
                           const Direction<AcquisitionSpace>& view) const {
  const double nl = dot(point.normal, light);
  if (nl <= 0) return {};
  const Vec3 matt = (1 / kPi) * point.albedo;
  if (material_ == SyntheticMaterial::lambert) return matt;
  Local d{{dot(point.tangent, light), dot(point.bitangent, light), nl},
          {dot(point.tangent, view), dot(point.bitangent, view), std::max(dot(point.normal, view), kGrazing)},
          {},
          0};
  d.h = d.l + d.v;
  d.hh = dot(d.h, d.h);
  const double grazing = power5(std::max(0.0, 1 - 0.5 * std::sqrt(d.hh)));  // Schlick's, of l.h
  switch (material_) {
    case SyntheticMaterial::plastic: {
      const auto enters = [](double cosine) { return (1 - kPlasticF0) * (1 - power5(1 - cosine)); };
      const double coat = (kPlasticF0 + (1 - kPlasticF0) * grazing) * ggx(d, kPlasticAlpha, kPlasticAlpha);
      return enters(d.l.z) * enters(std::min(d.v.z, 1.0)) * matt + Vec3{coat, coat, coat};
    }
    case SyntheticMaterial::conductor:
      return ggx(d, kBrushAlong, kBrushAcross) * (kCopperF0 + grazing * (Vec3{1, 1, 1} - kCopperF0));
    default:  // velvet
      return 0.3 * matt + velvetLobe(d) * kVelvetTint;
  }
}

}  // namespace srf
