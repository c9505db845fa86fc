// Which points of a model lie near one: they are sorted once into the cells of a grid.
#pragma once

#include <array>
#include <cmath>
#include <cstdint>
#include <unordered_map>
#include <vector>

#include "base/space.h"

namespace srf {

class PointsAround {
 public:
  /// `points` must outlive it; `reach` above 0, units.
  PointsAround(const std::vector<Point<AcquisitionSpace>>& points, double reach) : points_(points), reach_(reach) {
    for (std::uint32_t i = 0; i < points.size(); ++i) grid_[key(cellOf(points[i]))].push_back(i);
  }
  /// Calls use(j) for every point j nearer than the reach to point i, which is one of them; always in the same order.
  template <class Use>
  void operator()(std::size_t i, const Use& use) const {
    const Cell cell = cellOf(points_[i]);
    for (int d = 0; d < 27; ++d) {
      const auto near = grid_.find(key({cell[0] + d % 3 - 1, cell[1] + d / 3 % 3 - 1, cell[2] + d / 9 - 1}));
      if (near == grid_.end()) continue;
      for (const std::uint32_t j : near->second)
        if (distance(points_[i], points_[j]) < reach_) use(j);
    }
  }

 private:
  using Cell = std::array<std::int64_t, 3>;  // as wide as the reach
  Cell cellOf(const Point<AcquisitionSpace>& p) const {
    Cell cell;
    for (int c = 0; c < 3; ++c) cell[c] = static_cast<std::int64_t>(std::floor(p.raw()[c] / reach_));
    return cell;
  }
  static std::uint64_t key(const Cell& c) {
    return static_cast<std::uint64_t>(c[0]) * 0x9e3779b97f4a7c15u ^
           static_cast<std::uint64_t>(c[1]) * 0xc2b2ae3d27d4eb4fu ^
           static_cast<std::uint64_t>(c[2]) * 0x165667b19e3779f9u;
  }

  const std::vector<Point<AcquisitionSpace>>& points_;
  double reach_;
  std::unordered_map<std::uint64_t, std::vector<std::uint32_t>> grid_;
};

}  // namespace srf
