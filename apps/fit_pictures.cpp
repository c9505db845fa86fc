#include "apps/fit_pictures.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <nlohmann/json.hpp>

#include "base/image_io.h"
#include "model/deformed_model.h"
#include "model/fit_export.h"

namespace fs = std::filesystem;

namespace srf {
namespace {

std::uint8_t shade(float value) {
  return static_cast<std::uint8_t>(std::lround(255 * std::clamp(value, 0.f, 1.f)));
}

struct Picture {
  const char* name;
  int channels;
  std::array<float, 3> (*value)(const FittedPoint& point);  ///< from 0 to 1
};

const Picture kPictures[] = {
    {"gate", 1, [](const FittedPoint& p) { return std::array<float, 3>{p.gate}; }},
    {"indirect", 1, [](const FittedPoint& p) { return std::array<float, 3>{p.indirect}; }},
    {"indirect_shadow", 1, [](const FittedPoint& p) { return std::array<float, 3>{p.indirect_shadow}; }},
    {"slant", 1, [](const FittedPoint& p) { return std::array<float, 3>{p.slant}; }},
    {"roughness", 1,
     [](const FittedPoint& p) { return std::array<float, 3>{metallicRoughness(p.reflectance).roughness}; }},
    {"metallic", 1,
     [](const FittedPoint& p) { return std::array<float, 3>{metallicRoughness(p.reflectance).metallic}; }},
    {"normal", 3,
     [](const FittedPoint& p) {
       std::array<float, 3> color = p.reflectance.normal;
       for (float& c : color) c = 0.5f + 0.5f * c;
       return color;
     }},
    {"base_color", 3, [](const FittedPoint& p) {
       std::array<float, 3> color = metallicRoughness(p.reflectance).base_color;
       for (float& c : color) c = srgbFromLinear(c);
       return color;
     }}};

}  // namespace

Json fitInfo(const ReflectanceFit& fit) {
  double gate = 0, indirect = 0, indirect_shadow = 0;
  std::size_t open = 0, closed = 0;
  std::map<std::array<float, 2>, std::size_t> roughnesses;
  for (const FittedPoint& point : fit.points) {
    gate += point.gate;
    open += point.gate >= 0.99f;
    closed += point.gate <= 0.01f;
    indirect += point.indirect;
    indirect_shadow += point.indirect_shadow;
    ++roughnesses[{point.reflectance.alpha_x, point.reflectance.alpha_y}];
  }
  const double points = static_cast<double>(std::max<std::size_t>(fit.points.size(), 1));
  Json info;
  info["held_out_error_plain"] = fit.error_plain;
  info["held_out_error_guided"] = fit.error_guided;
  info["gate_mean"] = gate / points;
  info["gate_open"] = static_cast<double>(open) / points;
  info["gate_closed"] = static_cast<double>(closed) / points;
  info["indirect_mean"] = indirect / points;
  info["indirect_shadow_mean"] = indirect_shadow / points;
  info["shadows_from_photographs"] = fit.lit.words() != fit.lit_by_rays.words();
  info["materials"] = Json::array();
  for (const auto& [alpha, count] : roughnesses)
    info["materials"].push_back(
        {{"alpha_x", alpha[0]}, {"alpha_y", alpha[1]}, {"share", static_cast<double>(count) / points}});
  return info;
}

std::vector<std::string> writeFitPictures(const SrfManifest& field, const DeformableModel& model,
                                          const ReflectanceFit& fit, const fs::path& folder) {
  const auto view = std::find_if(field.views.begin(), field.views.end(), [](const auto& v) { return !v.file.empty(); });
  SRF_CHECK(view != field.views.end());
  const Camera<ObjectSpace> camera = atRest(view->camera);
  const int width = camera.lens.width, height = camera.lens.height;
  const DeformedModel rest(model);
  std::vector<Image8> images;
  for (const Picture& picture : kPictures) images.emplace_back(width, height, picture.channels);
  for (int y = 0; y < height; ++y) {
    std::vector<Ray<ObjectSpace>> rays;
    std::vector<int> column;
    for (int x = 0; x < width; ++x)
      if (const auto ray = camera.ray({x + 0.5, y + 0.5})) rays.push_back(*ray), column.push_back(x);
    std::vector<SurfaceHit> hits(rays.size());
    rest.intersect(rays, hits);
    for (std::size_t r = 0; r < hits.size(); ++r)
      for (std::size_t k = 0; k < images.size(); ++k) {
        std::array<float, 3> sum{};
        for (int i = 0; i < hits[r].count; ++i) {
          const auto value = kPictures[k].value(fit.points[hits[r].point[i]]);
          for (int c = 0; c < 3; ++c) sum[c] += hits[r].weight[i] * value[c];
        }
        for (int c = 0; c < images[k].channels(); ++c) images[k].at(column[r], y, c) = shade(sum[c]);
      }
  }
  fs::create_directories(folder);
  std::vector<std::string> names;
  for (std::size_t k = 0; k < images.size(); ++k) {
    names.push_back(std::string(kPictures[k].name) + ".png");
    writePng(folder / names.back(), images[k]);
  }
  return names;
}

}  // namespace srf
