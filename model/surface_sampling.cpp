#include "model/surface_sampling.h"

#include <algorithm>
#include <cmath>

#include "base/check.h"
#include "base/numeric.h"
#include "base/parallel.h"

// Dart throwing (Cook 1986) on a hash grid: random candidates in a fixed order, each kept unless a kept one is too
// near. A lattice of candidates over every triangle then fills what chance has left, so that the radius is a guarantee:
// the straight line through a place of the surface, along the normal of its triangle, meets a disc that faces as it
// does.

namespace srf {
namespace {

// Random candidates for each sample asked for: what is left then is small gaps, and throwing on finds few of them.
constexpr std::size_t kRounds = 8;
// Spacing of the lattice that fills them, in distances between samples. No place of the surface is further than 1.12 of
// it from a lattice point of its triangle.
constexpr double kLattice = 0.2;
// Radius of the discs in distances between samples.
constexpr double kRadius = 1.25;
// A lattice point is covered where its line meets a disc this near to the disc's centre, so that the whole cell about
// it is (1.12 kLattice, and 2 % for discs askew on a curved surface), and no further away than this.
constexpr double kCovered = kRadius - 1.12 * kLattice - 0.02, kOffSurface = 0.25;
// Discs whose normals are further apart than 60 degrees belong to different sides of an edge: each side has its own.
constexpr double kSameSide = 0.5;
// Samples times distance^2 over area (measured; the limit of endless darts in the plane is 0.697).
constexpr double kDensity = 0.68;
// Cosine between a face and its interpolated normal at which the corner is taken to be sharp and the face's normal
// holds.
constexpr double kSharpCosine = 0.866;

// Uniform in [0, 1) from a counter (SplitMix64).
double uniform(std::uint64_t counter) {
  std::uint64_t z = (counter + 1) * 0x9e3779b97f4a7c15u;
  z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9u;
  z = (z ^ (z >> 27)) * 0x94d049bb133111ebu;
  return static_cast<double>((z ^ (z >> 31)) >> 11) * 0x1p-53;
}

struct Candidate {
  Point<AcquisitionSpace> point;
  std::uint32_t triangle;
  std::array<float, 2> weights;
  Vec3 normal;  ///< of its disc
};

// Kept points by the cell of a grid, in a hash table with chains.
class Neighbours {
 public:
  Neighbours(double distance, std::size_t count) : distance_(distance) {
    std::size_t size = 64;
    while (size < 2 * count) size *= 2;
    head_.assign(size, kNone);
  }
  // No point of the same side is nearer than the distance.
  bool isFree(const Vec3& p, const Vec3& normal) const {
    return !any(p, [&](std::uint32_t n) {
      const Vec3 d = points_[n] - p;
      return dot(d, d) < distance_ * distance_ && dot(normals_[n], normal) > kSameSide;
    });
  }
  bool isCovered(const Vec3& p, const Vec3& face_normal) const {
    return any(p, [&](std::uint32_t n) {
      const Vec3 d = points_[n] - p;
      const double cosine = dot(normals_[n], face_normal), along = dot(d, normals_[n]) / cosine;
      if (!(cosine > kSameSide && std::fabs(along) < kOffSurface * distance_)) return false;
      const Vec3 beside = along * face_normal - d;
      return dot(beside, beside) < square(kCovered * distance_);
    });
  }
  void add(const Vec3& p, const Vec3& normal) {
    std::uint32_t& head = head_[slot(cellOf(p))];
    next_.push_back(head);
    head = static_cast<std::uint32_t>(points_.size());
    points_.push_back(p);
    normals_.push_back(normal);
  }

 private:
  static constexpr std::uint32_t kNone = 0xffffffffu;
  // Whether a point of the cells about `p` passes.
  template <class Test>
  bool any(const Vec3& p, const Test& test) const {
    const auto cell = cellOf(p);
    // Its own cell first: most candidates meet their neighbour there.
    for (const int k : {0, -1, 1})
      for (const int j : {0, -1, 1})
        for (const int i : {0, -1, 1})
          for (std::uint32_t n = head_[slot({cell[0] + i, cell[1] + j, cell[2] + k})]; n != kNone; n = next_[n])
            if (test(n)) return true;
    return false;
  }
  std::array<std::int64_t, 3> cellOf(const Vec3& p) const {
    return {static_cast<std::int64_t>(std::floor(p.x / distance_)),
            static_cast<std::int64_t>(std::floor(p.y / distance_)),
            static_cast<std::int64_t>(std::floor(p.z / distance_))};
  }
  std::size_t slot(const std::array<std::int64_t, 3>& cell) const {
    std::uint64_t h = static_cast<std::uint64_t>(cell[0]) * 0x9e3779b97f4a7c15u;
    h = (h ^ (h >> 32) ^ static_cast<std::uint64_t>(cell[1])) * 0xbf58476d1ce4e5b9u;
    h = (h ^ (h >> 32) ^ static_cast<std::uint64_t>(cell[2])) * 0x94d049bb133111ebu;
    return static_cast<std::size_t>(h ^ (h >> 29)) & (head_.size() - 1);
  }
  double distance_;
  std::vector<std::uint32_t> head_, next_;
  std::vector<Vec3> points_, normals_;
};

// Calls visit(b1, b2) for the lattice over a triangle with corners `p`: rows along the longest edge, at most `step`
// apart.
template <class Visit>
void visitLattice(const std::array<Vec3, 3>& p, double step, const Visit& visit) {
  int base = 0;  // the longest edge runs from this corner to the next; the feet of the other corner's heights lie on it
  for (int k = 1; k < 3; ++k)
    if (length(p[(k + 1) % 3] - p[k]) > length(p[(base + 1) % 3] - p[base])) base = k;
  const Vec3 edge = p[(base + 1) % 3] - p[base], side = p[(base + 2) % 3] - p[base];
  const double longest = length(edge), height = length(cross(edge, side)) / longest;
  const auto rows = static_cast<std::size_t>(std::ceil(height / step));
  for (std::size_t r = 0; r <= rows; ++r) {
    const double up = rows > 0 ? static_cast<double>(r) / static_cast<double>(rows) : 0;
    const auto columns = static_cast<std::size_t>(std::ceil((1 - up) * longest / step));
    for (std::size_t c = 0; c <= columns; ++c) {
      const double along = columns > 0 ? (1 - up) * static_cast<double>(c) / static_cast<double>(columns) : 0;
      double weight[3];
      weight[base] = 1 - up - along, weight[(base + 1) % 3] = along, weight[(base + 2) % 3] = up;
      visit(weight[1], weight[2]);
    }
  }
}

}  // namespace

SurfaceSamples sampleSurface(const AcquisitionMesh& mesh, std::size_t count, Reporter& reporter) {
  SRF_CHECK(count > 0 && mesh.normals.size() == mesh.positions.size());
  std::vector<double> area_before(mesh.triangles.size() + 1, 0);
  for (std::size_t t = 0; t < mesh.triangles.size(); ++t) {
    const auto& [a, b, c] = mesh.triangles[t];
    const double twice = length(cross(mesh.positions[b] - mesh.positions[a], mesh.positions[c] - mesh.positions[a]));
    area_before[t + 1] = area_before[t] + 0.5 * twice;
  }
  const double area = area_before.back();
  SRF_CHECK(area > 0);
  const double spacing = std::sqrt(kDensity * area / static_cast<double>(count));
  const Vec3 corner = mesh.bounds().min;  // the grid counts from here: cells stay small numbers far from the origin
  const auto faceNormal = [&mesh](std::size_t t) {
    const auto& [a, b, c] = mesh.triangles[t];
    return normalize(cross(mesh.positions[b] - mesh.positions[a], mesh.positions[c] - mesh.positions[a]));
  };
  // The point is made from the rounded weights, so that anchor and point agree.
  const auto candidate = [&](std::size_t t, double b1, double b2) {
    const std::array<float, 2> b{std::max(0.f, static_cast<float>(b1)), std::max(0.f, static_cast<float>(b2))};
    const auto& [c0, c1, c2] = mesh.triangles[t];
    const Point<AcquisitionSpace>& p = mesh.positions[c0];
    const auto face = faceNormal(t);
    const auto smooth =
        normalize((1.0 - b[0] - b[1]) * mesh.normals[c0] + b[0] * mesh.normals[c1] + b[1] * mesh.normals[c2]);
    const bool sharp = face && !(smooth && dot(*smooth, *face) > kSharpCosine);
    return Candidate{p + (double{b[0]} * (mesh.positions[c1] - p) + double{b[1]} * (mesh.positions[c2] - p)),
                     static_cast<std::uint32_t>(t), b, (sharp ? *face : smooth.value_or(mesh.normals[c0])).raw()};
  };

  SurfaceSamples samples;
  samples.radius = kRadius * spacing;
  Neighbours neighbours(spacing, count);
  const auto keep = [&](const Candidate& c) {
    neighbours.add(c.point.raw() - corner, c.normal);
    samples.points.push_back(c.point);
    samples.normals.push_back(Direction<AcquisitionSpace>::fromUnit(c.normal));
    samples.triangle.push_back(c.triangle);
    samples.weights.push_back(c.weights);
  };
  Reporter::Stage stage(reporter, "surfels", kRounds + 1);
  std::vector<Candidate> candidates(count);
  for (std::size_t round = 0; round < kRounds; ++round) {
    parallelFor(count, 4096, [&](std::size_t begin, std::size_t end) {
      for (std::size_t i = begin; i < end; ++i) {
        const std::uint64_t counter = 3 * (round * count + i);
        const auto above = std::upper_bound(area_before.begin() + 1, area_before.end() - 1, area * uniform(counter));
        const double root = std::sqrt(uniform(counter + 1));
        candidates[i] =
            candidate(static_cast<std::size_t>(above - area_before.begin() - 1), root * uniform(counter + 2), 1 - root);
      }
    });
    for (const Candidate& c : candidates)
      if (neighbours.isFree(c.point.raw() - corner, c.normal)) keep(c);
    stage.advance();
  }
  for (std::size_t t = 0; t < mesh.triangles.size(); ++t) {
    if (t % 4096 == 0) throwIfInterrupted();
    if (!(area_before[t + 1] > area_before[t])) continue;
    const auto face = faceNormal(t);
    if (!face) continue;
    const auto& [a, b, c] = mesh.triangles[t];
    visitLattice({mesh.positions[a].raw(), mesh.positions[b].raw(), mesh.positions[c].raw()}, kLattice * spacing,
                 [&](double b1, double b2) {
                   const Candidate c = candidate(t, b1, b2);
                   if (!neighbours.isCovered(c.point.raw() - corner, face->raw())) keep(c);
                 });
  }
  stage.advance();

  return samples;
}

}  // namespace srf
