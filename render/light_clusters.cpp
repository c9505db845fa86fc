#include "render/light_clusters.h"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <queue>
#include <utility>

namespace srf {
namespace {

double energyOf(const DistantLight& light) {
  return light.irradiance.x + light.irradiance.y + light.irradiance.z;
}

/// Lights first .. end - 1, to be cut in two at the middle of the longest side of the box about their directions.
struct LightCut {
  std::size_t first, end;
  int axis;
  double length, middle;

  LightCut(std::span<const DistantLight> lights, std::size_t from, std::size_t to) : first(from), end(to) {
    const DirectionBox box = directionBox(lights.subspan(from, to - from));
    axis = box.longest;
    length = box.high[axis] - box.low[axis];
    middle = 0.5 * (box.low[axis] + box.high[axis]);
  }
  bool before(const DistantLight& light) const { return light.direction.raw()[axis] < middle; }
};

}  // namespace

void orderByDirection(std::vector<DistantLight>& lights) {
  std::vector<std::pair<std::size_t, std::size_t>> parts{{0, lights.size()}};
  while (!parts.empty()) {
    const auto [first, end] = parts.back();
    parts.pop_back();
    if (end - first < 2) continue;
    const LightCut box(lights, first, end);
    const auto begin = lights.begin();
    const auto cut =
        std::stable_partition(begin + static_cast<std::ptrdiff_t>(first), begin + static_cast<std::ptrdiff_t>(end),
                              [&](const DistantLight& light) { return box.before(light); });
    const auto at = static_cast<std::size_t>(cut - begin);
    if (at == first || at == end) continue;  // all in one direction
    parts.emplace_back(first, at);
    parts.emplace_back(at, end);
  }
}

LightClusters clusterLights(std::span<const DistantLight> lights, std::size_t most) {
  LightClusters result;
  struct Part {
    LightCut box;
    double worth;
    bool operator<(const Part& other) const {
      return worth != other.worth ? worth < other.worth : box.first > other.box.first;
    }
  };
  std::priority_queue<Part> parts;
  const auto add = [&](std::size_t first, std::size_t end) {
    const LightCut box(lights, first, end);
    double energy = 0;
    for (std::size_t i = first; i < end; ++i) energy += energyOf(lights[i]);
    parts.push({box, energy * box.length});
  };
  if (lights.size() <= most) {
    for (std::size_t i = 0; i < lights.size(); ++i) result.first.push_back(static_cast<std::uint32_t>(i));
  } else {
    add(0, lights.size());
    while (parts.size() < most && parts.top().worth > 0) {
      const LightCut box = parts.top().box;
      const auto part = lights.subspan(box.first, box.end - box.first);
      const auto cut = std::find_if_not(part.begin(), part.end(), [&](const auto& light) { return box.before(light); });
      const std::size_t at = box.first + static_cast<std::size_t>(cut - part.begin());
      if (at == box.first || at == box.end) break;  // no wider than rounding
      parts.pop();
      add(box.first, at);
      add(at, box.end);
    }
    for (; !parts.empty(); parts.pop()) result.first.push_back(static_cast<std::uint32_t>(parts.top().box.first));
    std::sort(result.first.begin(), result.first.end());
  }
  result.first.push_back(static_cast<std::uint32_t>(lights.size()));
  for (std::size_t k = 0; k + 1 < result.first.size(); ++k) {
    const std::size_t first = result.first[k], end = result.first[k + 1];
    Vec3 sum;
    for (std::size_t i = first; i < end && end - first > 1; ++i) sum += energyOf(lights[i]) * lights[i].direction.raw();
    result.direction.push_back(normalize(Vector<ObjectSpace>(sum)).value_or(lights[first].direction));
  }
  return result;
}

NearClusters nearClusters(const LightClusters& clusters, double angle) {
  // Along z, within a band.
  std::vector<std::uint32_t> order(clusters.count());
  std::iota(order.begin(), order.end(), 0u);
  const auto at = [&](std::uint32_t c) -> const Vec3& { return clusters.direction[c].raw(); };
  std::sort(order.begin(), order.end(),
            [&](std::uint32_t a, std::uint32_t b) { return at(a).z != at(b).z ? at(a).z < at(b).z : a < b; });
  const double band = 2 * std::sin(0.5 * angle), least = std::cos(angle);
  std::vector<std::pair<std::uint32_t, std::uint32_t>> pairs;
  for (std::size_t i = 0; i < order.size(); ++i)
    for (std::size_t j = i + 1; j < order.size() && at(order[j]).z - at(order[i]).z <= band; ++j)
      if (dot(at(order[i]), at(order[j])) >= least)
        pairs.emplace_back(order[i], order[j]), pairs.emplace_back(order[j], order[i]);
  std::sort(pairs.begin(), pairs.end());
  NearClusters result;
  result.first.assign(clusters.count() + 1, 0);
  for (const auto& [c, other] : pairs) {
    if (result.first[c + 1]++ == 0) result.crowded.push_back(c);
    result.other.push_back(other);
  }
  std::partial_sum(result.first.begin(), result.first.end(), result.first.begin());
  return result;
}

}  // namespace srf
