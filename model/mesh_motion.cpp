#include "model/mesh_motion.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <mutex>
#include <numeric>
#include <utility>

#include "base/check.h"
#include "base/error.h"
#include "base/mesh_io.h"

namespace srf {
namespace {

// Signed volume of each part about the mean of its vertices, so that none is lost far from the origin.
template <class Space>
std::vector<double> partVolumes(const std::vector<Point<Space>>& positions, const std::vector<Triangle>& triangles,
                                const std::vector<std::uint32_t>& part_of_vertex, std::size_t parts) {
  std::vector<Vec3> center(parts);
  std::vector<std::size_t> members(parts, 0);
  for (std::size_t i = 0; i < positions.size(); ++i) {
    center[part_of_vertex[i]] += positions[i].raw();
    ++members[part_of_vertex[i]];
  }
  for (std::size_t p = 0; p < parts; ++p) center[p] = center[p] / static_cast<double>(members[p]);
  std::vector<double> volume(parts, 0);
  for (const auto& [a, b, c] : triangles) {
    const std::uint32_t part = part_of_vertex[a];
    const Vec3& o = center[part];
    volume[part] += dot(positions[a].raw() - o, cross(positions[b].raw() - o, positions[c].raw() - o)) / 6;
  }
  return volume;
}

// F = [e1* e2* n*][e1 e2 n]^-1 (M8). The moved normal is stretched as the triangle's size is, so that a uniform scaling
// gives exactly that scaling, and points outwards also where the part was mirrored.
Mat3 gradientOf(const Vec3& e1, const Vec3& e2, const Vec3& moved_e1, const Vec3& moved_e2, int handedness) {
  const Vec3 n = cross(e1, e2), moved_n = handedness * cross(moved_e1, moved_e2);
  const double twice = length(n), moved_twice = length(moved_n);
  // |n| = 1 at rest, sqrt(area* / area) moved; a triangle squeezed to nothing keeps no normal.
  const Vec3 stretched = moved_twice > 0 ? moved_n / std::sqrt(moved_twice * twice) : Vec3{};
  return Mat3::fromColumns(moved_e1, moved_e2, stretched) * inverse(Mat3::fromColumns(e1, e2, n / twice));
}

// The last run of # in the name becomes the frame, filled with zeros.
std::string fileOfFrame(std::string file, int frame) {
  const std::size_t last = file.find_last_of('#'), before = file.find_last_not_of('#', last);
  const std::size_t first = before == std::string::npos ? 0 : before + 1;
  std::string digits = std::to_string(std::abs(frame));
  if (digits.size() < last - first + 1) digits.insert(0, last - first + 1 - digits.size(), '0');
  return file.replace(first, last - first + 1, (frame < 0 ? "-" : "") + digits);
}

class Sequence final : public VertexMotion {
 public:
  Sequence(const std::string& pattern, const AcquisitionMesh& rest, const std::string& where)
      : pattern_(pattern), where_(where), rest_(rest) {}
  MovedVertices at(double frame) const override {
    const double whole = std::floor(frame), part = frame - whole;
    MovedVertices moved{*positions(static_cast<int>(whole)), {}};
    if (part == 0) return moved;
    const auto next = positions(static_cast<int>(whole) + 1);
    for (std::size_t i = 0; i < next->size(); ++i)
      moved.positions[i] = moved.positions[i] + part * ((*next)[i] - moved.positions[i]);
    return moved;
  }

 private:
  using Positions = std::shared_ptr<const std::vector<Point<ObjectSpace>>>;
  /// The last two frames stay: moments of one shutter mostly lie between the same ones.
  Positions positions(int frame) const {
    const std::lock_guard lock(mutex_);
    for (auto& kept : kept_)
      if (kept.second && kept.first == frame) return kept.second;
    std::swap(kept_[0], kept_[1]);
    kept_[0] = {frame, read(frame)};
    return kept_[0].second;
  }
  Positions read(int frame) const {
    const std::string file = fileOfFrame(pattern_, frame);
    if (!std::filesystem::is_regular_file(file))
      throw badInput(where_, "the file '" + file + "' of frame " + std::to_string(frame) +
                                 " does not exist; a sequence has one for each frame that is rendered");
    const AcquisitionMesh mesh = readMesh(file);
    const auto different = [&file](const std::string& what, std::size_t found, std::size_t expected) {
      return badInput(file, "has " + std::to_string(found) + " " + what + ", the model's rest mesh has " +
                                std::to_string(expected) + "; a sequence keeps the mesh that the model was made from");
    };
    if (mesh.positions.size() != rest_.positions.size())
      throw different("vertices", mesh.positions.size(), rest_.positions.size());
    if (mesh.triangles.size() != rest_.triangles.size())
      throw different("triangles", mesh.triangles.size(), rest_.triangles.size());
    for (std::size_t t = 0; t < mesh.triangles.size(); ++t) {
      // The rest mesh may have been turned outwards: the corners count, not their order.
      Triangle a = mesh.triangles[t], b = rest_.triangles[t];
      std::sort(a.begin(), a.end());
      std::sort(b.begin(), b.end());
      if (a == b) continue;
      const auto corners = [](const Triangle& c) {
        return std::to_string(c[0]) + " " + std::to_string(c[1]) + " " + std::to_string(c[2]);
      };
      throw badInput(file, "triangle " + std::to_string(t) + " joins vertices " + corners(mesh.triangles[t]) +
                               ", in the model's rest mesh " + corners(rest_.triangles[t]) +
                               "; a sequence keeps the mesh that the model was made from");
    }
    std::vector<Point<ObjectSpace>> positions(mesh.positions.size());
    for (std::size_t i = 0; i < positions.size(); ++i) positions[i] = Point<ObjectSpace>(mesh.positions[i].raw());
    return std::make_shared<const std::vector<Point<ObjectSpace>>>(std::move(positions));
  }
  std::string pattern_, where_;
  AcquisitionMesh rest_;
  mutable std::mutex mutex_;
  mutable std::array<std::pair<int, Positions>, 2> kept_;
};

}  // namespace

std::unique_ptr<const VertexMotion> sequenceMotion(const std::string& pattern, const AcquisitionMesh& rest,
                                                   const std::string& where) {
  return std::make_unique<Sequence>(pattern, rest, where);
}

MeshParts meshParts(const AcquisitionMesh& rest) {
  const std::size_t count = rest.positions.size();
  std::vector<std::uint32_t> parent(count);
  std::iota(parent.begin(), parent.end(), 0u);
  const auto root = [&parent](std::uint32_t i) {
    while (parent[i] != i) i = parent[i] = parent[parent[i]];
    return i;
  };
  std::vector<std::array<std::uint32_t, 2>> edges;
  edges.reserve(3 * rest.triangles.size());
  for (const Triangle& t : rest.triangles)
    for (int k = 0; k < 3; ++k) {
      const std::uint32_t a = t[k], b = t[(k + 1) % 3];
      edges.push_back({std::min(a, b), std::max(a, b)});
      const std::uint32_t ra = root(a), rb = root(b);
      parent[std::max(ra, rb)] = std::min(ra, rb);
    }
  MeshParts parts;
  parts.part_of_vertex.resize(count);
  for (std::uint32_t i = 0; i < count; ++i) {
    if (root(i) == i) {  // roots are the least of their part, so they come first
      parts.part_of_vertex[i] = static_cast<std::uint32_t>(parts.closed.size());
      parts.closed.push_back(1);
    } else {
      parts.part_of_vertex[i] = parts.part_of_vertex[root(i)];
    }
  }
  std::sort(edges.begin(), edges.end());
  for (std::size_t i = 0; i < edges.size();) {
    std::size_t end = i;
    while (end < edges.size() && edges[end] == edges[i]) ++end;
    if (end - i != 2) parts.closed[parts.part_of_vertex[edges[i][0]]] = 0;
    i = end;
  }
  parts.volume = partVolumes(rest.positions, rest.triangles, parts.part_of_vertex, parts.closed.size());
  return parts;
}

namespace {

// M8: the sign of each closed part's volume against rest.
void handednessByVolume(const AcquisitionMesh& rest, const MeshParts& parts,
                        const std::vector<Point<ObjectSpace>>& moved, MeshMotion& motion) {
  motion.handedness.assign(moved.size(), 1);
  const std::vector<double> volume = partVolumes(moved, rest.triangles, parts.part_of_vertex, parts.closed.size());
  for (std::size_t i = 0; i < moved.size(); ++i) {
    const std::uint32_t part = parts.part_of_vertex[i];
    if (!parts.closed[part]) {
      ++motion.unsure;
    } else if ((volume[part] < 0) != (parts.volume[part] < 0)) {
      motion.handedness[i] = -1;
    }
  }
}

}  // namespace

MeshMotion meshMotion(const AcquisitionMesh& rest, const MeshParts& parts, const MovedVertices& to) {
  const std::vector<Point<ObjectSpace>>& moved = to.positions;
  const std::size_t count = rest.positions.size();
  SRF_CHECK(moved.size() == count && parts.part_of_vertex.size() == count);
  MeshMotion motion;
  if (to.handedness.empty())
    handednessByVolume(rest, parts, moved, motion);
  else
    motion.handedness = to.handedness;
  std::vector<Mat3> sum(count, 0.0 * Mat3{});
  std::vector<double> weight(count, 0);
  for (const auto& t : rest.triangles) {
    const auto& [a, b, c] = t;
    const Vec3 e1 = (rest.positions[b] - rest.positions[a]).raw(), e2 = (rest.positions[c] - rest.positions[a]).raw();
    const double area = 0.5 * length(cross(e1, e2));
    if (!(area > 0)) continue;
    const Mat3 gradient =
        gradientOf(e1, e2, (moved[b] - moved[a]).raw(), (moved[c] - moved[a]).raw(), motion.handedness[a]);
    for (const std::uint32_t corner : t) {
      sum[corner] = sum[corner] + area * gradient;
      weight[corner] += area;
    }
  }
  motion.gradient.resize(count);
  for (std::size_t i = 0; i < count; ++i)
    motion.gradient[i] = Linear<ObjectSpace, AcquisitionSpace>((1 / weight[i]) * sum[i]);
  return motion;
}

}  // namespace srf
