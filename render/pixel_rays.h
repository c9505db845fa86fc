// The rays of a frame, gathered in square blocks of pixels.
#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "base/camera.h"
#include "render/screen_cover.h"
#include "render/thin_lens.h"

namespace srf {

inline constexpr int kPixelBlock = 16;  ///< pixels along the side of the blocks that a frame is gathered in

/// Where the samples of a pixel lie in it, about its middle: a regular grid for square numbers, else a rank-1 lattice.
std::vector<Vec2> samplePattern(int samples);

/// Rays through pixels, those of a pixel one after the other.
struct PixelRays {
  std::vector<Ray<ObjectSpace>> rays;
  std::vector<std::uint32_t> pixel;  ///< of each ray: y * width + x

  /// Adds the rays of pixel (x, y), one for each place of the pattern that the lens has a ray for.
  void add(const Camera<ObjectSpace>& camera, const std::optional<ThinLens>& lens, std::span<const Vec2> pattern, int x,
           int y);
};

/// Blocks of a picture, row by row.
int pixelBlocks(const Camera<ObjectSpace>& camera);
/// Pixels that the cover leaves out get no rays.
PixelRays raysOfBlock(const Camera<ObjectSpace>& camera, const std::optional<ThinLens>& lens,
                      std::span<const Vec2> pattern, const ScreenCover& cover, int block);

}  // namespace srf
