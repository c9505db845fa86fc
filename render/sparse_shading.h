// Shading some of the pixels (M18): where the surface runs on smoothly from one pixel to the next, what lies between
// shaded pixels need not be looked up.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "base/camera.h"
#include "render/scene.h"

namespace srf {

/// A pixel that takes the mean of its neighbours.
struct PixelBetween {
  std::uint32_t pixel;
  std::uint8_t count;                     ///< of neighbours: 2, on opposite sides, or 4
  std::array<std::uint8_t, 4> neighbour;  ///< places in the block (placeInBlock)
};

/// Where a ray met the model.
struct MetPlace {
  bool met;
  double distance;
  Point<AcquisitionSpace> p0;
};

/// Divides the hits of one block of pixels, one ray each: `shaded` gets the positions of those to be shaded, `between`
/// the others, whose neighbours are shaded or come before them. Every second row and column of a block is shaded, and
/// its borders; a pixel in between takes the mean of those beside it, above and below it or at its corners, where the
/// surface between a pair on opposite sides is flat to a quarter of their distance, in space and at rest. With
/// Shading::sparser every other one of these rows and columns is in between likewise. What becomes of a pixel depends
/// on its block alone.
void divideHits(const Camera<ObjectSpace>& camera, std::span<const std::uint32_t> pixels,
                std::span<const MetPlace> hits, Shading shading, std::vector<std::size_t>& shaded,
                std::vector<PixelBetween>& between);

}  // namespace srf
