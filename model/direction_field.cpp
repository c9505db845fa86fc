#include "model/direction_field.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <utility>

#include "base/numeric.h"

namespace srf {
namespace {

// Rounds of averaging at each level: many where they cost little, since there far places come to agree.
constexpr std::size_t kFewestRounds = 8, kMostRounds = 300, kVisits = 4'000'000;
constexpr std::size_t kCoarsest = 100;  // nodes; fewer are not joined further
constexpr double kOpposite = 1e-9;      // 1 + cosine below which the shortest turn is not known
constexpr double kNoTangent = 1e-9;     // of the longest: too short to have a direction

// A surface as nodes that know their neighbours: its vertices, or groups of them.
struct Level {
  std::vector<Vec3> normal;
  std::vector<std::uint32_t> first, neighbour;  // of node i: neighbour[first[i] .. first[i + 1])
  std::vector<std::uint32_t> group;             // of node i at the next coarser level; empty at the coarsest
};

// Edges as pairs of nodes; those that occur twice and those from a node to itself are dropped.
void joinByEdges(Level& level, std::vector<std::pair<std::uint32_t, std::uint32_t>> edges) {
  std::sort(edges.begin(), edges.end());
  edges.erase(std::unique(edges.begin(), edges.end()), edges.end());
  level.first.assign(level.normal.size() + 1, 0);
  level.neighbour.reserve(edges.size());
  for (const auto& [from, to] : edges) {
    if (from == to) continue;
    ++level.first[from + 1];
    level.neighbour.push_back(to);
  }
  for (std::size_t i = 1; i < level.first.size(); ++i) level.first[i] += level.first[i - 1];
}

Level finest(const AcquisitionMesh& mesh) {
  Level level;
  for (const auto& n : mesh.normals) level.normal.push_back(n.raw());
  std::vector<std::pair<std::uint32_t, std::uint32_t>> edges;
  edges.reserve(6 * mesh.triangles.size());
  for (const auto& [a, b, c] : mesh.triangles)
    for (const auto& [from, to] : {std::pair{a, b}, {a, c}, {b, a}, {b, c}, {c, a}, {c, b}})
      edges.push_back({from, to});
  joinByEdges(level, std::move(edges));
  return level;
}

// Each node joins the neighbour whose normal is most like its own among those that are still alone.
Level coarser(Level& fine) {
  constexpr std::uint32_t kAlone = ~0u;
  const std::size_t count = fine.normal.size();
  Level coarse;
  fine.group.assign(count, kAlone);
  for (std::uint32_t i = 0; i < count; ++i) {
    if (fine.group[i] != kAlone) continue;
    std::uint32_t best = kAlone;
    double most = 0;  // never around an edge of 90 degrees or more
    for (std::uint32_t k = fine.first[i]; k < fine.first[i + 1]; ++k) {
      const std::uint32_t j = fine.neighbour[k];
      const double likeness = dot(fine.normal[i], fine.normal[j]);
      if (fine.group[j] == kAlone && likeness > most) best = j, most = likeness;
    }
    const auto index = static_cast<std::uint32_t>(coarse.normal.size());
    fine.group[i] = index;
    Vec3 sum = fine.normal[i];
    if (best != kAlone) fine.group[best] = index, sum += fine.normal[best];
    coarse.normal.push_back(sum / length(sum));
  }
  std::vector<std::pair<std::uint32_t, std::uint32_t>> edges;
  edges.reserve(fine.neighbour.size());
  for (std::size_t i = 0; i < count; ++i)
    for (std::uint32_t k = fine.first[i]; k < fine.first[i + 1]; ++k)
      edges.push_back({fine.group[i], fine.group[fine.neighbour[k]]});
  joinByEdges(coarse, std::move(edges));
  return coarse;
}

// Each node's vector becomes the mean of its own and its neighbours', one node after the other. Lengths stay as they
// come: short about a point where the field turns round, so that two which turn against each other cancel out. So it
// tends to the smoothest field of all (Knoeppel et al., Globally Optimal Direction Fields, 2013).
void average(const Level& level, std::vector<Vec3>& u) {
  const std::size_t rounds =
      std::clamp(kVisits / std::max<std::size_t>(1, level.neighbour.size()), kFewestRounds, kMostRounds);
  for (std::size_t round = 0; round < rounds; ++round) {
    double longest = 0;
    for (std::size_t i = 0; i < u.size(); ++i) {
      Vec3 sum = u[i];
      for (std::uint32_t k = level.first[i]; k < level.first[i + 1]; ++k) {
        const std::uint32_t j = level.neighbour[k];
        sum += carriedTangent(u[j], level.normal[j], level.normal[i]);
      }
      u[i] = (sum - dot(sum, level.normal[i]) * level.normal[i]) / (1.0 + level.first[i + 1] - level.first[i]);
      longest = std::max(longest, length(u[i]));
    }
    if (longest > 0)
      for (Vec3& v : u) v = v / longest;
  }
}

}  // namespace

Vec3 carriedTangent(const Vec3& tangent, const Vec3& from, const Vec3& to) {
  const double across = 1 + dot(from, to);
  if (across < kOpposite) return tangent;
  return tangent - (dot(tangent, to) / across) * (from + to);
}

std::vector<Direction<AcquisitionSpace>> smoothDirections(const AcquisitionMesh& mesh) {
  std::vector<Level> levels{finest(mesh)};
  while (levels.back().normal.size() > kCoarsest) {
    Level next = coarser(levels.back());
    const bool stuck = next.normal.size() > 0.95 * static_cast<double>(levels.back().normal.size());
    if (stuck) {
      levels.back().group.clear();
      break;
    }
    levels.push_back(std::move(next));
  }
  std::vector<Vec3> u;
  for (const Vec3& n : levels.back().normal)
    u.push_back(anyPerpendicular(Direction<AcquisitionSpace>::fromUnit(n)).raw());
  average(levels.back(), u);
  for (std::size_t k = levels.size() - 1; k-- > 0;) {
    const Level &fine = levels[k], &coarse = levels[k + 1];
    std::vector<Vec3> finer(fine.normal.size());
    for (std::size_t i = 0; i < finer.size(); ++i) {
      const std::uint32_t group = fine.group[i];
      finer[i] = carriedTangent(u[group], coarse.normal[group], fine.normal[i]);
    }
    u = std::move(finer);
    average(fine, u);
  }
  std::vector<Direction<AcquisitionSpace>> result;
  result.reserve(u.size());
  for (std::size_t i = 0; i < u.size(); ++i) {
    const double size = length(u[i]);
    result.push_back(size > kNoTangent ? Direction<AcquisitionSpace>::fromUnit(u[i] / size)
                                       : anyPerpendicular(mesh.normals[i]));
  }
  return result;
}

}  // namespace srf
