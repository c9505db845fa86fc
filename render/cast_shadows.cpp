#include "render/cast_shadows.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include "base/color.h"
#include "base/numeric.h"

namespace srf {
namespace {

// Where less than this share of the captured lights about one light the place, it fades to what they show as they are.
constexpr double kFade = 0.25;

struct Asked {
  Direction<ObjectSpace> direction;
  Vec3 irradiance;
  double far_distance;  ///< of its ray
  double given;         ///< luminance on the surface
  bool reaches = true, by_ray = false;
};

}  // namespace

CastShadows::CastShadows(const FrameLighting& lighting, const DeformedModel& deformed, const DeformedModel* rest,
                         const Options& options)
    : lighting_(lighting),
      deformed_(deformed),
      rest_(options.shadows == Shadows::both ? nullptr : rest),
      options_(options),
      offset_(deformed.shadowOffset()),
      rest_offset_(rest_ ? rest_->shadowOffset() : 0) {}

std::uint32_t CastShadows::gather(std::uint32_t list_index, const LitPoint& point, LightGather& out,
                                  Counts& counts) const {
  const AcquiredLights& list = lighting_.lists()[list_index];
  const FrameLights& lights = lighting_.lights();
  const Direction<ObjectSpace> normal_star = point.normal();
  LightWeights w;
  w.first_entry = static_cast<std::uint32_t>(out.entries.size());
  const auto add = [&](std::uint32_t light, const Vec3& weight) {
    out.entries.push_back(
        {light, {static_cast<float>(weight.x), static_cast<float>(weight.y), static_cast<float>(weight.z)}});
  };

  thread_local std::vector<Asked> asked;
  asked.clear();
  const auto ask = [&](const Direction<ObjectSpace>& direction, const Vec3& irradiance, double far_distance) {
    const double cosine = dot(normal_star.raw(), direction.raw());
    asked.push_back({direction, irradiance, far_distance, cosine * dot(kLuminance, irradiance)});
  };
  for (const DistantLight& light : lights.distant)
    ask(light.direction, light.irradiance, std::numeric_limits<double>::infinity());
  // Below the horizon the photographs hold what there is: the shadow of the surface on itself is their cosine.
  const auto brighter = [&](std::size_t a, std::size_t b) { return asked[a].given > asked[b].given; };
  thread_local std::vector<std::size_t> order;
  order.clear();
  for (std::size_t k = 0; k < asked.size(); ++k)
    if (asked[k].given > 0) order.push_back(k);
  const auto most = static_cast<std::size_t>(options_.shadow_rays);
  if (order.size() > most) {
    std::nth_element(order.begin(), order.begin() + static_cast<std::ptrdiff_t>(most), order.end(), brighter);
    order.resize(most);
    std::sort(order.begin(), order.end());
  }
  for (const NearLight& light : lights.near_lights) {  // Eq. 11: A(|p* - p_l|) I_l
    const Vector<ObjectSpace> to_light = light.position - point.p_star;
    const double d = std::max(length(to_light), lighting_.options().min_distance);
    ask(normalize(to_light).value_or(normal_star), light.intensity / (d * d), kShortOfLight * length(to_light));
    if (asked.back().given > 0) order.push_back(asked.size() - 1);
  }
  for (const std::size_t k : order) asked[k].by_ray = true;

  thread_local std::vector<Ray<ObjectSpace>> rays;
  thread_local std::vector<double> far_distances;
  thread_local std::vector<std::uint8_t> blocked;
  if (options_.shadows != Shadows::off && !order.empty()) {
    rays.clear(), far_distances.clear();
    const Point<ObjectSpace> origin = point.p_star + offset_ * normal_star;
    for (const std::size_t k : order) {
      rays.push_back({origin, asked[k].direction});
      far_distances.push_back(asked[k].far_distance);
    }
    blocked.assign(rays.size(), 0);
    deformed_.rays().occluded(rays, far_distances, 0, blocked);
    counts.rays += rays.size();
    for (std::size_t i = 0; i < order.size(); ++i) asked[order[i]].reaches = !blocked[i];
  }

  // Whether the captured lights that stand for those of the frame light the place at rest; each is asked once.
  thread_local std::vector<std::vector<Weighted>> stand_ins;
  thread_local std::vector<std::int8_t> lit;  // -1: not asked for
  thread_local std::vector<std::uint32_t> unknown;
  if (stand_ins.size() < asked.size()) stand_ins.resize(asked.size());
  lit.assign(static_cast<std::size_t>(list.count()), -1);
  unknown.clear();
  const Direction<AcquisitionSpace> normal = point.acquisition_from_object * normal_star;
  for (std::size_t k = 0; k < asked.size(); ++k) {
    if (!asked[k].reaches) continue;
    list.nearest(point.acquisition_from_object * asked[k].direction, point.p, out.scratch, stand_ins[k]);
    if (!rest_ || !asked[k].by_ray) continue;
    for (const Weighted& light : stand_ins[k]) {
      if (lit[light.source] >= 0) continue;
      lit[light.source] = 1;
      if (dot(normal.raw(), list.directionOf(light.source, point.p).raw()) > 0) unknown.push_back(light.source);
    }
  }
  if (!unknown.empty()) {
    rays.clear(), far_distances.clear();
    // Acquisition space is the object's at rest.
    const Point<ObjectSpace> origin(point.p.raw() + rest_offset_ * normal.raw());
    for (const std::uint32_t i : unknown) {
      rays.push_back({origin, Direction<ObjectSpace>::fromUnit(list.directionOf(i, point.p).raw())});
      far_distances.push_back(kShortOfLight * list.distanceTo(i, point.p));
    }
    blocked.assign(rays.size(), 0);
    rest_->rays().occluded(rays, far_distances, 0, blocked);
    counts.rays += rays.size();
    for (std::size_t i = 0; i < unknown.size(); ++i) lit[unknown[i]] = !blocked[i];
  }

  for (std::size_t k = 0; k < asked.size(); ++k) {
    if (!asked[k].reaches) continue;
    double told = 0, shines = 1;
    if (rest_ && asked[k].by_ray) {
      shines = 0;
      for (const Weighted& light : stand_ins[k]) shines += light.weight * lit[light.source];
      told = smoothstep(0, kFade, shines);
      counts.not_told += shines < kFade;
    }
    for (const Weighted& light : stand_ins[k]) {
      const double weight = light.weight * (1 - told + (told > 0 && lit[light.source] > 0 ? told / shines : 0));
      if (weight > 0) add(light.source, weight * (asked[k].irradiance * list.inverseIrradiance(light.source, point.p)));
    }
  }
  for (const RestLight& light : lights.rest)
    if (const auto at = list.find(light.light)) add(*at, Vec3{light.scale, light.scale, light.scale});
  return out.append(w, list.count());
}

}  // namespace srf
