#include "base/mesh.h"

#include <algorithm>
#include <numeric>
#include <unordered_set>
#include <utility>

#include "base/parallel.h"

namespace srf {
namespace {

// Disjoint sets by path halving; the smaller index is the root, so that results do not depend on the order of unions.
class DisjointSets {
 public:
  explicit DisjointSets(std::size_t size) : parent_(size) { std::iota(parent_.begin(), parent_.end(), 0u); }
  std::uint32_t root(std::uint32_t i) {
    while (parent_[i] != i) i = parent_[i] = parent_[parent_[i]];
    return i;
  }
  void unite(std::uint32_t a, std::uint32_t b) {
    a = root(a), b = root(b);
    if (a != b) parent_[std::max(a, b)] = std::min(a, b);
  }

 private:
  std::vector<std::uint32_t> parent_;
};

// One side of a triangle, filed under its two vertices in rising order.
struct HalfEdge {
  std::uint64_t vertices;
  std::uint32_t corner;  // 3 * triangle + index of the corner where it starts
  bool forward;          // runs from the smaller to the larger vertex
};

Vec3 areaVector(const AcquisitionMesh& mesh, const Triangle& t) {
  const Vec3 a = mesh.positions[t[0]].raw();
  return cross(mesh.positions[t[1]].raw() - a, mesh.positions[t[2]].raw() - a);
}

}  // namespace

VertexCorners::VertexCorners(const AcquisitionMesh& mesh)
    : first_(mesh.positions.size() + 1, 0), corners_(3 * mesh.triangles.size()) {
  for (const Triangle& t : mesh.triangles)
    for (const std::uint32_t v : t) ++first_[v + 1];
  for (std::size_t v = 1; v < first_.size(); ++v) first_[v] += first_[v - 1];
  std::vector<std::uint32_t> next(first_.begin(), first_.end() - 1);
  for (std::uint32_t i = 0; i < mesh.triangles.size(); ++i)
    for (std::uint32_t k = 0; k < 3; ++k) corners_[next[mesh.triangles[i][k]]++] = 3 * i + k;
}

std::vector<Direction<AcquisitionSpace>> vertexNormals(const AcquisitionMesh& mesh) {
  const VertexCorners corners(mesh);
  std::vector<Direction<AcquisitionSpace>> normals(mesh.positions.size());
  parallelFor(normals.size(), 4096, [&](std::size_t begin, std::size_t end) {
    for (std::size_t v = begin; v < end; ++v) {
      Vector<AcquisitionSpace> sum;
      for (const std::uint32_t corner : corners.at(v)) {
        const Triangle& t = mesh.triangles[corner / 3];
        const Vec3 area = areaVector(mesh, t);
        const double size = length(area);
        if (!(size > 0) || !std::isfinite(size)) continue;
        const Vec3 here = mesh.positions[v].raw();
        const Vec3 to_next = mesh.positions[t[(corner + 1) % 3]].raw() - here;
        const Vec3 to_last = mesh.positions[t[(corner + 2) % 3]].raw() - here;
        sum += Vector<AcquisitionSpace>((std::atan2(size, dot(to_next, to_last)) / size) * area);
      }
      normals[v] = normalize(sum).value_or(Direction<AcquisitionSpace>());
    }
  });
  return normals;
}

MeshTopology meshTopology(const AcquisitionMesh& mesh) {
  MeshTopology topology;
  const std::size_t triangle_count = mesh.triangles.size();
  if (triangle_count == 0) return topology;

  std::vector<HalfEdge> edges;
  edges.reserve(3 * triangle_count);
  std::vector<bool> used(mesh.positions.size(), false);
  DisjointSets parts(mesh.positions.size());
  topology.manifold = topology.closed = topology.oriented = true;
  for (std::uint32_t i = 0; i < triangle_count; ++i) {
    const Triangle& t = mesh.triangles[i];
    if (t[0] == t[1] || t[1] == t[2] || t[2] == t[0]) topology.manifold = false;
    for (std::uint32_t k = 0; k < 3; ++k) {
      const std::uint32_t a = t[k], b = t[(k + 1) % 3];
      used[a] = true;
      parts.unite(a, b);
      edges.push_back({std::uint64_t{std::min(a, b)} << 32 | std::max(a, b), 3 * i + k, a < b});
    }
  }
  std::sort(edges.begin(), edges.end(), [](const HalfEdge& x, const HalfEdge& y) {
    return x.vertices != y.vertices ? x.vertices < y.vertices : x.corner < y.corner;
  });

  // The corners at a vertex that are joined across edges form its fans.
  DisjointSets fans(3 * triangle_count);
  const auto cornerAt = [&](const HalfEdge& edge, std::uint32_t vertex) {
    const Triangle& t = mesh.triangles[edge.corner / 3];
    return edge.corner / 3 * 3 + static_cast<std::uint32_t>(std::find(t.begin(), t.end(), vertex) - t.begin());
  };
  long edge_count = 0;
  for (std::size_t begin = 0, end; begin < edges.size(); begin = end) {
    end = begin + 1;
    while (end < edges.size() && edges[end].vertices == edges[begin].vertices) ++end;
    ++edge_count;
    if (end - begin != 2) topology.closed = false;
    if (end - begin > 2) topology.manifold = false;
    for (std::size_t i = begin + 1; i < end; ++i) {
      if (edges[i].forward == edges[i - 1].forward) topology.oriented = false;
      for (const std::uint64_t vertex : {edges[i].vertices >> 32, edges[i].vertices & 0xffffffffu})
        fans.unite(cornerAt(edges[i], static_cast<std::uint32_t>(vertex)),
                   cornerAt(edges[i - 1], static_cast<std::uint32_t>(vertex)));
    }
  }
  long vertex_count = 0, fan_count = 0;
  for (std::uint32_t v = 0; v < used.size(); ++v) {
    if (!used[v]) continue;
    ++vertex_count;
    topology.components += parts.root(v) == v;
  }
  for (std::uint32_t corner = 0; corner < 3 * triangle_count; ++corner) fan_count += fans.root(corner) == corner;
  if (fan_count != vertex_count) topology.manifold = false;
  topology.euler_characteristic = vertex_count - edge_count + static_cast<long>(triangle_count);
  return topology;
}

std::vector<std::uint32_t> vertexComponents(const AcquisitionMesh& mesh) {
  DisjointSets parts(mesh.positions.size());
  for (const Triangle& t : mesh.triangles) parts.unite(t[0], t[1]), parts.unite(t[1], t[2]);
  std::vector<std::uint32_t> component(mesh.positions.size());
  std::uint32_t count = 0;
  for (std::uint32_t v = 0; v < component.size(); ++v)
    component[v] = parts.root(v) == v ? count++ : component[parts.root(v)];
  return component;
}

double meshVolume(const AcquisitionMesh& mesh) {
  if (mesh.triangles.empty()) return 0;
  const Vec3 center = mesh.bounds().center().raw();  // the tetrahedra meet here: far from the origin nothing is lost
  double sum = 0;
  for (const Triangle& t : mesh.triangles)
    sum += dot(mesh.positions[t[0]].raw() - center,
               cross(mesh.positions[t[1]].raw() - center, mesh.positions[t[2]].raw() - center));
  return sum / 6;
}

double meshArea(const AcquisitionMesh& mesh) {
  double sum = 0;
  for (const Triangle& t : mesh.triangles) sum += 0.5 * length(areaVector(mesh, t));
  return sum;
}

AcquisitionMesh smoothed(const AcquisitionMesh& mesh, int steps) {
  constexpr double kShrink = 0.5, kGrow = -0.53;
  constexpr std::size_t kGrain = 4096;
  // The neighbours of each vertex, each once, in runs as the loops take them.
  struct Run {
    std::vector<std::uint32_t> neighbours, end;
  };
  const std::size_t count = mesh.positions.size();
  std::vector<Run> runs((count + kGrain - 1) / kGrain);
  const VertexCorners corners(mesh);
  parallelFor(count, kGrain, [&](std::size_t begin, std::size_t end) {
    auto& [neighbours, ends] = runs[begin / kGrain];
    for (std::size_t v = begin; v < end; ++v) {
      const std::size_t first = neighbours.size();
      for (const std::uint32_t corner : corners.at(v))
        for (const std::uint32_t other : mesh.triangles[corner / 3])
          if (other != v && std::find(neighbours.begin() + first, neighbours.end(), other) == neighbours.end())
            neighbours.push_back(other);
      ends.push_back(static_cast<std::uint32_t>(neighbours.size()));
    }
  });
  AcquisitionMesh result{mesh.positions, mesh.triangles, {}};
  std::vector<Point<AcquisitionSpace>> from(count);
  for (int half_step = 0; half_step < 2 * steps; ++half_step) {
    std::swap(from, result.positions);
    const double weight = half_step % 2 == 0 ? kShrink : kGrow;
    parallelFor(count, kGrain, [&](std::size_t begin, std::size_t end) {
      const Run& run = runs[begin / kGrain];
      std::uint32_t k = 0;
      for (std::size_t v = begin; v < end; ++v) {
        const std::uint32_t first = k, last = run.end[v - begin];
        Vector<AcquisitionSpace> sum;
        for (; k < last; ++k) sum += from[run.neighbours[k]] - from[v];
        result.positions[v] = first == last ? from[v] : from[v] + weight / (last - first) * sum;
      }
    });
  }
  return result;
}

MeshRepair cleanMesh(AcquisitionMesh& mesh) {
  MeshRepair repair;
  struct Hash {
    std::size_t operator()(const Triangle& t) const {
      return (t[0] * 0x9e3779b97f4a7c15u ^ t[1]) * 0xc2b2ae3d27d4eb4fu ^ t[2];
    }
  };
  std::unordered_set<Triangle, Hash> seen;
  seen.reserve(mesh.triangles.size());
  std::vector<Triangle> kept;
  kept.reserve(mesh.triangles.size());
  for (const Triangle& t : mesh.triangles) {
    if (!isFinite(mesh.positions[t[0]]) || !isFinite(mesh.positions[t[1]]) || !isFinite(mesh.positions[t[2]])) {
      ++repair.not_finite;
    } else if (t[0] == t[1] || t[1] == t[2] || t[2] == t[0] || !(length(areaVector(mesh, t)) > 0)) {
      ++repair.degenerate;
    } else {
      Triangle turned = t;  // the same corners in the same or the other sense are one triangle
      std::sort(turned.begin(), turned.end());
      if (seen.insert(turned).second)
        kept.push_back(t);
      else
        ++repair.duplicate;
    }
  }
  constexpr std::uint32_t kUnused = 0xffffffffu;
  std::vector<std::uint32_t> renumbered(mesh.positions.size(), kUnused);
  for (const Triangle& t : kept)
    for (const std::uint32_t v : t) renumbered[v] = 0;
  std::uint32_t next = 0;
  for (std::size_t v = 0; v < renumbered.size(); ++v) {
    if (renumbered[v] == kUnused) continue;
    mesh.positions[next] = mesh.positions[v];
    if (!mesh.normals.empty()) mesh.normals[next] = mesh.normals[v];
    renumbered[v] = next++;
  }
  repair.unused_vertices = mesh.positions.size() - next;
  mesh.positions.resize(next);
  if (!mesh.normals.empty()) mesh.normals.resize(next);
  for (Triangle& t : kept)
    for (std::uint32_t& v : t) v = renumbered[v];
  mesh.triangles = std::move(kept);
  return repair;
}

}  // namespace srf
