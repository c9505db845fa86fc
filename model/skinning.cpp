#include "model/skinning.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numeric>
#include <optional>

#include "base/error.h"
#include "base/numeric.h"
#include "base/parallel.h"
#include "model/gltf_pose.h"

namespace srf {
namespace {

constexpr std::size_t kGrain = 512;
// Of the rest mesh's diameter: how far apart two positions may be and still be one vertex (floats keep 1e-7 of their
// size; an exporter's transforms cost a few of these), and how far copies of a vertex may move apart.
constexpr double kSamePlace = 1e-5;
constexpr double kTorn = 1e-4;
constexpr int kNeighbours = 8;  // proxy vertices that a point follows

std::string shown(const Vec3& p) {
  char text[96];
  std::snprintf(text, sizeof text, "(%.6g, %.6g, %.6g)", p.x, p.y, p.z);
  return text;
}

std::vector<Vec3> inObjectSpace(std::vector<Vec3> positions) {
  for (Vec3& p : positions) p = objectFromGltf(p);
  return positions;
}

/// Points by their place: sorted along a direction that no flat side of an object is perpendicular to.
class PlaceOrder {
 public:
  explicit PlaceOrder(const std::vector<Vec3>& points) : points_(points) {
    for (std::uint32_t i = 0; i < points.size(); ++i)
      if (isFinite(points[i])) order_.emplace_back(dot(kSlant, points[i]), i);
    std::sort(order_.begin(), order_.end());
  }
  template <class Visit>
  void near(const Vec3& p, double reach, const Visit& visit) const {
    const double along = dot(kSlant, p);
    auto it = std::lower_bound(order_.begin(), order_.end(), std::pair<double, std::uint32_t>(along - reach, 0));
    for (; it != order_.end() && it->first <= along + reach; ++it)
      if (length(points_[it->second] - p) <= reach) visit(it->second);
  }

 private:
  static constexpr Vec3 kSlant{0.5477, 0.6831, 0.4831};  // unit
  const std::vector<Vec3>& points_;
  std::vector<std::pair<double, std::uint32_t>> order_;
};

/// Of each vertex of the rest mesh: the vertices of the glTF's mesh that stand for it, at least one.
struct Partners {
  std::vector<std::uint32_t> first;  ///< one more than there are vertices
  std::vector<std::uint32_t> copies;
};

Partners gathered(std::vector<std::pair<std::uint32_t, std::uint32_t>> pairs, std::size_t count) {
  std::sort(pairs.begin(), pairs.end());
  Partners partners{std::vector<std::uint32_t>(count + 1, 0), {}};
  for (const auto& [vertex, copy] : pairs) {
    ++partners.first[vertex + 1];
    partners.copies.push_back(copy);
  }
  std::partial_sum(partners.first.begin(), partners.first.end(), partners.first.begin());
  return partners;
}

/// What a carrier of indices says, or why it says nothing.
struct Indexed {
  std::optional<Partners> partners;
  std::string fault;
};
Indexed byIndex(const std::vector<double>& carried, std::size_t count) {
  if (carried.empty()) return {std::nullopt, "absent"};
  std::vector<std::pair<std::uint32_t, std::uint32_t>> pairs;
  std::vector<bool> found(count, false);
  for (std::uint32_t i = 0; i < carried.size(); ++i) {
    const double index = carried[i];
    if (!(index >= 0 && index < static_cast<double>(count)) || index != std::floor(index)) {
      char text[64];
      std::snprintf(text, sizeof text, "%.9g", index);
      return {std::nullopt, "vertex " + std::to_string(i) + " of the glTF's mesh carries " + text};
    }
    pairs.emplace_back(static_cast<std::uint32_t>(index), i);
    found[static_cast<std::size_t>(index)] = true;
  }
  const auto missing = std::find(found.begin(), found.end(), false);
  if (missing != found.end())
    return {std::nullopt, "vertex " + std::to_string(missing - found.begin()) +
                              " of the model is carried by none of the glTF's " + std::to_string(carried.size())};
  return {gathered(std::move(pairs), count), ""};
}

/// Partners by place; nothing where a vertex has none, which `lonely` then names.
std::optional<Partners> byPlace(const AcquisitionMesh& rest, const std::vector<Vec3>& places, double reach,
                                std::size_t* lonely) {
  const std::size_t count = rest.positions.size();
  std::vector<std::pair<std::uint32_t, std::uint32_t>> pairs;
  if (places.size() == count) {
    for (std::uint32_t i = 0; i < count; ++i)
      if (length(places[i] - rest.positions[i].raw()) <= reach) pairs.emplace_back(i, i);
    if (pairs.size() == count) return gathered(std::move(pairs), count);
    pairs.clear();
  }
  const PlaceOrder order(places);
  for (std::uint32_t i = 0; i < count; ++i) {
    const std::size_t before = pairs.size();
    order.near(rest.positions[i].raw(), reach, [&](std::uint32_t copy) { pairs.emplace_back(i, copy); });
    if (pairs.size() > before) continue;
    *lonely = i;
    return std::nullopt;
  }
  return gathered(std::move(pairs), count);
}

/// The glTF's mesh at rest: as the file stands, or as it was bound; and which way round each vertex is there.
struct RestPose {
  std::vector<Vec3> positions;  ///< object space's axes
  std::vector<std::int8_t> handedness;
};

/// The glTF's mesh over the frames.
class PosedSource {
 public:
  PosedSource(const SkinSource& source, double fps) : source_(source), fps_(fps) {
    PosedMesh standing = posedMesh(*source.gltf, source.node, poseAt(*source.gltf, nullptr, 0));
    rests_[0] = {inObjectSpace(std::move(standing.positions)), std::move(standing.handedness)};
    rests_[1] = {inObjectSpace(mesh().positions), std::vector<std::int8_t>(mesh().positions.size(), 1)};
  }
  const GltfMesh& mesh() const {
    const Gltf& gltf = *source_.gltf;
    return gltf.meshes[static_cast<std::size_t>(gltf.nodes[static_cast<std::size_t>(source_.node)].mesh)];
  }
  const std::string& where() const { return source_.where; }
  std::string file() const { return source_.gltf->file.string(); }
  const std::array<RestPose, 2>& rests() const { return rests_; }
  /// Which of them the model was made from.
  void choose(const RestPose& rest) { rest_ = &rest - rests_.data(); }
  const RestPose& rest() const { return rests_[rest_]; }

  double seconds(double frame) const {
    const double time = frame / fps_;
    if (!source_.loop || !source_.animation) return time;
    double first = INFINITY, last = -INFINITY;
    for (const GltfChannel& channel : source_.animation->channels) {
      first = std::fmin(first, channel.times.front());
      last = std::fmax(last, channel.times.back());
    }
    if (!(last > first)) return time;
    const double turns = (time - first) / (last - first);
    return first + (turns - std::floor(turns)) * (last - first);
  }

  /// Positions, and whether the motion from rest mirrors: not told where morph targets alone move the mesh (M8).
  MovedVertices at(double frame) const {
    PosedMesh posed = posedMesh(*source_.gltf, source_.node, poseAt(*source_.gltf, source_.animation, seconds(frame)));
    MovedVertices moved;
    for (const Vec3& p : posed.positions) moved.positions.emplace_back(objectFromGltf(p));
    const bool skinned = source_.gltf->nodes[static_cast<std::size_t>(source_.node)].skin >= 0;
    if (!skinned && !mesh().targets.empty()) return moved;
    moved.handedness = std::move(posed.handedness);
    for (std::size_t i = 0; i < moved.handedness.size(); ++i)
      moved.handedness[i] = static_cast<std::int8_t>(moved.handedness[i] * rest().handedness[i]);
    return moved;
  }

 private:
  SkinSource source_;
  double fps_;
  std::array<RestPose, 2> rests_;
  std::ptrdiff_t rest_ = 0;
};

class MatchedSkin final : public VertexMotion {
 public:
  MatchedSkin(PosedSource source, const AcquisitionMesh& rest, Reporter& reporter)
      : source_(std::move(source)), diameter_(rest.bounds().diameter()) {
    const std::size_t count = rest.positions.size();
    const GltfMesh& mesh = source_.mesh();
    Indexed by_attribute = byIndex(mesh.srf_index, count), by_texture = byIndex(mesh.texture_index, count);
    std::string way = "_SRF_INDEX";
    if (by_attribute.partners) {
      partners_ = std::move(*by_attribute.partners);
    } else if (by_texture.partners) {
      partners_ = std::move(*by_texture.partners);
      way = "the second texture coordinate";
    } else if (!mesh.srf_index.empty()) {
      throw badInput(source_.where(), source_.file() + ": by _SRF_INDEX, " + by_attribute.fault +
                                          "; expected each of 0 to " + std::to_string(count - 1) + " (" + kMend + ")");
    } else {
      matchPlaces(rest, by_texture.fault);
      way = "place";
    }
    // The index may have come with a mesh that stands otherwise: the nearer rest is the one it was made from.
    source_.choose(misfit(rest, source_.rests()[0]) <= misfit(rest, source_.rests()[1]) ? source_.rests()[0]
                                                                                        : source_.rests()[1]);
    reporter.info(source_.file() + ": " + std::to_string(count) + " vertices of the model found among " +
                  std::to_string(mesh.positions.size()) + " by " + way);
  }

  MovedVertices at(double frame) const override {
    const MovedVertices all = source_.at(frame);
    MovedVertices moved;
    const std::size_t count = partners_.first.size() - 1;
    moved.positions.reserve(count);
    for (std::size_t i = 0; i < count; ++i) {
      const std::uint32_t leader = partners_.copies[partners_.first[i]];
      const Point<ObjectSpace>& p = all.positions[leader];
      for (std::uint32_t k = partners_.first[i] + 1; k < partners_.first[i + 1]; ++k) {
        const double apart = distance(all.positions[partners_.copies[k]], p);
        if (!(apart > kTorn * diameter_)) continue;
        char text[160];
        std::snprintf(text, sizeof text,
                      "frame %g: vertex %zu of the model is torn: its copies %u and %u are %.3g apart", frame, i,
                      leader, partners_.copies[k], apart);
        throw badInput(source_.where(), source_.file() + ": " + text + "; move all copies of a vertex alike");
      }
      moved.positions.push_back(p);
      if (!all.handedness.empty()) moved.handedness.push_back(all.handedness[leader]);
    }
    return moved;
  }

 private:
  static constexpr const char* kMend =
      "export the rest model anew with srf model --export, or say \"proxy\": true if this is another mesh";

  void matchPlaces(const AcquisitionMesh& rest, const std::string& texture_fault) {
    std::size_t lonely[2] = {0, 0};
    for (std::size_t r = 0; r < 2; ++r)
      if (auto found = byPlace(rest, source_.rests()[r].positions, kSamePlace * diameter_, &lonely[r])) {
        partners_ = std::move(*found);
        return;
      }
    const std::vector<Vec3>& places = source_.rests()[0].positions;
    const Vec3 p = rest.positions[lonely[0]].raw();
    std::size_t nearest = 0;
    for (std::size_t i = 1; i < places.size(); ++i)
      if (length(places[i] - p) < length(places[nearest] - p)) nearest = i;
    const std::string found = places.empty()
                                  ? "the glTF's mesh has no vertices"
                                  : "the nearest of the glTF's " + std::to_string(places.size()) + " vertices is " +
                                        std::to_string(nearest) + " at " + shown(places[nearest]) + ", " +
                                        std::to_string(length(places[nearest] - p)) + " off";
    throw badInput(source_.where(), source_.file() + ": vertex " + std::to_string(lonely[0]) + " of the model's " +
                                        std::to_string(rest.positions.size()) + ", at " + shown(p) +
                                        ", is not in it: " + found + "; it has no _SRF_INDEX" +
                                        (texture_fault == "absent" ? "" : ", and by TEXCOORD_1, " + texture_fault) +
                                        " (" + kMend + ")");
  }

  double misfit(const AcquisitionMesh& rest, const RestPose& pose) const {
    double sum = 0;
    for (std::size_t i = 0; i < rest.positions.size(); ++i)
      sum += length(pose.positions[partners_.copies[partners_.first[i]]] - rest.positions[i].raw());
    return sum;
  }

  PosedSource source_;
  double diameter_;
  Partners partners_;
};

class ProxySkin final : public VertexMotion {
 public:
  ProxySkin(PosedSource source, const AcquisitionMesh& rest, Reporter& reporter)
      : source_(std::move(source)), rest_(rest.positions) {
    if (source_.mesh().triangles.empty())
      throw badInput(source_.where(), source_.file() + ": the proxy has no triangles, expected a surface");
    weld();
    source_.choose(misfit(source_.rests()[0]) <= misfit(source_.rests()[1]) ? source_.rests()[0] : source_.rests()[1]);
    for (const std::uint32_t copy : leader_) proxy_.positions.emplace_back(source_.rest().positions[copy]);
    parts_ = meshParts(proxy_);
    follow(rest, reporter);
  }

  MovedVertices at(double frame) const override {
    const MovedVertices all = source_.at(frame);
    MovedVertices proxy, moved;
    for (const std::uint32_t copy : leader_) {
      proxy.positions.push_back(all.positions[copy]);
      if (!all.handedness.empty()) proxy.handedness.push_back(all.handedness[copy]);
    }
    const MeshMotion motion = meshMotion(proxy_, parts_, proxy);
    moved.positions.resize(rest_.size());
    moved.handedness.resize(rest_.size());
    parallelFor(rest_.size(), kGrain, [&](std::size_t begin, std::size_t end) {
      for (std::size_t i = begin; i < end; ++i) {
        // About the nearest one, so that nothing is lost far from the origin.
        const Point<ObjectSpace>& anchor = proxy.positions[followed_[i].front().vertex];
        Vector<ObjectSpace> sum;
        double side = 0;
        for (const Followed& f : followed_[i]) {
          sum += f.weight * ((proxy.positions[f.vertex] - anchor) +
                             motion.gradient[f.vertex] * (rest_[i] - proxy_.positions[f.vertex]));
          side += f.weight * motion.handedness[f.vertex];
        }
        moved.positions[i] = anchor + sum;
        moved.handedness[i] = side < 0 ? -1 : 1;
      }
    });
    return moved;
  }

 private:
  struct Followed {
    std::uint32_t vertex;
    double weight;
  };

  /// Vertices that the exporter split at seams become one again.
  void weld() {
    const std::vector<Vec3>& places = source_.mesh().positions;
    Box<ObjectSpace> box;
    for (const Vec3& p : places) box.extend(Point<ObjectSpace>(p));
    const PlaceOrder order(places);
    constexpr std::uint32_t kNone = 0xffffffffu;
    std::vector<std::uint32_t> stands_for(places.size(), kNone), number(places.size());
    for (std::uint32_t i = 0; i < places.size(); ++i) {
      if (stands_for[i] != kNone) continue;
      number[i] = static_cast<std::uint32_t>(leader_.size());
      leader_.push_back(i);
      order.near(places[i], kSamePlace * box.diameter(), [&](std::uint32_t k) {
        if (stands_for[k] == kNone) stands_for[k] = i;
      });
      stands_for[i] = i;
    }
    for (const Triangle& t : source_.mesh().triangles) {
      const Triangle welded{number[stands_for[t[0]]], number[stands_for[t[1]]], number[stands_for[t[2]]]};
      if (welded[0] != welded[1] && welded[1] != welded[2] && welded[2] != welded[0])
        proxy_.triangles.push_back(welded);
    }
  }

  /// Mean distance of some of the model's vertices to the proxy.
  double misfit(const RestPose& pose) const {
    double sum = 0;
    const std::size_t step = 1 + rest_.size() / 256;
    for (std::size_t i = 0; i < rest_.size(); i += step) {
      double least = INFINITY;
      for (const std::uint32_t copy : leader_) least = std::fmin(least, length(pose.positions[copy] - rest_[i].raw()));
      sum += least;
    }
    return sum;
  }

  /// The weights of each vertex of the rest mesh. All pairs are looked at: a proxy is coarse.
  void follow(const AcquisitionMesh& rest, Reporter& reporter) {
    std::vector<std::uint32_t> usable;  // on a triangle of some area: with a gradient and a normal
    std::vector<bool> on_surface(leader_.size(), false);
    for (const auto& [a, b, c] : proxy_.triangles) {
      const auto& p = proxy_.positions;
      if (length(cross(p[b] - p[a], p[c] - p[a])) > 0) on_surface[a] = on_surface[b] = on_surface[c] = true;
    }
    for (std::uint32_t k = 0; k < leader_.size(); ++k)
      if (on_surface[k] && isFinite(proxy_.positions[k])) usable.push_back(k);
    if (usable.size() < 3)
      throw badInput(source_.where(), source_.file() + ": the proxy has no triangle of an area, expected a surface");
    const auto proxy_normals = vertexNormals(proxy_), normals = vertexNormals(rest);
    followed_.resize(rest_.size());
    const std::size_t wanted = std::min<std::size_t>(kNeighbours + 1, usable.size());
    Reporter::Stage stage(reporter, "bind to proxy", rest_.size());
    parallelFor(rest_.size(), kGrain, [&](std::size_t begin, std::size_t end) {
      std::vector<std::pair<double, std::uint32_t>> by_distance(usable.size());
      for (std::size_t i = begin; i < end; ++i) {
        for (std::size_t k = 0; k < usable.size(); ++k) {
          const Vec3 d = (proxy_.positions[usable[k]] - rest_[i]).raw();
          by_distance[k] = {dot(d, d), usable[k]};
        }
        std::partial_sort(by_distance.begin(), by_distance.begin() + static_cast<std::ptrdiff_t>(wanted),
                          by_distance.end());
        // (1 - d^2 / r^2)^2, r the distance of the first one left out; times how far the normals agree, so that a leg
        // does not follow its neighbour.
        const double reach = by_distance[wanted - 1].first;
        double total = 0;
        for (std::size_t k = 0; k + 1 < wanted; ++k) {
          const auto& [squared, vertex] = by_distance[k];
          const double near = reach > 0 ? 1 - squared / reach : 1;
          const double facing = smoothstep(-0.5, 0.5, dot(proxy_normals[vertex], normals[i]));
          const double weight = (near * near + 1e-12) * (facing + 1e-6);
          followed_[i].push_back({vertex, weight});
          total += weight;
        }
        for (Followed& f : followed_[i]) f.weight /= total;
      }
      stage.advance(end - begin);
    });
  }

  PosedSource source_;
  std::vector<Point<AcquisitionSpace>> rest_;
  std::vector<std::uint32_t> leader_;  ///< of each welded vertex: one in the glTF's mesh
  AcquisitionMesh proxy_;              ///< welded, at rest
  MeshParts parts_;
  std::vector<std::vector<Followed>> followed_;
};

}  // namespace

std::unique_ptr<const VertexMotion> skinMotion(const SkinSource& source, const AcquisitionMesh& rest, double fps,
                                               Reporter& reporter) {
  PosedSource posed(source, fps);
  if (source.proxy) return std::make_unique<ProxySkin>(std::move(posed), rest, reporter);
  return std::make_unique<MatchedSkin>(std::move(posed), rest, reporter);
}

}  // namespace srf
