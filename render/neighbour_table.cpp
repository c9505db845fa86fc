#include "render/neighbour_table.h"

#include "base/numeric.h"
#include "base/parallel.h"
#include "render/cube_cells.h"

namespace srf {

NeighbourTable::NeighbourTable(const AcquiredLights& list, double degrees) {
  // The widest cells lie in the middle of a face: 2 / resolution a side, as an angle.
  resolution_ = std::clamp(static_cast<int>(std::ceil(2 * std::sqrt(2.0) / radians(degrees))), 1, 1024);
  const std::size_t cells = 6 * static_cast<std::size_t>(resolution_) * resolution_;
  std::vector<std::vector<LightShare>> found(cells);
  parallelFor(cells, 256, [&](std::size_t first, std::size_t last) {
    std::vector<Penalised> scratch;
    std::vector<Weighted> weights;
    for (std::size_t c = first; c < last; ++c) {
      const auto face = static_cast<int>(c / (static_cast<std::size_t>(resolution_) * resolution_));
      const auto at = [&](std::size_t cell) {
        return 2 * (static_cast<double>(cell % resolution_) + 0.5) / resolution_ - 1;
      };
      const Vec3 middle = cubeDirection(face, at(c), at(c / resolution_));
      list.nearest(Direction<AcquisitionSpace>::fromUnit(middle), Point<AcquisitionSpace>(), scratch, weights);
      for (const Weighted& w : weights) found[c].push_back({w.source, static_cast<float>(w.weight)});
    }
  });
  begin_.reserve(cells + 1);
  for (const auto& shares : found) {
    begin_.push_back(static_cast<std::uint32_t>(shares_.size()));
    shares_.insert(shares_.end(), shares.begin(), shares.end());
  }
  begin_.push_back(static_cast<std::uint32_t>(shares_.size()));
}

std::span<const LightShare> NeighbourTable::at(const Vec3& direction) const {
  const std::size_t c = cubeCell(direction, resolution_).index(resolution_);
  return {shares_.data() + begin_[c], shares_.data() + begin_[c + 1]};
}

}  // namespace srf
