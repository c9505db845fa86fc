// Distant lights in clusters of like direction, where there are more than rays can ask after: one ray tells of all
// lights of a cluster whether they reach a point.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "base/space.h"
#include "render/light_set.h"

namespace srf {

/// Puts lights of like direction one after the other: cut in two at the middle of the longest side of the box about
/// their directions, and each part again.
void orderByDirection(std::vector<DistantLight>& lights);

struct LightClusters {
  std::vector<std::uint32_t> first;               ///< light of each cluster, and the end
  std::vector<Direction<ObjectSpace>> direction;  ///< of each cluster: the middle of its lights by their energy
  std::size_t count() const { return direction.size(); }
};
/// Of each cluster those within an angle of it, radians, but itself: cluster first[c] .. first[c + 1] - 1 of `other`.
struct NearClusters {
  std::vector<std::uint32_t> first, other;
  std::vector<std::uint32_t> crowded;  ///< clusters that have any
  std::span<const std::uint32_t> of(std::size_t cluster) const {
    return std::span(other).subspan(first[cluster], first[cluster + 1] - first[cluster]);
  }
};
NearClusters nearClusters(const LightClusters& clusters, double angle);

/// At most `most` clusters, at least 1, of lights ordered by direction; each light for itself where there are no more.
/// Cut in two again and again is the cluster of most energy times extent, so that strong lights stand by themselves.
LightClusters clusterLights(std::span<const DistantLight> lights, std::size_t most);

}  // namespace srf
