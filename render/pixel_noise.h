// A number of each pixel's own, spread evenly over any few neighbours: what turns the bands of sampling into fine
// noise.
#pragma once

#include <cmath>

namespace srf {

/// In [0, 1), the same for the same arguments: interleaved gradient noise (Jimenez 2014), moved along for each
/// `dimension` by the golden ratio.
inline double pixelNoise(int x, int y, int dimension) {
  const auto fraction = [](double value) { return value - std::floor(value); };
  const double at = fraction(52.9829189 * fraction(0.06711056 * x + 0.00583715 * y));
  return fraction(at + 0.6180339887498949 * dimension);
}

}  // namespace srf
