// False colours of an error map.
#pragma once

#include <algorithm>
#include <cmath>

#include "base/image.h"

namespace srf {

/// Values 0..1 of one channel: black, violet, red, orange, pale yellow.
inline Image8 heatImage(const ImageF& map) {
  static constexpr double kStops[5][3] = {{0, 0, 4}, {81, 18, 124}, {183, 55, 121}, {252, 137, 97}, {252, 253, 191}};
  Image8 heat(map.width(), map.height(), 3);
  for (int y = 0; y < map.height(); ++y)
    for (int x = 0; x < map.width(); ++x) {
      const double t = 4.0 * map.at(x, y);
      const int i = std::min(3, static_cast<int>(t));
      for (int c = 0; c < 3; ++c)
        heat.at(x, y, c) = static_cast<std::uint8_t>(std::lround(std::lerp(kStops[i][c], kStops[i + 1][c], t - i)));
    }
  return heat;
}

}  // namespace srf
