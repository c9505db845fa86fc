#include "model/surface_sampling.h"

#include <algorithm>
#include <cmath>

#include "base/check.h"
#include "base/parallel.h"

// Dart throwing (Cook 1986) on a hash grid: candidates in a fixed pseudo-random order, each kept unless a kept one is
// too near.

namespace srf {
namespace {

// Candidates for each sample asked for. More of them fill the last gaps and cost time.
constexpr std::size_t kCandidates = 16;
// Samples times distance^2 over area once that many darts are thrown (measured; the limit of endless darts is 0.697).
constexpr double kDensity = 0.6;
// Radius of the discs in distances between samples: 1 would do if every place had been tried; the rest is for the gaps
// between candidates and for discs that lie askew on a curved surface.
constexpr double kRadius = 1.15;
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
};

// Kept points by the cell of a grid, in a hash table with chains.
class Neighbours {
 public:
  Neighbours(double distance, std::size_t count) : distance_(distance) {
    std::size_t size = 64;
    while (size < 2 * count) size *= 2;
    head_.assign(size, kNone);
  }
  bool isFree(const Vec3& p) const {
    const auto cell = cellOf(p);
    // Its own cell first: most candidates meet their neighbour there.
    for (const int k : {0, -1, 1})
      for (const int j : {0, -1, 1})
        for (const int i : {0, -1, 1})
          for (std::uint32_t n = head_[slot({cell[0] + i, cell[1] + j, cell[2] + k})]; n != kNone; n = next_[n]) {
            const Vec3 d = points_[n] - p;
            if (dot(d, d) < distance_ * distance_) return false;
          }
    return true;
  }
  void add(const Vec3& p) {
    std::uint32_t& head = head_[slot(cellOf(p))];
    next_.push_back(head);
    head = static_cast<std::uint32_t>(points_.size());
    points_.push_back(p);
  }

 private:
  static constexpr std::uint32_t kNone = 0xffffffffu;
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
  std::vector<Vec3> points_;
};

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

  SurfaceSamples samples;
  samples.radius = kRadius * spacing;
  Neighbours neighbours(spacing, count);
  Reporter::Stage stage(reporter, "surfels", kCandidates);
  std::vector<Candidate> candidates(count);
  for (std::size_t round = 0; round < kCandidates; ++round) {
    parallelFor(count, 4096, [&](std::size_t begin, std::size_t end) {
      for (std::size_t i = begin; i < end; ++i) {
        const std::uint64_t counter = 3 * (round * count + i);
        const auto above = std::upper_bound(area_before.begin() + 1, area_before.end() - 1, area * uniform(counter));
        const auto t = static_cast<std::uint32_t>(above - area_before.begin() - 1);
        const double root = std::sqrt(uniform(counter + 1));
        // The point is made from the rounded weights, so that anchor and point agree.
        const std::array<float, 2> b{static_cast<float>(root * uniform(counter + 2)), static_cast<float>(1 - root)};
        const auto& [c0, c1, c2] = mesh.triangles[t];
        const Point<AcquisitionSpace>& p = mesh.positions[c0];
        candidates[i] = {p + (double{b[0]} * (mesh.positions[c1] - p) + double{b[1]} * (mesh.positions[c2] - p)), t, b};
      }
    });
    for (const Candidate& c : candidates) {
      const Vec3 local = c.point.raw() - corner;
      if (!neighbours.isFree(local)) continue;
      neighbours.add(local);
      samples.points.push_back(c.point);
      samples.triangle.push_back(c.triangle);
      samples.weights.push_back(c.weights);
    }
    stage.advance();
  }

  samples.normals.resize(samples.points.size());
  for (std::size_t i = 0; i < samples.points.size(); ++i) {
    const auto& [a, b, c] = mesh.triangles[samples.triangle[i]];
    const auto [b1, b2] = samples.weights[i];
    const auto face = normalize(cross(mesh.positions[b] - mesh.positions[a], mesh.positions[c] - mesh.positions[a]));
    const auto smooth = normalize((1.0 - b1 - b2) * mesh.normals[a] + b1 * mesh.normals[b] + b2 * mesh.normals[c]);
    const bool sharp = face && !(smooth && dot(*smooth, *face) > kSharpCosine);
    samples.normals[i] = sharp ? *face : smooth.value_or(mesh.normals[a]);
  }
  return samples;
}

}  // namespace srf
