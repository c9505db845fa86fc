#include "render/pixel_rays.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <numeric>

namespace srf {

std::vector<Vec2> samplePattern(int samples) {
  std::vector<Vec2> pattern;
  const int side = static_cast<int>(std::lround(std::sqrt(samples)));
  if (side * side == samples) {
    for (int y = 0; y < side; ++y)
      for (int x = 0; x < side; ++x) pattern.push_back({(x + 0.5) / side, (y + 0.5) / side});
    return pattern;
  }
  // A lattice: each coordinate takes every (k + 0.5) / samples once, so that the pixel's middle is the samples' mean. A
  // sequence that only grows even with its length would shift a picture of two samples by a quarter of a pixel.
  int step = std::max(1, static_cast<int>(std::lround(samples / 1.6180339887498949)));
  while (std::gcd(step, samples) != 1) ++step;
  for (int i = 0; i < samples; ++i)
    pattern.push_back({(i * static_cast<std::int64_t>(step) % samples + 0.5) / samples, (i + 0.5) / samples});
  return pattern;
}

void PixelRays::add(const Camera<ObjectSpace>& camera, const std::optional<ThinLens>& lens,
                    std::span<const Vec2> pattern, int x, int y) {
  const int samples = static_cast<int>(pattern.size());
  for (int i = 0; i < samples; ++i)
    if (const auto ray = camera.ray({x + pattern[i].x, y + pattern[i].y})) {
      rays.push_back(lens ? throughLens(*lens, camera, *ray, x, y, i, samples) : *ray);
      pixel.push_back(static_cast<std::uint32_t>(y * camera.lens.width + x));
    }
}

int pixelBlocks(const Camera<ObjectSpace>& camera) {
  const auto along = [](int pixels) { return (pixels + kPixelBlock - 1) / kPixelBlock; };
  return along(camera.lens.width) * along(camera.lens.height);
}

PixelRays raysOfBlock(const Camera<ObjectSpace>& camera, const std::optional<ThinLens>& lens,
                      std::span<const Vec2> pattern, const ScreenCover& cover, int block) {
  const int width = camera.lens.width, height = camera.lens.height;
  const int blocks_x = (width + kPixelBlock - 1) / kPixelBlock;
  const int x0 = block % blocks_x * kPixelBlock, y0 = block / blocks_x * kPixelBlock;
  PixelRays result;
  result.rays.reserve(kPixelBlock * kPixelBlock * pattern.size());
  result.pixel.reserve(kPixelBlock * kPixelBlock * pattern.size());
  for (int y = y0; y < std::min(height, y0 + kPixelBlock); ++y)
    for (int x = x0; x < std::min(width, x0 + kPixelBlock); ++x)
      if (cover.covers(x, y)) result.add(camera, lens, pattern, x, y);
  return result;
}

}  // namespace srf
