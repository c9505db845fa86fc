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
constexpr float kFade = 0.25f;
// Within the first of a captured light the photographs' own shadows show, beyond the second those of the rays.
constexpr float kNear = static_cast<float>(radians(1)), kNotNear = static_cast<float>(radians(5));
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

float square(float x) {
  return x * x;
}
float smoothstepf(float edge0, float edge1, float x) {
  const float t = std::clamp((x - edge0) / (edge1 - edge0), 0.f, 1.f);
  return t * t * (3 - 2 * t);
}

/// sum a[i] b[i] over a multiple of 8, in eight partial sums.
float sumOfProducts(const float* a, const float* b, std::size_t count) {
  float sum[8] = {};
  for (std::size_t i = 0; i < count; i += 8)
    for (int lane = 0; lane < 8; ++lane) sum[lane] += a[i + lane] * b[i + lane];
  return ((sum[0] + sum[4]) + (sum[2] + sum[6])) + ((sum[1] + sum[5]) + (sum[3] + sum[7]));
}

/// Share of a hit's points whose bit is set in the column.
float share(const VisibilityBits& bits, const SurfaceHit& hit, std::uint32_t column) {
  float sum = 0;
  for (int i = 0; i < hit.count; ++i)
    if (bits.get(hit.point[i], column)) sum += hit.weight[i];
  return std::min(sum, 1.f);
}

}  // namespace

GuidedLighting::GuidedLighting(const ReflectanceFit& fit, const FrameLighting& lighting, SharedStandIns& stand_ins,
                               const DeformedModel& occluders, std::span<const SourceView> views,
                               std::span<const std::uint32_t> list_of_view, const Options& options)
    : fit_(fit),
      lighting_(lighting),
      stand_ins_(stand_ins),
      occluders_(occluders),
      views_(views),
      list_of_view_(list_of_view),
      options_(options),
      row_(padded(lighting.lights().distant.size() + lighting.lights().near_lights.size())),
      offset_(std::max(kRayOffset * occluders.model().bounds().diameter(), occluders.model().positional_error)),
      corrected_(fit.lit.words() != fit.lit_by_rays.words()) {
  for (const DistantLight& light : lighting.lights().distant)
    for (int c = 0; c < 3; ++c) {
      irradiance_[c].push_back(static_cast<float>(light.irradiance[c]));
      direction_[c].push_back(static_cast<float>(light.direction.raw()[c]));
    }
}

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
    hit.indirect_shadow += w * point.indirect_shadow;
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
    const Mat3& m = look_up.acquisition_from_object.raw();
    float* const to[3] = {block.x.data() + h * row_, block.y.data() + h * row_, block.z.data() + h * row_};
    for (int r = 0; r < 3; ++r) {
      const std::array<float, 3> row = floats({m.row[r][0], m.row[r][1], m.row[r][2]});
      for (std::size_t k = 0; k < distant_count; ++k)
        to[r][k] = dot3(row, direction_[0][k], direction_[1][k], direction_[2][k]);
    }
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
        const float energy = irradiance_[0][k] + irradiance_[1][k] + irradiance_[2][k];
        brightest.emplace_back(-cosine(k) * energy, k);
      }
    }
    const auto most = std::min(brightest.size(), static_cast<std::size_t>(options_.shadow_rays));
    if (most < brightest.size())
      std::nth_element(brightest.begin(), brightest.begin() + static_cast<std::ptrdiff_t>(most), brightest.end());
    for (std::size_t i = 0; i < most; ++i) ask(brightest[i].second, std::numeric_limits<double>::infinity());
  }
  std::vector<std::uint8_t> blocked(rays.size(), 0);
  block.shadow_rays += rays.size();
  occluders_.rays().occluded(rays, far_distances, 0, blocked);
  for (std::size_t i = 0; i < asked.size(); ++i) block.visible[asked[i]] = blocked[i] ? 0.f : 1.f;
}

void GuidedLighting::readCaptured(const AcquiredLights& list, GuidedBlock& block, const GuidedBlock::Hit& hit) const {
  block.captured.assign(list.count(), {});
  bool any = false;
  for (const std::uint32_t i : list.usable()) {
    GuidedBlock::Captured& light = block.captured[i];
    const std::array<float, 3> l = floats(list.directionOf(i, hit.query.look_up->p).raw());
    light.x = l[0], light.y = l[1], light.z = l[2];
    const std::uint32_t column = list.ids()[i].value;
    light.lit = share(fit_.lit, *hit.query.hit, column);
    if (corrected_) light.disagree = std::fabs(light.lit - share(fit_.lit_by_rays, *hit.query.hit, column));
    light.usable = share(fit_.lit_around, *hit.query.hit, column);
    if (!options_.model_alone) light.worse = share(fit_.worse, *hit.query.hit, column);
    any = any || light.usable > 0;
  }
  for (const std::uint32_t i : list.usable()) {
    GuidedBlock::Captured& light = block.captured[i];
    const float cosine = dot3(hit.reflectance.normal, light.x, light.y, light.z);
    light.facing = smoothstepf(kLowest, kLowEnough, cosine);
    light.usable = (any ? light.usable : light.lit) * light.facing;
    light.inverse_cosine = 1 / std::max(cosine, kCosine);
  }
}

void GuidedLighting::spread(GuidedBlock& block, std::size_t index, std::uint32_t list_index, std::size_t first) const {
  const GuidedBlock::Hit& hit = block.hits[index];
  const FrameLights& lights = lighting_.lights();
  const std::size_t distant_count = lights.distant.size(), near_count = lights.near_lights.size();
  const bool off = options_.shadows == Shadows::off;
  const AcquiredLights& list = lighting_.lists()[list_index];
  const LookUp& look_up = *hit.query.look_up;
  for (std::size_t k = first; k < distant_count + near_count; ++k) {
    const std::size_t at = index * row_ + k;
    const float x = block.x[at], y = block.y[at], z = block.z[at];
    const float cosine = dot3(hit.reflectance.normal, x, y, z);
    const std::array<float, 3> e =
        floats(k < distant_count ? lights.distant[k].irradiance
                                 : block.near_irradiance[index * near_count + k - distant_count]);
    const Direction<AcquisitionSpace> direction =
        k < distant_count ? look_up.acquisition_from_object * lights.distant[k].direction
                          : normalize(Vector<AcquisitionSpace>(Vec3{x, y, z})).value_or(look_up.normal);
    list.nearest(direction, look_up.p, block.order, block.weights);
    // What the captured lights about this one say: of the shadow, those that shine on the surface at all; and how far
    // the nearest is.
    float lit = 0, lit_facing = 0, facing = 0, usable = 0, disagree = 0, worse = 0, nearest = 4;
    for (const auto& [i, weight] : block.weights) {
      const GuidedBlock::Captured& light = block.captured[i];
      const auto w = static_cast<float>(weight);
      lit += w * light.lit;
      lit_facing += w * light.facing * light.lit;
      facing += w * light.facing;
      usable += w * light.usable;
      disagree += w * light.disagree;
      worse += w * light.worse;
      nearest = std::min(nearest, square(x - light.x) + square(y - light.y) + square(z - light.z));
    }
    const float gate = options_.model_alone ? 1 : hit.gate * (1 - std::min(worse, 1.f));
    const float asked = block.visible[at];
    float visible = asked < 0 ? facing > 0 ? lit_facing / facing : 1 : asked;
    if (disagree > 0 && !off) {
      visible *= 1 - disagree;
      for (const auto& [i, weight] : block.weights)
        visible += static_cast<float>(weight) * block.captured[i].disagree * block.captured[i].lit;
    }
    const float nearness = nearest < kNotNear * kNotNear ? 1 - smoothstepf(kNear, kNotNear, std::sqrt(nearest)) : 0;
    // Below the horizon only what is interpolated as it is could count.
    if (!(cosine > 0) && gate >= 1 && !(hit.indirect_shadow > 0) && !(nearness > 0)) continue;
    const float indirect = hit.indirectUnder(cosine > 0 ? visible : 0);
    const float as_is = off ? 0 : indirect + (1 - indirect) * nearness;
    const float shown = options_.shadows == Shadows::captured ? visible + nearness * (lit - visible) : visible;
    for (int c = 0; c < 3; ++c) block.reach[c][k] = gate * shown * e[c];
    if (options_.model_alone) continue;

    const float relit = usable > 0 && cosine > 0 ? (1 - as_is) * visible * smoothstepf(0, kFade, usable) / usable : 0;
    for (const auto& [i, weight] : block.weights) {
      const GuidedBlock::Captured& light = block.captured[i];
      const auto w = static_cast<float>(weight);
      const float ratio = std::min(kMostRatio, cosine * light.inverse_cosine);
      const float from_lit = w * gate * relit * light.usable * ratio, from_all = w * gate * as_is;
      const float photograph = from_lit + from_all + w * (1 - gate), model = from_lit + from_all * light.lit;
      float* const amount = block.amounts[i].of;
      for (int c = 0; c < 3; ++c) amount[c] += photograph * e[c];
      for (int c = 0; c < 3; ++c) amount[4 + c] += model * e[c];
    }
  }
}

void GuidedLighting::spreadShared(GuidedBlock& block, std::size_t index, std::uint32_t list_index) const {
  const GuidedBlock::Hit& hit = block.hits[index];
  const AcquiredLights& list = lighting_.lists()[list_index];
  const std::size_t count = list.count(), pad = lightPad(list.count()), distant = lighting_.lights().distant.size();
  const float gate = options_.model_alone ? 1 : hit.gate;
  const bool off = options_.shadows == Shadows::off;

  const OrientationGrid::Blend blend = lighting_.sharedCorners(hit.query.look_up->acquisition_from_object);
  std::array<const float*, 4> vectors{};
  const SharedStandIns::Corner* nearest = nullptr;  // of the corner that counts most
  float most = 0;
  for (int i = 0; i < 4; ++i) {
    if (!(blend.share[i] > 0)) continue;
    const SharedStandIns::Corner& corner = stand_ins_.at({list_index, blend.corner[i]}, lighting_);
    vectors[i] = corner.weights.data();
    if (blend.share[i] > most) most = blend.share[i], nearest = &corner;
  }
  for (auto& vector : vectors)
    if (!vector) vector = nearest->weights.data();  // its share is 0
  block.shared.assign(3 * pad, 0);
  addBlend(block.shared.data(), blend.share, vectors, static_cast<int>(3 * pad));

  // What reaches the surface of each light, and of what lies about each captured one.
  block.toward.assign(2 * count, 0);  // energy shown, energy in all
  float* const shown_about = block.toward.data();
  float* const all_about = shown_about + count;
  double reaching = 0;
  for (std::size_t k = 0; k < distant; ++k) {
    const std::size_t at = index * row_ + k;
    const float cosine = dot3(hit.reflectance.normal, block.x[at], block.y[at], block.z[at]);
    if (!(cosine > 0)) continue;
    const std::uint32_t i = nearest->nearest[k];
    const GuidedBlock::Captured& about = block.captured[i];
    const float asked = block.visible[at];
    float visible = asked < 0 ? about.facing > 0 ? about.lit : 1 : asked;
    if (!off) visible += about.disagree * (about.lit - visible);
    float energy = 0;
    for (int c = 0; c < 3; ++c) {
      block.reach[c][k] = gate * (1 - about.worse) * visible * irradiance_[c][k];
      energy += irradiance_[c][k];
    }
    shown_about[i] += visible * energy;
    all_about[i] += energy;
    reaching += visible * energy;
  }
  if (options_.model_alone) return;

  // The residual as it is, and the lit one: of each captured light as much as of the light about it is shown; together
  // what reaches the surface.
  double standing = 0;
  block.amount_lit.assign(count, 0);
  block.as_is.assign(count, 0);
  const auto irradiance = [&](std::uint32_t i, int c) {
    const double inverse = list.inverseIrradiance(i, hit.query.look_up->p)[c];
    return inverse > 0 ? static_cast<float>(1 / inverse) : 0.f;
  };
  for (const std::uint32_t i : list.usable()) {
    const float shown = all_about[i] > 0 ? shown_about[i] / all_about[i] : 1;
    block.amount_lit[i] = block.captured[i].usable * shown;
    if (!off) block.as_is[i] = hit.indirectUnder(all_about[i] > 0 ? shown : block.captured[i].lit);
    for (int c = 0; c < 3; ++c) standing += block.amount_lit[i] * block.shared[c * pad + i] * irradiance(i, c);
  }
  const float scale = standing > 0 ? static_cast<float>(std::min<double>(kMostRatio, reaching / standing)) : 0;
  for (const std::uint32_t i : list.usable()) {
    const float guided = gate * (1 - block.captured[i].worse), from_all = guided * block.as_is[i];
    const float from_lit = guided * (1 - block.as_is[i]) * scale * block.amount_lit[i];
    float* const amount = block.amounts[i].of;
    for (int c = 0; c < 3; ++c) {
      const float e = block.shared[c * pad + i] * irradiance(i, c);
      amount[c] += (from_lit + from_all + 1 - guided) * e;
      amount[4 + c] += (from_lit + from_all * block.captured[i].lit) * e;
    }
  }
}

std::uint32_t GuidedLighting::gather(GuidedBlock& block, std::size_t index, std::uint32_t list_index, LightGather& out,
                                     std::array<double, 3>& color) const {
  const GuidedBlock::Hit& hit = block.hits[index];
  const AcquiredLights& list = lighting_.lists()[list_index];
  const Point<AcquisitionSpace>& p = hit.query.look_up->p;
  const std::size_t longest = std::max(row_, padded(std::max(list.count(), 1)));
  std::array<float*, kModelTerms> terms;
  for (int t = 0; t < kModelTerms; ++t) {
    block.terms[t].resize(longest);
    terms[t] = block.terms[t].data();
  }
  for (int c = 0; c < 3; ++c) {
    block.used_direction[c].resize(longest);
    block.used_amount[c].assign(longest, 0);
  }
  float* const use[3] = {block.used_direction[0].data(), block.used_direction[1].data(),
                         block.used_direction[2].data()};
  const auto use_light = [&](std::size_t to, const GuidedBlock::Captured& light) {
    use[0][to] = light.x, use[1][to] = light.y, use[2][to] = light.z;
  };
  const auto coefficient = [&](int t, int c) { return double{hit.reflectance.coefficient[t][c]}; };

  readCaptured(list, block, hit);
  block.amounts.assign(list.count(), {});
  for (auto& channel : block.reach) channel.assign(row_, 0);
  // Few lights are taken one by one: only so the photograph returns near a captured one.
  const bool shares = lighting_.shares(list_index) && lighting_.lights().distant.size() >= FrameLighting::kFewestShared;
  if (shares) spreadShared(block, index, list_index);
  spread(block, index, list_index, shares ? lighting_.lights().distant.size() : 0);
  double list_share = 0;
  for (const ChosenView& chosen : hit.query.chosen)
    if (list_of_view_[chosen.view] == list_index) list_share += chosen.weight;

  // What reaches the eye by the model.
  modelTerms(hit.reflectance, hit.view,
             {block.x.data() + index * row_, block.y.data() + index * row_, block.z.data() + index * row_,
              static_cast<int>(row_)},
             terms);
  block.model_values += row_;
  for (int t = 0; t < kModelTerms; ++t)
    for (int c = 0; c < 3; ++c)
      color[c] += list_share * coefficient(t, c) * sumOfProducts(block.reach[c].data(), terms[t], row_);

  // The photographs are divided by what their light gave; where a light is dark in a channel they hold nothing.
  for (const std::uint32_t i : list.usable()) {
    const Vec3 inverse = list.inverseIrradiance(i, p);
    for (int c = 0; c < 3; ++c) {
      block.amounts[i].of[c] *= static_cast<float>(inverse[c]);
      if (!(inverse[c] > 0)) block.amounts[i].of[4 + c] = 0;
    }
  }
  for (const RestLight& rest : lighting_.lights().rest) {  // a light of the capture itself: only the view differs
    const auto at = list.find(rest.light);
    if (!at) continue;
    GuidedBlock::Amount& amount = block.amounts[*at];
    const Vec3 inverse = list.inverseIrradiance(*at, p);
    use_light(0, block.captured[*at]);
    modelTerms(hit.reflectance, hit.view, {use[0], use[1], use[2], 1}, terms);
    const float gate = options_.model_alone ? 1 : hit.gate * (1 - block.captured[*at].worse);
    for (int c = 0; c < 3; ++c) {
      if (!options_.model_alone) amount.of[c] += static_cast<float>(rest.scale);
      if (!(inverse[c] > 0)) continue;
      const double lit = gate * rest.scale * block.captured[*at].lit / inverse[c];
      for (int t = 0; t < kModelTerms; ++t) color[c] += list_share * coefficient(t, c) * lit * terms[t][0];
      if (!options_.model_alone) amount.of[4 + c] += static_cast<float>(lit);
    }
  }

  // Only the captured lights that count are evaluated for the views.
  LightWeights weights;
  weights.first_entry = static_cast<std::uint32_t>(out.entries.size());
  std::size_t used = 0;
  for (std::uint32_t i = 0; i < static_cast<std::uint32_t>(list.count()); ++i) {
    const float* const amount = block.amounts[i].of;
    const Rgb photograph{amount[0], amount[1], amount[2]}, model{amount[4], amount[5], amount[6]};
    if (photograph != Rgb{}) out.entries.push_back({i, photograph});
    if (model == Rgb{}) continue;
    use_light(used, block.captured[i]);
    for (int c = 0; c < 3; ++c) block.used_amount[c][used] = model[c];
    ++used;
  }
  // What lies beyond, up to the kernel's width, has amount 0.
  for (std::size_t i = used; i < padded(used); ++i) use[0][i] = use[1][i] = 0, use[2][i] = 1;
  for (const ChosenView& chosen : hit.query.chosen) {
    if (list_of_view_[chosen.view] != list_index || used == 0) continue;
    const std::array<float, 3> view = floats(views_[chosen.view].camera.viewDirection(p).raw());
    modelTerms(hit.reflectance, view, {use[0], use[1], use[2], static_cast<int>(used)}, terms);
    block.model_values += padded(used);
    for (int t = 0; t < kModelTerms; ++t)
      for (int c = 0; c < 3; ++c)
        color[c] -=
            chosen.weight * coefficient(t, c) * sumOfProducts(block.used_amount[c].data(), terms[t], padded(used));
  }
  return out.append(weights, list.count());
}

}  // namespace srf
