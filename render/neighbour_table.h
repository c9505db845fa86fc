// Light weights by direction, tabulated (M13, M18): for every cell of a cube map the captured lights that stand for
// light from there, so that many lights of a frame find theirs without a search.
#pragma once

#include <span>
#include <vector>

#include "render/acquired_lights.h"

namespace srf {

/// A captured light (position in its list) and its share of the light from a direction.
struct LightShare {
  std::uint32_t source;
  float weight;
};

/// Of one list of distant lights.
class NeighbourTable {
 public:
  /// Two directions that share weights are at most `degrees` apart.
  NeighbourTable(const AcquiredLights& list, double degrees);
  /// Weights (sum 1) at the middle of the direction's cell. `direction`: acquisition space, not zero.
  std::span<const LightShare> at(const Vec3& direction) const;
  std::size_t bytes() const { return begin_.size() * sizeof(begin_[0]) + shares_.size() * sizeof(shares_[0]); }

 private:
  int resolution_;  ///< cells along the edge of a cube face
  std::vector<std::uint32_t> begin_;
  std::vector<LightShare> shares_;
};

}  // namespace srf
