#include "render/sparse_shading.h"

#include <array>
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

/// Whether a row or column of a block is of the lattice whose lines lie `spacing` apart: 0, 2, .., 12, 13, 15 or 0, 4,
/// 8, 12, 13, 15.
constexpr bool onLattice(int at, int spacing) {
  return at < kPixelBlock - 3 ? at % spacing == 0 : at % 2 != 0;
}
static_assert(onLattice(0, 4) && onLattice(kPixelBlock - 4, 4) && onLattice(kPixelBlock - 1, 4));

}  // namespace

void divideHits(const Camera<ObjectSpace>& camera, std::span<const std::uint32_t> pixels,
                std::span<const MetPlace> hits, Shading shading, std::vector<std::size_t>& shaded,
                std::vector<PixelBetween>& between) {
  constexpr int kSide = kPixelBlock, kNone = -1;
  const auto width = static_cast<std::uint32_t>(camera.lens.width);
  std::array<int, kBlockPixels> at;  // by place in the block
  std::array<std::uint8_t, kBlockPixels> place_of;
  std::array<bool, kBlockPixels> is_between{};
  at.fill(kNone);
  for (std::size_t i = 0; i < hits.size(); ++i) {
    place_of[i] = placeInBlock(pixels[i], width);
    if (hits[i].met) at[place_of[i]] = static_cast<int>(i);
  }
  // From lines `spacing` apart to those between them.
  const auto divide = [&](int spacing) {
    const int half = spacing / 2;
    for (std::size_t i = 0; i < hits.size(); ++i) {
      const int place = place_of[i], x = place % kSide, y = place / kSide;
      const bool in_column = onLattice(x, spacing), in_row = onLattice(y, spacing);
      if (!hits[i].met || (in_column && in_row)) continue;
      if (half > 1 && !(onLattice(x, half) && onLattice(y, half))) continue;
      PixelBetween pixel{pixels[i], 0, {}};
      const auto addPair = [&](int step) {
        const int before = at[place - step], after = at[place + step];
        if (before == kNone || after == kNone || !flat(camera, hits[before], hits[i], hits[after])) return;
        for (const int neighbour : {place - step, place + step})
          pixel.neighbour[pixel.count++] = static_cast<std::uint8_t>(neighbour);
      };
      if (in_row) addPair(half);
      if (in_column) addPair(half * kSide);
      if (!in_column && !in_row) addPair(half * (kSide - 1)), addPair(half * (kSide + 1));
      if (pixel.count == 0) continue;
      between.push_back(pixel);
      is_between[place] = true;
    }
  };
  if (shading == Shading::sparser) divide(4);
  divide(2);
  for (std::size_t i = 0; i < hits.size(); ++i)
    if (hits[i].met && !is_between[place_of[i]]) shaded.push_back(i);
}

}  // namespace srf
