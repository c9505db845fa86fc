// Where in the picture the deformed model can show at all: rays elsewhere are not cast.
#pragma once

#include <cstdint>
#include <vector>

#include "base/camera.h"
#include "model/deformed_model.h"

namespace srf {

/// Cells of 4 x 4 pixels that some triangle may reach. Never leaves out a pixel that a ray meets the model through;
/// covers everything where nothing is known (surfels; triangles that reach behind the camera).
class ScreenCover {
 public:
  static constexpr int kCell = 4;

  ScreenCover() = default;  ///< covers everything
  ScreenCover(const Camera<ObjectSpace>& camera, const DeformedModel& deformed);
  bool covers(int x, int y) const { return all_ || cells_[static_cast<std::size_t>(y / kCell) * across_ + x / kCell]; }

 private:
  int across_ = 0, down_ = 0;
  bool all_ = true;
  std::vector<std::uint8_t> cells_;
};

}  // namespace srf
