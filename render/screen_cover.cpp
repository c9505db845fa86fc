#include "render/screen_cover.h"

#include <algorithm>
#include <atomic>
#include <cmath>
#include <limits>

#include "base/parallel.h"
#include "render/view_kernels.h"

namespace srf {
namespace {

constexpr std::size_t kGrain = 8192;
constexpr float kPad = 0.5;  // pixels; rounding in the ray scene is a thousandth of one, for an object of some 1e4
// A lens that distorts bends the edges of a triangle: by less than this part of its extent for any lens whose picture
// does not fold.
constexpr float kBend = 0.5;

}  // namespace

ScreenCover::ScreenCover(const Camera<ObjectSpace>& camera, const DeformedModel& deformed) {
  const DeformableModel& model = deformed.model();
  if (model.kind != ModelKind::mesh) return;
  across_ = (camera.lens.width + kCell - 1) / kCell, down_ = (camera.lens.height + kCell - 1) / kCell;

  struct Pixel {
    float x, y;
  };
  constexpr float kNowhere = std::numeric_limits<float>::quiet_NaN(), kBehind = std::numeric_limits<float>::infinity();
  const auto& positions = deformed.positions();
  std::vector<Pixel> pixels(positions.size());
  parallelFor(positions.size(), kGrain, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) {
      if (!isFinite(positions[i])) {
        pixels[i] = {kNowhere, kNowhere};
        continue;
      }
      const auto projection = camera.project(positions[i]);
      pixels[i] = projection ? Pixel{static_cast<float>(projection->pixel.x), static_cast<float>(projection->pixel.y)}
                             : Pixel{kBehind, kBehind};
    }
  });
  const float bend = bendsLines(camera.lens) ? kBend : 0;
  const std::size_t chunks = (model.triangles.size() + kGrain - 1) / kGrain,
                    cells = static_cast<std::size_t>(across_) * down_;
  std::vector<std::vector<std::uint8_t>> parts(chunks);
  std::atomic<bool> unknown = false;
  parallelFor(model.triangles.size(), kGrain, [&](std::size_t begin, std::size_t end) {
    std::vector<std::uint8_t>& part = parts[begin / kGrain];
    part.assign(cells, 0);
    const auto cell = [](float at, int last) {
      return std::isnan(at) ? 0 : static_cast<int>(std::clamp(at / kCell, 0.f, static_cast<float>(last)));
    };
    for (std::size_t t = begin; t < end; ++t) {
      const auto& [a, b, c] = model.triangles[t];
      const Pixel &p = pixels[a], &q = pixels[b], &r = pixels[c];
      if (std::isnan(p.x + q.x + r.x)) continue;  // Psi sent a corner nowhere: the triangle is not there
      float x0 = std::min({p.x, q.x, r.x}), x1 = std::max({p.x, q.x, r.x});
      float y0 = std::min({p.y, q.y, r.y}), y1 = std::max({p.y, q.y, r.y});
      if (!(x1 < kBehind) || !(y1 < kBehind)) {
        unknown = true;
        return;
      }
      const float pad = kPad + bend * std::max(x1 - x0, y1 - y0);
      x0 -= pad, y0 -= pad, x1 += pad, y1 += pad;
      if (x1 < 0 || y1 < 0 || x0 > camera.lens.width || y0 > camera.lens.height) continue;
      const int first_x = cell(x0, across_ - 1), last_x = cell(x1, across_ - 1);
      for (int y = cell(y0, down_ - 1), last_y = cell(y1, down_ - 1); y <= last_y; ++y)
        for (int x = first_x; x <= last_x; ++x) part[static_cast<std::size_t>(y) * across_ + x] = 1;
    }
  });
  if (unknown) return;
  cells_.assign(cells, 0);
  for (const auto& part : parts)
    for (std::size_t i = 0; i < cells; ++i) cells_[i] |= part[i];
  all_ = false;
}

}  // namespace srf
