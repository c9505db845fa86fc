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
inline constexpr int kBlockPixels = kPixelBlock * kPixelBlock;
/// The place of a pixel in its block: row times kPixelBlock and column. Pixels are numbered row by row in a picture
/// `width` wide.
inline std::uint8_t placeInBlock(std::uint32_t pixel, std::uint32_t width) {
  static_assert(kBlockPixels == 256);
  const std::uint32_t y = pixel / width, x = pixel - y * width;
  return static_cast<std::uint8_t>(y % kPixelBlock * kPixelBlock + x % kPixelBlock);
}
/// Most rays that are gathered together, but for a single pixel's: with many samples a block falls into pieces of a few
/// pixels each, so that a frame's memory does not grow with its samples.
inline constexpr int kPieceRays = 16 * kBlockPixels;

/// Where the samples of a pixel lie in it, about its middle: a regular grid for square numbers, else a rank-1 lattice.
/// The one nearest to the middle comes first: layers show the first that meets the surface.
std::vector<Vec2> samplePattern(int samples);

/// Rays through pixels, those of a pixel one after the other.
struct PixelRays {
  std::vector<Ray<ObjectSpace>> rays;
  std::vector<std::uint32_t> pixel;  ///< of each ray: y * width + x

  /// Adds the rays of pixel (x, y), one for each place of the pattern that the lens has a ray for.
  void add(const Camera<ObjectSpace>& camera, const std::optional<ThinLens>& lens, std::span<const Vec2> pattern, int x,
           int y);
};

/// Pixels of a piece; the last piece of a block may have fewer.
int piecePixels(std::size_t samples);
/// Pieces of a picture: those of a block one after the other, blocks row by row.
int pixelPieces(const Camera<ObjectSpace>& camera, std::size_t samples);
/// The piece that a pixel lies in.
int pieceOfPixel(const Camera<ObjectSpace>& camera, std::size_t samples, int x, int y);
/// Those of one piece in place of what `result` held. Pixels that the cover leaves out get no rays.
void raysOfPiece(const Camera<ObjectSpace>& camera, const std::optional<ThinLens>& lens, std::span<const Vec2> pattern,
                 const ScreenCover& cover, int piece, PixelRays& result);

}  // namespace srf
