#include "acquire/synthetic_object.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <span>

#include "base/check.h"
#include "base/numeric.h"

namespace srf {
namespace {

constexpr Vec3 kEllipsoid{1, 0.75, 0.55};
constexpr double kTorusRing = 0.68, kTorusTube = 0.28;
constexpr double kBumpyRadius = 0.85, kBumpHeight = 0.09 / 0.85, kBumpFrequency = 5;
constexpr double kCylinderRadius = 0.6, kCylinderHalfHeight = 0.75, kCylinderEdge = 0.04;

// The bowl's mid-surface is the lower half of a sphere; all within half its thickness of it is the bowl.
constexpr double kBowlRadius = 0.84, kBowlWall = 0.06;
constexpr Vec3 kBowlCenter{0, 0, 0.4};

// Plain square root: these lengths are near 1, and std::hypot costs more than the rest of the formula.
double norm(const Vec3& a) {
  return std::sqrt(dot(a, a));
}

// Sphere, capsule, box, cylinder, slab and plate are all the points at one distance from a convex core.
struct Rounded {
  Vec3 center;
  Vec3 core_half;  // of the core's box
  double radius;
  bool disc = false;  // the core is the cylinder along z inside that box
};
constexpr Rounded kSphere{{}, {}, 1};
constexpr Rounded kCapsule{{}, {0, 0, 0.55}, 0.45};
constexpr Rounded kBox{{}, {0.52, 0.52, 0.52}, 0.08};
constexpr double kCylinderCore = kCylinderRadius - kCylinderEdge;
constexpr Rounded kCylinder{
    {}, {kCylinderCore, kCylinderCore, kCylinderHalfHeight - kCylinderEdge}, kCylinderEdge, true};
constexpr Rounded kSlab{{}, {0.74, 0.5, 0.05}, 0.09};
constexpr Rounded kBallOnPlate[] = {{{0, 0, 0.12}, {}, 0.45}, {{0, 0, -0.42}, {0.56, 0.56, 0.02}, 0.04}};

std::span<const Rounded> roundedParts(SyntheticShape shape) {
  switch (shape) {
    case SyntheticShape::sphere:
      return {&kSphere, 1};
    case SyntheticShape::capsule:
      return {&kCapsule, 1};
    case SyntheticShape::box:
      return {&kBox, 1};
    case SyntheticShape::cylinder:
      return {&kCylinder, 1};
    case SyntheticShape::slab:
      return {&kSlab, 1};
    case SyntheticShape::ball_on_plate:
      return kBallOnPlate;
    default:
      return {};
  }
}
Vec3 nearestOfCore(const Rounded& part, const Vec3& p) {
  const Vec3 &half = part.core_half, local = p - part.center;
  Vec3 q{std::clamp(local.x, -half.x, half.x), std::clamp(local.y, -half.y, half.y),
         std::clamp(local.z, -half.z, half.z)};
  if (part.disc) {
    const double r = std::sqrt(local.x * local.x + local.y * local.y), shrink = r > half.x ? half.x / r : 1;
    q.x = local.x * shrink, q.y = local.y * shrink;
  }
  return part.center + q;
}
SyntheticObject::Implicit roundedImplicit(const Rounded& part, const Vec3& p) {
  const Vec3 away = p - nearestOfCore(part, p);
  const double distance = norm(away);
  return {distance - part.radius, Vector<AcquisitionSpace>(away / distance)};
}
Vec3 roundedFromCube(const Rounded& part, const Vec3& c) {
  const Vec3 outer = part.center + (part.core_half + Vec3{part.radius, part.radius, part.radius}) * c;
  const Vec3 q = nearestOfCore(part, outer), away = outer - q;
  return q + (part.radius / norm(away)) * away;
}

// The bowl's core is a half circle in the half-plane (r, z) about its axis: below its centre the nearest point lies
// along the radius, above it is the rim's.
SyntheticObject::Implicit bowlImplicit(const Vec3& at) {
  const Vec3 p = at - kBowlCenter;
  const double r = std::sqrt(p.x * p.x + p.y * p.y), radius = norm(p);
  if (p.z <= 0) {
    const double side = radius > kBowlRadius ? 1 : -1;
    return {side * (radius - kBowlRadius) - kBowlWall, Vector<AcquisitionSpace>((side / radius) * p)};
  }
  const double toward_rim = kBowlRadius / r;
  const Vec3 away = p - Vec3{toward_rim * p.x, toward_rim * p.y, 0};
  const double distance = norm(away);
  return {distance - kBowlWall, Vector<AcquisitionSpace>(away / distance)};
}
// From the middle of the hollow (up) over the rim to the lowest point outside (down), along the profile; the rim, which
// bends most, is given more than its share.
Vec3 bowlFromUnit(const Vec3& d) {
  const double inner = kBowlRadius - kBowlWall, outer = kBowlRadius + kBowlWall;
  const double along_inner = inner * kPi / 2, along_rim = 4 * kBowlWall * kPi, along_outer = outer * kPi / 2;
  const double across = std::sqrt(d.x * d.x + d.y * d.y);
  double s = std::atan2(across, d.z) / kPi * (along_inner + along_rim + along_outer), r, z;
  if (s < along_inner) {
    r = inner * std::sin(s / inner), z = -inner * std::cos(s / inner);
  } else if ((s -= along_inner) < along_rim) {
    const double around = s / (4 * kBowlWall);
    r = kBowlRadius - kBowlWall * std::cos(around), z = kBowlWall * std::sin(around);
  } else {
    s -= along_rim;
    r = outer * std::cos(s / outer), z = -outer * std::sin(s / outer);
  }
  const double turn = across > 0 ? r / across : 0;
  return kBowlCenter + Vec3{turn * d.x, turn * d.y, z};
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
  const Vec3 d = c / norm(c);
  switch (shape) {
    case SyntheticShape::ellipsoid:
      return kEllipsoid * d;
    case SyntheticShape::bumpy:
      return kBumpyRadius * (1 + kBumpHeight * bump(d)) * d;
    default:
      return bowlFromUnit(d);
  }
}

// The triangles of an n x n lattice over each side of a cube; vertices on edges are shared.
// `step`: from -1 to 1; `from_cube`: the surface point of a point of the cube.
template <class FromCube>
void addCube(const std::vector<double>& step, const FromCube& from_cube, AcquisitionMesh& mesh) {
  const int n = static_cast<int>(step.size()) - 1;
  constexpr std::uint32_t kNone = 0xffffffffu;
  const std::size_t side = n + 1;
  std::vector<std::uint32_t> id(side * side * side, kNone);
  const auto vertex = [&](const std::array<int, 3>& at) {
    std::uint32_t& i = id[(at[2] * side + at[1]) * side + at[0]];
    if (i == kNone) {
      i = static_cast<std::uint32_t>(mesh.positions.size());
      mesh.positions.emplace_back(from_cube(Vec3{step[at[0]], step[at[1]], step[at[2]]}));
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
}

// Even angles suit round shapes; even steps suit those with flat sides and narrow rounded edges, and steps that narrow
// towards the ends those whose sides are wide against their edges.
std::vector<double> evenAngles(int n) {
  std::vector<double> step(n + 1);
  for (int i = 0; i <= n; ++i) step[i] = std::tan(kPi / 4 * (2.0 * i / n - 1));
  return step;
}
std::vector<double> stepsFor(const Rounded& part, int n) {
  const double core = maxComponent(part.core_half);
  if (core == 0 || part.radius > core / 2) return evenAngles(n);
  std::vector<double> step(n + 1);
  for (int i = 0; i <= n; ++i) {
    const double even = 2.0 * i / n - 1;
    step[i] = minComponent(part.core_half) < core / 4 ? 0.5 * (even + std::sin(kPi / 2 * even)) : even;
  }
  return step;
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

using Direction0 = Direction<AcquisitionSpace>;

// Past a surface with normal n on the side that d comes from; eta: index there over index beyond. Along the surface
// where nothing passes (rounding alone leads there: a ray leaves a ball as steeply as it came in).
Direction0 refracted(const Direction0& d, const Direction0& n, double eta) {
  const double cosine = -dot(d, n), k = 1 - eta * eta * (1 - cosine * cosine);
  const auto along = eta * Vector<AcquisitionSpace>(d) + (eta * cosine - std::sqrt(std::max(k, 0.0))) * n;
  return normalize(along).value_or(d);
}

// Of ball_on_plate.
bool onBall(const Vec3& p) {
  return roundedImplicit(kBallOnPlate[0], p).value < roundedImplicit(kBallOnPlate[1], p).value;
}

// Where a ray first meets a rounded part, by steps of its distance.
std::optional<Vec3> march(const Rounded& part, const Vec3& from, const Vec3& d) {
  double t = 0;
  for (int i = 0; i < 300 && t < 4; ++i) {
    const double step = roundedImplicit(part, from + t * d).value;
    if (step < 1e-9) return from + t * d;
    t += step;
  }
  return std::nullopt;
}

}  // namespace

const std::vector<std::string>& syntheticShapeNames() {
  static const std::vector<std::string> names{"sphere", "ellipsoid", "capsule", "torus", "bumpy",
                                              "box",    "cylinder",  "bowl",    "slab",  "ball_on_plate"};
  return names;
}

std::string SyntheticObject::faultOf(SyntheticShape shape, SyntheticMaterial material, bool interreflection) {
  if (interreflection && material != SyntheticMaterial::lambert && material != SyntheticMaterial::white)
    return "interreflection is that of matt surfaces; expected the material lambert or white";
  if (material == SyntheticMaterial::glass && shape != SyntheticShape::ball_on_plate)
    return "glass is the material of a ball over a pattern; expected the object ball_on_plate";
  return {};
}

SyntheticTransport SyntheticObject::transport() const {
  if (material_ == SyntheticMaterial::wax) return SyntheticTransport::subsurface;
  return interreflection_ ? SyntheticTransport::interreflection : SyntheticTransport::direct;
}

bool SyntheticObject::convex() const {
  return shape_ == SyntheticShape::ellipsoid || roundedParts(shape_).size() == 1;
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
    case SyntheticShape::bowl:
      return bowlImplicit(p);
    default: {
      Implicit nearest{INFINITY, {}};
      for (const Rounded& part : roundedParts(shape_))
        if (const Implicit f = roundedImplicit(part, p); f.value < nearest.value) nearest = f;
      return nearest;
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
  AcquisitionMesh mesh;
  const std::span<const Rounded> parts = roundedParts(shape_);
  if (shape_ == SyntheticShape::torus)
    mesh = torusMesh(cells);
  else if (parts.empty())
    addCube(
        evenAngles(cells), [&](const Vec3& c) { return fromCube(shape_, c); }, mesh);
  for (const Rounded& part : parts)
    addCube(
        stepsFor(part, cells), [&](const Vec3& c) { return roundedFromCube(part, c); }, mesh);
  mesh.normals.reserve(mesh.positions.size());
  for (const auto& p : mesh.positions) mesh.normals.push_back(normal(p));
  return mesh;
}

ShadingPoint SyntheticObject::shadingPoint(const Point<AcquisitionSpace>& p) const {
  const bool plate = material_ == SyntheticMaterial::glass && !onBall(p.raw());
  return shadingPointOf(plate ? SyntheticMaterial::lambert : material_, p, normal(p));
}

std::vector<SyntheticObject::Seen> SyntheticObject::seenAt(const Point<AcquisitionSpace>& p,
                                                           const Direction<AcquisitionSpace>& view) const {
  std::vector<Seen> seen{{shadingPoint(p), view, 1}};
  if (material_ != SyntheticMaterial::glass || !onBall(p.raw())) return seen;
  const auto& [ball, plate] = kBallOnPlate;
  const Direction0 n = seen[0].point.normal;
  const double cosine = std::clamp(dot(n, view), 0.0, 1.0), mirrored = dielectricReflectance(cosine);
  const auto add = [&](const Vec3& from, const Direction0& along, double weight) {
    if (const auto met = march(plate, from, along.raw()))
      seen.push_back({shadingPoint(project(Point<AcquisitionSpace>(*met))), -along, weight});
  };
  const Direction0 inside = refracted(-view, n, 1 / kDielectricIndex);
  const Vec3 leaves = p.raw() + std::max(0.0, -2 * ball.radius * dot(n, inside)) * inside.raw();
  const Direction0 out = normalize(Vector<AcquisitionSpace>(leaves - ball.center)).value_or(n);
  add(leaves, refracted(inside, -out, kDielectricIndex), square(1 - mirrored));
  add(p.raw(), normalize(2 * cosine * n - Vector<AcquisitionSpace>(view)).value_or(n), mirrored);
  return seen;
}

std::vector<Triangle> SyntheticObject::casters(const AcquisitionMesh& tessellation) const {
  std::vector<Triangle> triangles = tessellation.triangles;
  if (material_ == SyntheticMaterial::glass)
    std::erase_if(triangles, [&](const Triangle& t) { return onBall(tessellation.positions[t[0]].raw()); });
  return triangles;
}

}  // namespace srf
