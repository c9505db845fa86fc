#include "render/guided_interpolation.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "base/numeric.h"

namespace srf {
namespace {

// A captured light this low over the surface tells nothing of it; and it is divided by its cosine, kept above kCosine.
constexpr float kLowest = 0.05f, kLowEnough = 0.12f;
constexpr float kCosine = 0.1f, kMostRatio = 2;
// The lit residual fades out where less than this share of the captured lights about the one asked for light the point.
constexpr double kFade = 0.25;
// Within the first of a captured light the photographs' own shadows show, beyond the second those of the rays.
const double kNear = radians(1), kNotNear = radians(5);
// Shadow rays start this far off the surface, of the object's diameter: above rounding and the facets of a mesh.
constexpr double kRayOffset = 5e-4;
constexpr double kShortOfLight = 0.999;  // of the distance to a point light, which may stand in the object itself

std::array<float, 3> floats(const Vec3& a) {
  return {static_cast<float>(a.x), static_cast<float>(a.y), static_cast<float>(a.z)};
}
float dot3(const std::array<float, 3>& a, float x, float y, float z) {
  return a[0] * x + a[1] * y + a[2] * z;
}
std::size_t padded(std::size_t count) {
  return (count + 7) / 8 * 8;
}

/// Share of a hit's points whose bit is set in the column.
float share(const VisibilityBits& bits, const SurfaceHit& hit, std::uint32_t column) {
  float sum = 0;
  for (int i = 0; i < hit.count; ++i)
    if (bits.get(hit.point[i], column)) sum += hit.weight[i];
  return std::min(sum, 1.f);
}

}  // namespace

GuidedLighting::GuidedLighting(const ReflectanceFit& fit, const FrameLighting& lighting,
                               std::span<const std::optional<NeighbourTable>> tables, const DeformedModel& occluders,
                               std::span<const SourceView> views, std::span<const std::uint32_t> list_of_view,
                               const Options& options)
    : fit_(fit),
      lighting_(lighting),
      tables_(tables),
      occluders_(occluders),
      views_(views),
      list_of_view_(list_of_view),
      options_(options),
      row_(padded(lighting.lights().distant.size() + lighting.lights().near_lights.size())),
      offset_(std::max(kRayOffset * occluders.model().bounds().diameter(), occluders.model().positional_error)),
      corrected_(fit.lit.words() != fit.lit_by_rays.words()) {}

void GuidedLighting::blend(const GuidedQuery& query, GuidedBlock::Hit& hit) const {
  hit.query = query;
  hit.view = floats(query.view.raw());
  PointReflectance& to = hit.reflectance;
  to.normal = to.tangent = {0, 0, 0};
  to.alpha_x = to.alpha_y = 0;
  for (int i = 0; i < query.hit->count; ++i) {
    const FittedPoint& point = fit_.points[query.hit->point[i]];
    const PointReflectance& from = point.reflectance;
    const float w = query.hit->weight[i];
    hit.gate += w * point.gate;
    hit.indirect += w * point.indirect;
    to.alpha_x += w * from.alpha_x;
    to.alpha_y += w * from.alpha_y;
    // The tangent is an axis: turned to the side of the first.
    const float side = dot3(to.tangent, from.tangent[0], from.tangent[1], from.tangent[2]) < 0 ? -w : w;
    for (int c = 0; c < 3; ++c) {
      to.normal[c] += w * from.normal[c];
      to.tangent[c] += side * from.tangent[c];
      for (int k = 0; k < kModelTerms; ++k) to.coefficient[k][c] += w * from.coefficient[k][c];
    }
  }
  const auto direction = [](const std::array<float, 3>& a) {
    return normalize(Vector<AcquisitionSpace>(Vec3{a[0], a[1], a[2]}));
  };
  const Direction<AcquisitionSpace> n = direction(to.normal).value_or(query.look_up->normal);
  const Vec3 t{to.tangent[0], to.tangent[1], to.tangent[2]};
  const Direction<AcquisitionSpace> tangent =
      normalize(Vector<AcquisitionSpace>(t - dot(n.raw(), t) * n.raw())).value_or(anyPerpendicular(n));
  to.normal = floats(n.raw());
  to.tangent = floats(tangent.raw());
}

void GuidedLighting::prepare(std::span<const GuidedQuery> queries, GuidedBlock& block) const {
  const FrameLights& lights = lighting_.lights();
  const std::size_t near_count = lights.near_lights.size(), distant_count = lights.distant.size();
  block.hits.assign(queries.size(), {});
  block.x.assign(queries.size() * row_, 0);
  block.y.assign(queries.size() * row_, 0);
  block.z.assign(queries.size() * row_, 1);
  block.visible.assign(queries.size() * row_, options_.shadows == Shadows::off ? 1.f : -1.f);
  block.near_irradiance.resize(queries.size() * near_count);
  for (std::size_t h = 0; h < queries.size(); ++h) {
    blend(queries[h], block.hits[h]);
    const LookUp& look_up = *queries[h].look_up;
    const auto put = [&](std::size_t k, const Direction<ObjectSpace>& light) {
      const std::array<float, 3> l = floats((look_up.acquisition_from_object * light).raw());
      block.x[h * row_ + k] = l[0], block.y[h * row_ + k] = l[1], block.z[h * row_ + k] = l[2];
    };
    for (std::size_t k = 0; k < distant_count; ++k) put(k, lights.distant[k].direction);
    for (std::size_t k = 0; k < near_count; ++k) {  // Eq. 11: A(|p* - p_l|) I_l
      const Vector<ObjectSpace> to_light = lights.near_lights[k].position - queries[h].hit->p_star;
      const double d = std::max(length(to_light), options_.min_distance);
      block.near_irradiance[h * near_count + k] = lights.near_lights[k].intensity / (d * d);
      put(distant_count + k, normalize(to_light).value_or(look_up.acquisition_from_object.inverse() * look_up.normal));
    }
  }
  if (options_.shadows != Shadows::off) castShadows(block);
}

void GuidedLighting::castShadows(GuidedBlock& block) const {
  const FrameLights& lights = lighting_.lights();
  const std::size_t distant_count = lights.distant.size(), count = distant_count + lights.near_lights.size();
  const bool at_rest = options_.shadows == Shadows::captured;
  std::vector<Ray<ObjectSpace>> rays;
  std::vector<double> far_distances;
  std::vector<std::size_t> asked;  // positions in block.visible
  std::vector<std::pair<float, std::size_t>> brightest;
  for (std::size_t h = 0; h < block.hits.size(); ++h) {
    const GuidedBlock::Hit& hit = block.hits[h];
    if (!(hit.gate > 0)) continue;
    const LookUp& look_up = *hit.query.look_up;
    // Acquisition space is the object's at rest.
    const auto object_from_acquisition = look_up.acquisition_from_object.inverse();
    const auto in_object = [&](const Direction<AcquisitionSpace>& d) {
      return at_rest ? Direction<ObjectSpace>::fromUnit(d.raw()) : object_from_acquisition * d;
    };
    const Point<ObjectSpace> surface = at_rest ? Point<ObjectSpace>(look_up.p.raw()) : hit.query.hit->p_star;
    const Point<ObjectSpace> origin = surface + offset_ * in_object(look_up.normal);
    const auto ask = [&](std::size_t k, double far) {
      const std::size_t at = h * row_ + k;
      // Not the rounded direction: a light at rest must fall as the one captured.
      const auto direction = k < distant_count
                                 ? look_up.acquisition_from_object * lights.distant[k].direction
                                 : normalize(Vector<AcquisitionSpace>(Vec3{block.x[at], block.y[at], block.z[at]}))
                                       .value_or(look_up.normal);
      asked.push_back(at);
      rays.push_back({origin, in_object(direction)});
      far_distances.push_back(far);
    };
    const auto cosine = [&](std::size_t k) {
      const std::size_t at = h * row_ + k;
      return dot3(hit.reflectance.normal, block.x[at], block.y[at], block.z[at]);
    };
    brightest.clear();
    for (std::size_t k = 0; k < count; ++k) {
      if (!(cosine(k) > 0)) {
        block.visible[h * row_ + k] = 0;
      } else if (k >= distant_count) {
        ask(k, kShortOfLight * distance(lights.near_lights[k - distant_count].position, hit.query.hit->p_star));
      } else {
        const Vec3& e = lights.distant[k].irradiance;
        brightest.emplace_back(-cosine(k) * static_cast<float>(e.x + e.y + e.z), k);
      }
    }
    const auto most = std::min(brightest.size(), static_cast<std::size_t>(options_.shadow_rays));
    if (most < brightest.size())
      std::nth_element(brightest.begin(), brightest.begin() + static_cast<std::ptrdiff_t>(most), brightest.end());
    for (std::size_t i = 0; i < most; ++i) ask(brightest[i].second, std::numeric_limits<double>::infinity());
  }
  std::vector<std::uint8_t> blocked(rays.size(), 0);
  occluders_.rays().occluded(rays, far_distances, 0, blocked);
  for (std::size_t i = 0; i < asked.size(); ++i) block.visible[asked[i]] = blocked[i] ? 0.f : 1.f;
}

void GuidedLighting::readBits(const AcquiredLights& list, GuidedBlock& block, const GuidedBlock::Hit& hit) const {
  const std::size_t count = list.count(), size = padded(count);
  for (auto* array :
       {&block.list_x, &block.list_y, &block.lit, &block.disagree, &block.facing, &block.usable, &block.inverse_cosine})
    array->assign(size, 0);
  block.list_z.assign(size, 1);
  bool any = false;
  for (const std::uint32_t i : list.usable()) {
    const std::array<float, 3> l = floats(list.directionOf(i, hit.query.look_up->p).raw());
    block.list_x[i] = l[0], block.list_y[i] = l[1], block.list_z[i] = l[2];
    const std::uint32_t column = list.ids()[i].value;
    block.lit[i] = share(fit_.lit, *hit.query.hit, column);
    if (corrected_) block.disagree[i] = std::fabs(block.lit[i] - share(fit_.lit_by_rays, *hit.query.hit, column));
    block.usable[i] = share(fit_.lit_around, *hit.query.hit, column);
    any = any || block.usable[i] > 0;
  }
  for (const std::uint32_t i : list.usable()) {
    const float cosine = dot3(hit.reflectance.normal, block.list_x[i], block.list_y[i], block.list_z[i]);
    block.facing[i] = static_cast<float>(smoothstep(kLowest, kLowEnough, cosine));
    block.usable[i] = (any ? block.usable[i] : block.lit[i]) * block.facing[i];
    block.inverse_cosine[i] = 1 / std::max(cosine, kCosine);
  }
}

std::uint32_t GuidedLighting::gather(GuidedBlock& block, std::size_t index, std::uint32_t list_index, LightGather& out,
                                     std::array<double, 3>& color) const {
  const GuidedBlock::Hit& hit = block.hits[index];
  const AcquiredLights& list = lighting_.lists()[list_index];
  const FrameLights& lights = lighting_.lights();
  const LookUp& look_up = *hit.query.look_up;
  const std::size_t distant_count = lights.distant.size(), near_count = lights.near_lights.size();
  const std::size_t count = distant_count + near_count, pad = lightPad(list.count());
  const float gate = options_.model_alone ? 1 : hit.gate;
  const bool off = options_.shadows == Shadows::off;
  readBits(list, block, hit);
  block.stack_weights.assign(3 * pad, 0);
  block.model_weights.assign(3 * pad, 0);
  float* const stack = block.stack_weights.data();
  float* const model = block.model_weights.data();

  std::array<float*, kModelTerms> terms;
  for (int k = 0; k < kModelTerms; ++k) {
    block.terms[k].resize(std::max({row_, pad, std::size_t{8}}));
    terms[k] = block.terms[k].data();
  }
  const float* const x = block.x.data() + index * row_;
  const float* const y = block.y.data() + index * row_;
  const float* const z = block.z.data() + index * row_;
  modelTerms(hit.reflectance, hit.view, {x, y, z, static_cast<int>(count)}, terms);
  std::array<std::array<double, 3>, kModelTerms> direct{};  // what reaches the eye by the model, by coefficient

  // What stands for irradiance from each captured light, before it is divided by what that light gave.
  const auto add = [pad](float* weights, std::uint32_t i, float amount, const Rgb& e) {
    for (int c = 0; c < 3; ++c) weights[c * pad + i] += amount * e[c];
  };
  for (std::size_t k = 0; k < count; ++k) {
    const bool near = k >= distant_count;
    const Vec3& irradiance =
        near ? block.near_irradiance[index * near_count + k - distant_count] : lights.distant[k].irradiance;
    const Rgb e = floats(irradiance);
    std::span<const LightShare> shares;
    if (!near && tables_[list_index]) {
      shares = tables_[list_index]->at({x[k], y[k], z[k]});
    } else {
      const Direction<AcquisitionSpace> light =
          near ? normalize(Vector<AcquisitionSpace>(Vec3{x[k], y[k], z[k]})).value_or(look_up.normal)
               : look_up.acquisition_from_object * lights.distant[k].direction;
      list.nearest(light, look_up.p, block.order, block.weights);
      block.shares.clear();
      for (const Weighted& w : block.weights) block.shares.push_back({w.source, static_cast<float>(w.weight)});
      shares = block.shares;
    }
    // What the captured lights about this one say: of the shadow, those that shine on the surface at all; and how far
    // the nearest is.
    float lit = 0, facing = 0, usable = 0, disagree = 0, nearest = 4;
    for (const auto& [i, w] : shares) {
      lit += w * block.facing[i] * block.lit[i];
      facing += w * block.facing[i];
      usable += w * block.usable[i];
      disagree += w * block.disagree[i];
      const float dx = x[k] - block.list_x[i], dy = y[k] - block.list_y[i], dz = z[k] - block.list_z[i];
      nearest = std::min(nearest, dx * dx + dy * dy + dz * dz);
    }
    const float asked = block.visible[index * row_ + k];
    const float captured = facing > 0 ? lit / facing : asked < 0 ? 1 : asked;
    float visible = asked < 0 ? captured : asked;
    if (disagree > 0 && !off) {
      visible *= 1 - disagree;
      for (const auto& [i, w] : shares) visible += w * block.disagree[i] * block.lit[i];
    }
    const float nearness = 1 - static_cast<float>(smoothstep(kNear, kNotNear, std::sqrt(nearest)));
    const float from_indirect = off ? 0 : hit.indirect + (1 - hit.indirect) * nearness;
    const float shown = options_.shadows == Shadows::captured ? visible + nearness * (captured - visible) : visible;
    if (shown > 0)
      for (int t = 0; t < kModelTerms; ++t)
        for (int c = 0; c < 3; ++c) direct[t][c] += gate * shown * e[c] * terms[t][k];
    if (options_.model_alone) continue;

    const float cosine = dot3(hit.reflectance.normal, x[k], y[k], z[k]);
    const float from_lit = usable > 0 && cosine > 0 ? (1 - from_indirect) * visible *
                                                          static_cast<float>(smoothstep(0, kFade, usable)) / usable
                                                    : 0;
    for (const auto& [i, w] : shares) {
      const float relit =
          w * gate * from_lit * block.usable[i] * std::min(kMostRatio, cosine * block.inverse_cosine[i]);
      const float as_is = w * gate * from_indirect;
      add(stack, i, relit + as_is + w * (1 - gate), e);
      add(model, i, relit + as_is * block.lit[i], e);
    }
  }
  for (std::uint32_t i = 0; i < static_cast<std::uint32_t>(list.count()); ++i) {
    const Vec3 inverse = list.inverseIrradiance(i, look_up.p);
    for (int c = 0; c < 3; ++c) {
      stack[c * pad + i] *= static_cast<float>(inverse[c]);
      if (!(inverse[c] > 0)) model[c * pad + i] = 0;  // a channel in which the light is dark holds nothing
    }
  }
  for (const RestLight& rest : lights.rest) {  // a light of the capture itself: only the view differs
    const auto at = list.find(rest.light);
    if (!at) continue;
    if (!options_.model_alone) add(stack, *at, static_cast<float>(rest.scale), {1, 1, 1});
    const Vec3 inverse = list.inverseIrradiance(*at, look_up.p);
    float lx[8] = {}, ly[8] = {}, lz[8] = {};
    lx[0] = block.list_x[*at], ly[0] = block.list_y[*at], lz[0] = block.list_z[*at];
    modelTerms(hit.reflectance, hit.view, {lx, ly, lz, 1}, terms);
    for (int c = 0; c < 3; ++c) {
      if (!(inverse[c] > 0)) continue;
      const double amount = gate * rest.scale * block.lit[*at] / inverse[c];
      for (int t = 0; t < kModelTerms; ++t) direct[t][c] += amount * terms[t][0];
      if (!options_.model_alone) model[c * pad + *at] += static_cast<float>(amount);
    }
  }

  // Only the lights that count are evaluated for the views.
  std::vector<std::uint32_t>& used = block.used;
  used.clear();
  LightWeights weights;
  weights.first_entry = static_cast<std::uint32_t>(out.entries.size());
  for (std::uint32_t i = 0; i < static_cast<std::uint32_t>(list.count()); ++i) {
    const Rgb w{stack[i], stack[pad + i], stack[2 * pad + i]};
    if (w != Rgb{}) out.entries.push_back({i, w});
    if (model[i] == 0 && model[pad + i] == 0 && model[2 * pad + i] == 0) continue;
    const std::size_t to = used.size();
    used.push_back(i);
    block.list_x[to] = block.list_x[i], block.list_y[to] = block.list_y[i], block.list_z[to] = block.list_z[i];
    for (int c = 0; c < 3; ++c) model[c * pad + to] = model[c * pad + i];
  }
  double list_share = 0;
  for (const ChosenView& chosen : hit.query.chosen) {
    if (list_of_view_[chosen.view] != list_index) continue;
    list_share += chosen.weight;
    if (used.empty()) continue;
    const std::array<float, 3> view = floats(views_[chosen.view].camera.viewDirection(look_up.p).raw());
    modelTerms(hit.reflectance, view,
               {block.list_x.data(), block.list_y.data(), block.list_z.data(), static_cast<int>(used.size())}, terms);
    for (int c = 0; c < 3; ++c)
      for (int t = 0; t < kModelTerms; ++t) {
        double sum = 0;
        for (std::size_t i = 0; i < used.size(); ++i) sum += model[c * pad + i] * terms[t][i];
        color[c] -= chosen.weight * hit.reflectance.coefficient[t][c] * sum;
      }
  }
  for (int c = 0; c < 3; ++c)
    for (int t = 0; t < kModelTerms; ++t) color[c] += list_share * hit.reflectance.coefficient[t][c] * direct[t][c];
  return out.append(weights, list.count());
}

}  // namespace srf
