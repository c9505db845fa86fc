#include "render/thin_lens.h"

#include <cmath>
#include <numeric>

#include "base/numeric.h"
#include "render/pixel_noise.h"

namespace srf {
namespace {

/// Of 0 .. samples - 1, the same set in another order, so that a sample's place on the lens does not follow from its
/// place in the pixel.
int shuffled(int index, int samples) {
  int step = static_cast<int>(std::lround(0.6180339887498949 * samples));
  while (std::gcd(step, samples) != 1) ++step;
  return static_cast<int>(static_cast<std::int64_t>(index) * step % samples);
}

}  // namespace

Ray<ObjectSpace> throughLens(const ThinLens& lens, const Camera<ObjectSpace>& camera, const Ray<ObjectSpace>& chief,
                             int x, int y, int index, int samples) {
  const double ahead = dot(chief.direction, camera.forward());
  if (!(ahead > 1e-6)) return chief;
  // A spiral of equal areas (Vogel 1979), turned and pushed outwards by the pixel's own amounts.
  const double golden_angle = kPi * (3 - std::sqrt(5.0));
  const double radius =
      lens.aperture * std::sqrt((shuffled(index, samples) + pixelNoise(x, y, 1)) / static_cast<double>(samples));
  const double angle = golden_angle * shuffled(index, samples) + 2 * kPi * pixelNoise(x, y, 0);
  const Vector<CameraSpace> aside(radius * std::cos(angle), radius * std::sin(angle), 0);
  const Point<ObjectSpace> in_focus = chief.origin + (lens.focus / ahead) * chief.direction;
  const Point<ObjectSpace> origin = chief.origin + camera.pose.rotation() * aside;
  return {origin, normalize(in_focus - origin).value_or(chief.direction)};
}

}  // namespace srf
