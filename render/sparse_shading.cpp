#include "render/sparse_shading.h"

#include <cmath>

#include "render/pixel_rays.h"

namespace srf {
namespace {

// How far the middle of three hits may lie from the straight line through the others: of a pixel's size along the ray,
// of their distance at rest. It leaves out creases, outlines and the last few pixels before an outline.
constexpr double kFlat = 0.25;

bool flat(const Camera<ObjectSpace>& camera, const MetPlace& a, const MetPlace& middle, const MetPlace& b) {
  const double bend = std::fabs(middle.distance - 0.5 * (a.distance + b.distance));
  if (!(bend <= kFlat * camera.pixelFootprint(middle.distance))) return false;
  const Vector<AcquisitionSpace> across = b.p0 - a.p0, off = (middle.p0 - a.p0) - 0.5 * across;
  return dot(off, off) <= kFlat * kFlat * dot(across, across);
}

/// Whether a row or column of a block is shaded: 0, 2, .., 12, 13, 15.
constexpr bool onLattice(int at) {
  return (at % 2 == 0) == (at < kPixelBlock - 3);
}
static_assert(onLattice(0) && onLattice(kPixelBlock - 1) && kPixelBlock % 2 == 0);

}  // namespace

void divideHits(const Camera<ObjectSpace>& camera, std::span<const std::uint32_t> pixels,
                std::span<const MetPlace> hits, std::vector<std::size_t>& shaded, std::vector<PixelBetween>& between) {
  constexpr int kSide = kPixelBlock, kNone = -1;
  const auto width = static_cast<std::uint32_t>(camera.lens.width);
  std::array<int, kSide * kSide> at, target;  // by place in the block
  std::array<std::uint8_t, kSide * kSide> cell_of;
  at.fill(kNone);
  for (std::size_t i = 0; i < hits.size(); ++i) {
    const std::uint32_t row = pixels[i] / width, x = pixels[i] - row * width;
    cell_of[i] = static_cast<std::uint8_t>(row % kSide * kSide + x % kSide);
    if (hits[i].met) at[cell_of[i]] = static_cast<int>(i);
  }
  for (std::size_t i = 0; i < hits.size(); ++i) {
    if (!hits[i].met) continue;
    const int cell = cell_of[i], x = cell % kSide, y = cell / kSide;
    PixelBetween pixel{pixels[i], 0, {}};
    const auto addPair = [&](int step) {
      const int before = at[cell - step], after = at[cell + step];
      if (before == kNone || after == kNone || !flat(camera, hits[before], hits[i], hits[after])) return;
      for (const int neighbour : {cell - step, cell + step})
        pixel.neighbour[pixel.count++] = static_cast<std::uint16_t>(neighbour);
    };
    const bool in_column = onLattice(x), in_row = onLattice(y);
    if (in_row && !in_column) addPair(1);
    if (in_column && !in_row) addPair(kSide);
    if (!in_column && !in_row) addPair(kSide - 1), addPair(kSide + 1);
    if (pixel.count > 0) {
      between.push_back(pixel);
      continue;
    }
    target[cell] = static_cast<int>(shaded.size());
    shaded.push_back(i);
  }
  for (PixelBetween& pixel : between)
    for (int n = 0; n < pixel.count; ++n) pixel.neighbour[n] = static_cast<std::uint16_t>(target[pixel.neighbour[n]]);
}

}  // namespace srf
