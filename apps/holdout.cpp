#include "apps/holdout.h"

#include <algorithm>
#include <cmath>

#include "base/check.h"
#include "base/image_io.h"
#include "base/numeric.h"
#include "field/reflectance_store.h"

namespace srf {

SrfManifest without(const SrfManifest& field, const LeftOut& out) {
  SrfManifest left = field;
  for (std::size_t v = 0; v < left.views.size(); ++v)
    if (out.views[v]) left.views[v].file.clear();
  for (std::size_t i = 0; i < left.lights.size(); ++i)
    if (out.lights[i]) left.lights[i].kind = LightKind::captured;
  return left;
}

FrameLights asSceneLight(const SrfManifest& field, LightId light) {
  const CaptureLight& from = field.lights[light.value];
  FrameLights lights;
  // Acquisition space is the object's at rest.
  switch (from.kind) {
    case LightKind::directional:
      lights.distant = {{Direction<ObjectSpace>::fromUnit(from.direction.raw()), from.strength}};
      break;
    case LightKind::point:
      lights.near_lights = {{Point<ObjectSpace>(from.position.raw()), from.strength}};
      break;
    case LightKind::captured:
      lights.rest = {{light, 1.0}};
      break;
  }
  return lights;
}

StoredPhotograph storedPhotograph(const std::filesystem::path& srf_folder, const StoredView& view, std::size_t at) {
  const ReflectanceStore store(srf_folder / view.file);
  const StoreGeometry& g = store.geometry();
  StoredPhotograph photograph{ImageF(g.image_width, g.image_height, 3), ImageF(g.image_width, g.image_height, 1)};
  std::vector<std::uint16_t> block(g.blockHalves());
  for (int tile_y = 0; tile_y < g.tiles_y; ++tile_y)
    for (int tile_x = 0; tile_x < g.tiles_x; ++tile_x) {
      if (!store.hasTile(tile_x, tile_y)) continue;
      store.readTile(tile_x, tile_y, block);
      for (int i = 0; i < kTile * kTile; ++i) {
        const int in_crop_x = tile_x * kTile + i % kTile, in_crop_y = tile_y * kTile + i / kTile;
        const int x = g.crop_x + in_crop_x, y = g.crop_y + in_crop_y;
        if (x < 0 || y < 0 || x >= g.image_width || y >= g.image_height) continue;
        photograph.inside.at(x, y) = store.coverage().at(in_crop_x, in_crop_y) >= kWhollyCovered ? 1.f : 0.f;
        for (int c = 0; c < 3; ++c)
          photograph.rgb.at(x, y, c) = floatFromHalf(block[(static_cast<std::size_t>(i) * 3 + c) * g.lightPad() + at]);
      }
    }
  return photograph;
}

PredictionScore scorePrediction(const ImageF& picture, const ImageF& photograph, const ImageF& inside) {
  PredictionScore score{compareImages(picture, photograph, inside).inside};
  for (int y = 0; y < photograph.height(); ++y)
    for (int x = 0; x < photograph.width(); ++x) {
      if (!(inside.at(x, y) > 0.999f)) continue;
      for (int c = 0; c < 3; ++c) {
        const double truth = photograph.at(x, y, c);
        score.difference2 += square(picture.at(x, y, c) - truth);
        score.square2 += square(truth);
      }
    }
  return score;
}

std::vector<std::size_t> farthestFirst(std::span<const Vec3> directions) {
  std::vector<std::size_t> order;
  std::vector<double> nearest(directions.size(), HUGE_VAL);  // squared, to those in order; chosen: below 0
  std::size_t next = 0;
  while (order.size() < directions.size()) {
    order.push_back(next);
    nearest[next] = -1;
    for (std::size_t i = 0; i < directions.size(); ++i) {
      if (nearest[i] < 0) continue;
      const Vec3 apart = directions[i] - directions[next];
      nearest[i] = std::min(nearest[i], dot(apart, apart));
    }
    next = static_cast<std::size_t>(std::max_element(nearest.begin(), nearest.end()) - nearest.begin());
  }
  return order;
}

double PowerLaw::at(double count) const {
  return factor * std::pow(count, -exponent);
}

PowerLaw fitPowerLaw(std::span<const std::array<double, 2>> measured) {
  double x = 0, y = 0, xx = 0, xy = 0;
  const auto n = static_cast<double>(measured.size());
  for (const auto& [count, error] : measured) {
    const double a = std::log(count), b = std::log(error);
    x += a / n, y += b / n, xx += a * a / n, xy += a * b / n;
  }
  SRF_CHECK(xx - x * x > 0);
  const double slope = (xy - x * y) / (xx - x * x);
  return {std::exp(y - slope * x), -slope};
}

}  // namespace srf
