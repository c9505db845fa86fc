// Pictures of mirror and matt balls by formula.
#pragma once

#include <cstdint>
#include <functional>
#include <random>

#include "acquire/mirror_ball.h"
#include "base/numeric.h"

namespace srf::test {

inline Intrinsics orthographicLens(int width, int height, double pixels_per_unit) {
  Intrinsics lens;
  lens.model = CameraModel::orthographic;
  lens.width = width, lens.height = height;
  lens.fl_x = lens.fl_y = pixels_per_unit;
  lens.cx = 0.5 * width, lens.cy = 0.5 * height;
  return lens;
}

struct BallPicture {
  Intrinsics lens;
  Ball ball;
  double background = 0.12;
  int supersampling = 4;
  double noise = 0;  ///< standard deviation
  std::uint64_t seed = 1;
};

/// `value(point, normal, to_viewer)` on the ball, the background elsewhere; box filter.
inline ImageF ballPicture(const BallPicture& picture,
                          const std::function<double(const Vec3&, const Vec3&, const Vec3&)>& value) {
  const Intrinsics& lens = picture.lens;
  ImageF image(lens.width, lens.height, 1);
  std::mt19937_64 random(picture.seed);
  std::normal_distribution<double> normal;
  const int n = picture.supersampling;
  const Vec3 c = picture.ball.center.raw();
  for (int y = 0; y < lens.height; ++y)
    for (int x = 0; x < lens.width; ++x) {
      double sum = 0;
      const bool far_off = !lens.isOrthographic() && [&] {
        const Vec3 d = lens.unproject({x + 0.5, y + 0.5})->raw();
        return length(cross(c, d)) > 1.2 * picture.ball.radius;
      }();
      if (far_off) sum = picture.background * n * n;
      for (int s = 0; s < n * n && !far_off; ++s) {
        const Vec2 pixel{x + (s % n + 0.5) / n, y + (s / n + 0.5) / n};
        Vec3 o, d{0, 0, 1};
        if (lens.isOrthographic())
          o = {(pixel.x - lens.cx) / lens.fl_x, (pixel.y - lens.cy) / lens.fl_y, c.z - 10};
        else
          d = lens.unproject(pixel)->raw();
        const double along = dot(c - o, d), root = square(picture.ball.radius) - square(length(cross(c - o, d)));
        if (root < 0) {
          sum += picture.background;
          continue;
        }
        const Vec3 p = o + (along - std::sqrt(root)) * d;
        sum += value(p, (p - c) / picture.ball.radius, -d);
      }
      image.at(x, y) = static_cast<float>(sum / (n * n) + picture.noise * normal(random));
    }
  return image;
}

/// `radiance(point, direction)` of what the ball mirrors.
inline ImageF mirrorPicture(const BallPicture& picture,
                            const std::function<double(const Vec3&, const Vec3&)>& radiance) {
  return ballPicture(picture,
                     [&](const Vec3& p, const Vec3& n, const Vec3& v) { return radiance(p, 2 * dot(n, v) * n - v); });
}

/// Where the mirror image of a near light appears: the normal that halves the angle between viewer and light.
inline Vec2 highlightPixel(const Intrinsics& lens, const Ball& ball, const Vec3& light) {
  const Vec3 c = ball.center.raw();
  Vec3 n = -c / length(c);
  for (int i = 0; i < 200; ++i) {
    const Vec3 p = c + ball.radius * n;
    const Vec3 half = -p / length(p) + (light - p) / length(light - p);
    n = half / length(half);
  }
  return *lens.project(Point<CameraSpace>(c + ball.radius * n));
}

}  // namespace srf::test
