#include "field/bilinear_fetch.h"

namespace srf {
namespace {

// Least coverage of a texel (formats.md): pixels over black are premultiplied and only lose precision, which a matte
// takes as it is; others hold background colour.
constexpr int kLeastBlack = 128, kLeastMatte = 1, kLeastOther = kWhollyCovered;

}  // namespace

Fetch bilinearFetch(const SourceView& view, const Vec2& pixel, int level) {
  Fetch fetch;
  fetch.level = level;
  fetch.alpha = view.matte ? 0 : 1;
  const Coverage& covered = view.coverage[level];
  double u = pixel.x - 0.5 - view.geometry.crop_x, v = pixel.y - 0.5 - view.geometry.crop_y;
  if (level > 0) {
    u = (u + 0.5) / (1 << level) - 0.5;
    v = (v + 0.5) / (1 << level) - 0.5;
  }
  // Off the rectangle, also far off (before the conversion to int).
  if (!(u > -1 && v > -1 && u < covered.width() && v < covered.height())) return fetch;
  const auto [x0, fx] = texelAndPart(u);
  const auto [y0, fy] = texelAndPart(v);
  fetch.x = static_cast<int>(x0), fetch.y = static_cast<int>(y0);
  const double bilinear[4] = {(1 - fx) * (1 - fy), fx * (1 - fy), (1 - fx) * fy, fx * fy};
  const int least = !view.black_background ? kLeastOther : view.matte ? kLeastMatte : kLeastBlack;
  double denominator = 0, alpha = 0;
  bool used[4];
  for (int t = 0; t < 4; ++t) {
    const int x = fetch.x + t % 2, y = fetch.y + t / 2;
    const bool inside = x >= 0 && y >= 0 && x < covered.width() && y < covered.height();
    const int coverage = inside ? covered.at(x, y) : 0;
    used[t] = bilinear[t] > 0 && coverage >= least;
    alpha += bilinear[t] * coverage / 255;
    if (!used[t]) continue;
    fetch.covered += bilinear[t];
    denominator += view.black_background ? bilinear[t] * coverage / 255 : bilinear[t];
  }
  if (view.matte && denominator > 0) fetch.alpha = alpha;
  const double scale = denominator > 0 ? 1 / denominator : 0;
  for (int t = 0; t < 4; ++t) fetch.tap[t] = used[t] ? static_cast<float>(bilinear[t] * scale) : 0.f;
  return fetch;
}

}  // namespace srf
