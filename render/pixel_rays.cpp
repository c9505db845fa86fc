#include "render/pixel_rays.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <numeric>

#include "base/numeric.h"

namespace srf {

namespace {

std::vector<Vec2> evenPattern(int samples) {
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

}  // namespace

std::vector<Vec2> samplePattern(int samples) {
  std::vector<Vec2> pattern = evenPattern(samples);
  const auto from_middle = [](const Vec2& at) { return square(at.x - 0.5) + square(at.y - 0.5); };
  std::iter_swap(pattern.begin(), std::min_element(pattern.begin(), pattern.end(), [&](const Vec2& a, const Vec2& b) {
                   return from_middle(a) < from_middle(b);
                 }));
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

namespace {

// Pixels along a Z curve: those of a square of 2, 4 or 8 pixels follow one another. A packet of rays traces the faster
// the closer they lie: 4 x 4 pixels.
constexpr int kPacketSide = 4, kPacketPixels = kPacketSide * kPacketSide;
static_assert(kPixelBlock % kPacketSide == 0 && ScreenCover::kCell % kPacketSide == 0);

struct PixelInBlock {
  int x, y;
};
constexpr PixelInBlock pixelInBlock(int i) {
  static_assert(kPixelBlock == 16);
  const auto everySecondBit = [](int of) { return (of & 1) | (of >> 1 & 2) | (of >> 2 & 4) | (of >> 3 & 8); };
  return {everySecondBit(i), everySecondBit(i >> 1)};
}

/// Where the ray through a place of a pinhole's picture, as Camera::ray has it, meets the plane at distance 1: to the
/// right of the axis, below it.
double downOf(const Intrinsics& lens, double y) {
  return (y - lens.cy) / lens.fl_y;
}
double rightOf(const Intrinsics& lens, double x, double down) {
  return (x - lens.cx - lens.skew * down) / lens.fl_x;
}

/// Whether every ray of the picture is one that castPinhole gives.
bool plainPinhole(const Intrinsics& lens) {
  const auto ordinary = [&lens](double x, double y) {
    const double down = downOf(lens, y), right = rightOf(lens, x, down);
    return right * right + down * down < 1e50;
  };
  return lens.model == CameraModel::pinhole && ordinary(0, 0) && ordinary(lens.width, 0) && ordinary(0, lens.height) &&
         ordinary(lens.width, lens.height);
}

/// The rays of a pinhole through `count` places of that plane; changes the places. Plain operations, which compilers
/// make wide.
void castPinhole(const Camera<ObjectSpace>& camera, std::size_t count, double* right, double* down, double* z,
                 Ray<ObjectSpace>* rays) {
  const Mat3& rotation = camera.pose.rotation().raw();
  double *const x = right, *const y = down;
  for (std::size_t i = 0; i < count; ++i) {
    const double inverse = 1 / std::sqrt(right[i] * right[i] + down[i] * down[i] + 1);
    const Vec3 towards{right[i] * inverse, down[i] * inverse, inverse};
    x[i] = dot(rotation.row[0], towards), y[i] = dot(rotation.row[1], towards), z[i] = dot(rotation.row[2], towards);
  }
  for (std::size_t i = 0; i < count; ++i)
    rays[i] = {camera.pose.origin(), Direction<ObjectSpace>::fromUnit({x[i], y[i], z[i]})};
}

int blocksAlong(int pixels) {
  return (pixels + kPixelBlock - 1) / kPixelBlock;
}

int piecesOfBlock(std::size_t samples) {
  const int pixels = piecePixels(samples);
  return (kBlockPixels + pixels - 1) / pixels;
}

}  // namespace

int piecePixels(std::size_t samples) {
  return static_cast<int>(std::clamp<std::size_t>(kPieceRays / samples, 1, kBlockPixels));
}

int pixelPieces(const Camera<ObjectSpace>& camera, std::size_t samples) {
  return blocksAlong(camera.lens.width) * blocksAlong(camera.lens.height) * piecesOfBlock(samples);
}

int pieceOfPixel(const Camera<ObjectSpace>& camera, std::size_t samples, int x, int y) {
  const int block = y / kPixelBlock * blocksAlong(camera.lens.width) + x / kPixelBlock;
  int place = 0;
  for (PixelInBlock at = pixelInBlock(place); at.x != x % kPixelBlock || at.y != y % kPixelBlock;
       at = pixelInBlock(place))
    ++place;
  return block * piecesOfBlock(samples) + place / piecePixels(samples);
}

void raysOfPiece(const Camera<ObjectSpace>& camera, const std::optional<ThinLens>& lens, std::span<const Vec2> pattern,
                 const ScreenCover& cover, int piece, PixelRays& result) {
  const int pieces = piecesOfBlock(pattern.size()), pixels = piecePixels(pattern.size());
  const int block = piece / pieces, first = piece % pieces * pixels, end = std::min(first + pixels, kBlockPixels);
  const int blocks_x = blocksAlong(camera.lens.width);
  const int x0 = block % blocks_x * kPixelBlock, y0 = block / blocks_x * kPixelBlock;
  const bool pinhole = !lens && plainPinhole(camera.lens);
  const std::size_t most = (end - first) * pattern.size();
  result.rays.resize(pinhole ? most : 0);
  result.pixel.resize(pinhole ? most : 0);
  constexpr std::size_t kAtOnce = 64;
  double right[kAtOnce], down[kAtOnce], to_z[kAtOnce];
  std::size_t count = 0, cast = 0;  // of a pinhole: places, and of them those that have a ray
  const auto castThem = [&] {
    castPinhole(camera, count - cast, right, down, to_z, result.rays.data() + cast);
    cast = count;
  };
  // Where rows and columns stand upright on each other a place of each tells all.
  const bool by_row = pinhole && pattern.size() == 1 && camera.lens.skew == 0;
  double right_of[kPixelBlock], down_of[kPixelBlock];
  for (int k = 0; k < kPixelBlock && by_row; ++k) {
    down_of[k] = downOf(camera.lens, y0 + k + pattern[0].y);
    right_of[k] = rightOf(camera.lens, x0 + k + pattern[0].x, 0);
  }
  for (int i = first, stop = first; i < end; i = stop) {
    stop = std::min(end, (i / kPacketPixels + 1) * kPacketPixels);
    const PixelInBlock corner = pixelInBlock(i / kPacketPixels * kPacketPixels);
    const int left = x0 + corner.x, top = y0 + corner.y;
    if (!(left < camera.lens.width && top < camera.lens.height && cover.covers(left, top))) continue;
    const bool inside = left + kPacketSide <= camera.lens.width && top + kPacketSide <= camera.lens.height;
    // As nearly all of a preview's or a plain frame's: without asking pixel by pixel tracing takes 0.96 of the time.
    if (by_row && inside && stop - i == kPacketPixels) {
      double *const to_right = right + (count - cast), *const to_down = down + (count - cast);
      std::uint32_t* const pixel = result.pixel.data() + count;
      for (int k = 0; k < kPacketPixels; ++k) {
        const auto [x, y] = pixelInBlock(k);
        to_right[k] = right_of[corner.x + x], to_down[k] = down_of[corner.y + y];
        pixel[k] = static_cast<std::uint32_t>((top + y) * camera.lens.width + left + x);
      }
      count += kPacketPixels;
      if (count - cast == kAtOnce) castThem();
      continue;
    }
    for (int k = i; k < stop; ++k) {
      const PixelInBlock at = pixelInBlock(k);
      const int x = x0 + at.x, y = y0 + at.y;
      if (!(x < camera.lens.width && y < camera.lens.height)) continue;
      if (!pinhole) {
        result.add(camera, lens, pattern, x, y);
        continue;
      }
      for (const Vec2& place : pattern) {
        down[count - cast] = downOf(camera.lens, y + place.y);
        right[count - cast] = rightOf(camera.lens, x + place.x, down[count - cast]);
        result.pixel[count++] = static_cast<std::uint32_t>(y * camera.lens.width + x);
        if (count - cast == kAtOnce) castThem();
      }
    }
    if (count - cast > kAtOnce - kPacketPixels) castThem();  // room for a packet
  }
  if (!pinhole) return;
  castThem();
  result.rays.resize(count);
  result.pixel.resize(count);
}

}  // namespace srf
