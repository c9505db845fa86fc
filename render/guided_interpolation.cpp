#include "render/guided_interpolation.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "base/numeric.h"
#include "render/cast_shadows.h"
#include "render/guided_lanes.h"

namespace srf {
namespace {

// A captured light is divided by its cosine, kept above kCosine.
constexpr float kCosine = 0.1f, kMostRatio = 2;
// The lit residual fades out where less than this share of the captured lights about the one asked for light the point.
constexpr float kFade = 0.25f;
// Within the first of a captured light the photographs' own shadows show, beyond the second those of the rays.
constexpr float kNear = static_cast<float>(radians(1)), kNotNear = static_cast<float>(radians(5));

bool sameWords(const std::uint64_t* a, const std::uint64_t* b, std::size_t count) {
  std::uint64_t differs = 0;
  for (std::size_t i = 0; i < count; ++i) differs |= a[i] ^ b[i];
  return differs == 0;
}
float square(float x) {
  return x * x;
}
float smoothstepf(float edge0, float edge1, float x) {
  const float t = std::clamp((x - edge0) / (edge1 - edge0), 0.f, 1.f);
  return t * t * (3 - 2 * t);
}
/// Where light i of the list stands as seen from p, and what it gives there.
void putCaptured(const AcquiredLights& list, std::uint32_t i, const Point<AcquisitionSpace>& p,
                 GuidedBlock::Captured& to) {
  const std::array<float, 3> l = floats(list.directionOf(i, p).raw());
  const Vec3 inverse = list.inverseIrradiance(i, p);
  to.known[i] = 1;
  for (int c = 0; c < 3; ++c) {
    to.direction[c][i] = l[c];
    to.inverse[c][i] = static_cast<float>(inverse[c]);
    to.irradiance[c][i] = inverse[c] > 0 ? static_cast<float>(1 / inverse[c]) : 0.f;
  }
}

LightClusters clustersFor(std::span<const DistantLight> lights, std::size_t shadow_rays) {
  return clusterLights(lights,
                       lights.size() > kLightsOfARay * shadow_rays ? kClustersOfARay * shadow_rays : lights.size());
}

/// Of what a photograph's value at p stands for (normalSpread).
double photographVariance(const Camera<AcquisitionSpace>& camera, const Fetch& fetch,
                          const Point<AcquisitionSpace>& p) {
  const double size = camera.pixelFootprint(camera.depthOf(p)) * (1 << fetch.level);
  const auto [first, right, below, last] = fetch.tap;
  const float sum = first + right + below + last;
  if (!(sum > 0)) return kPixelVariance * size * size;
  return betweenTexelsVariance((right + last) / sum, (below + last) / sum) * size * size;
}

}  // namespace

void GuidedBlock::Captured::resize(std::size_t lanes) {
  known.assign(lanes, 0);
  for (int c = 0; c < 3; ++c) {
    direction[c].assign(lanes, c == 2 ? 1.f : 0.f);
    irradiance[c].assign(lanes, 0);
    inverse[c].assign(lanes, 0);
  }
}
CapturedLanes GuidedBlock::Captured::lanes() const {
  return {lanesOf(direction), known.data(), channels(irradiance), channels(inverse)};
}

std::vector<std::uint8_t> fitMarks(const ReflectanceFit& fit) {
  std::vector<std::uint8_t> marks(fit.points.size(), 0);
  const std::size_t words = fit.lit.wordsPerPoint();
  for (std::size_t p = 0; p < marks.size(); ++p) {
    const bool worse =
        std::any_of(fit.worse.row(p), fit.worse.row(p) + words, [](std::uint64_t word) { return word != 0; });
    marks[p] = static_cast<std::uint8_t>((sameWords(fit.lit.row(p), fit.lit_by_rays.row(p), words) ? 0 : kOverruled) |
                                         (worse ? kWorseSomewhere : 0));
  }
  return marks;
}

GuidedLighting::GuidedLighting(const ReflectanceFit& fit, std::span<const std::uint8_t> marks,
                               const FrameLighting& lighting, SharedStandIns& stand_ins, const DeformedModel& occluders,
                               std::span<const SourceView> views, std::span<const std::uint32_t> list_of_view,
                               const Options& options)
    : fit_(fit),
      marks_(marks),
      lighting_(lighting),
      stand_ins_(stand_ins),
      occluders_(occluders),
      views_(views),
      list_of_view_(list_of_view),
      options_(options),
      clusters_(clustersFor(lighting.lights().distant, static_cast<std::size_t>(std::max(1, options.shadow_rays)))),
      near_clusters_(clusters_.count() > static_cast<std::size_t>(options.shadow_rays)
                         ? nearClusters(clusters_, kOneShadow)
                         : NearClusters()),
      distant_lanes_(paddedLanes(lighting.lights().distant.size())),
      cluster_lanes_(paddedLanes(clusters_.count())),
      near_lanes_(paddedLanes(lighting.lights().near_lights.size())),
      offset_(occluders.shadowOffset()) {
  energy_.assign(distant_lanes_, 0);
  for (int c = 0; c < 3; ++c) {
    irradiance_[c].assign(distant_lanes_, 0);
    direction_[c].assign(distant_lanes_, c == 2 ? 1.f : 0.f);
  }
  for (std::size_t k = 0; k < lighting.lights().distant.size(); ++k) {
    const DistantLight& light = lighting.lights().distant[k];
    for (int c = 0; c < 3; ++c) {
      irradiance_[c][k] = static_cast<float>(light.irradiance[c]);
      direction_[c][k] = static_cast<float>(light.direction.raw()[c]);
    }
    energy_[k] = irradiance_[0][k] + irradiance_[1][k] + irradiance_[2][k];
  }
  for (const AcquiredLights& list : lighting.lists()) {
    List& to = lists_.emplace_back();
    to.in_order = true;
    for (std::size_t i = 0; i < list.ids().size(); ++i) to.in_order = to.in_order && list.ids()[i].value == i;
    if (!list.distant()) continue;
    to.captured.resize(lightPad(list.count()));
    for (const std::uint32_t i : list.usable()) putCaptured(list, i, Point<AcquisitionSpace>(), to.captured);
  }
}

void GuidedLighting::weigh(const SurfaceHit& hit, std::span<ChosenView> chosen) const {
  double slant = options_.model_alone ? 0.5 : 0;
  for (int i = 0; i < hit.count && !options_.model_alone; ++i) {
    const FittedPoint& point = fit_.points[hit.point[i]];
    slant += double{hit.weight[i]} * double{point.gate} * double{point.slant};
  }
  if (!(slant > 0) || chosen.size() < 2) return;
  double sum = 0;
  for (ChosenView& view : chosen) {
    const double root = view.foreshortening;
    sum += view.weight *= slant < 0.5 ? lerp(1, root, 2 * slant) : lerp(root, root * root * root, 2 * slant - 1);
  }
  for (ChosenView& view : chosen) view.weight /= sum;
}

void GuidedLighting::blend(const GuidedQuery& query, GuidedBlock::Hit& hit) const {
  hit.query = query;
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
    for (int k = 0; k < 6; ++k) hit.turn[k] += w * point.turn[k];
    // The tangent is an axis: turned to the side of the first.
    const float side = dot3(to.tangent, from.tangent[0], from.tangent[1], from.tangent[2]) < 0 ? -w : w;
    for (int c = 0; c < 3; ++c) {
      to.normal[c] += w * from.normal[c];
      to.tangent[c] += side * from.tangent[c];
      for (int k = 0; k < kModelTerms; ++k) to.coefficient[k][c] += w * from.coefficient[k][c];
    }
  }
  if (options_.model_alone) hit.gate = 1;
  const auto direction = [](const std::array<float, 3>& a) {
    return normalize(Vector<AcquisitionSpace>(Vec3{a[0], a[1], a[2]}));
  };
  const Direction<AcquisitionSpace> n = direction(to.normal).value_or(query.look_up->normal);
  const Vec3 t{to.tangent[0], to.tangent[1], to.tangent[2]};
  const Direction<AcquisitionSpace> tangent =
      normalize(Vector<AcquisitionSpace>(t - dot(n.raw(), t) * n.raw())).value_or(anyPerpendicular(n));
  to.normal = floats(n.raw());
  to.tangent = floats(tangent.raw());
  const std::array<float, 3> view = floats(query.view.raw());
  const SymmetricMatrix part = partSeen(to.normal, view, static_cast<float>(query.variance));
  hit.seen = seenThrough(to, normalSpread(hit.turn, part));
  hit.model = modelOfPoint(hit.seen);
  hit.model_view = addView(hit.model, hit.seen, view, 1);
  turn(hit.model, hit.model_view, query.look_up->acquisition_from_object.raw().transposed());
}

std::size_t GuidedLighting::hitsAtOnce() const {
  constexpr std::size_t kAnswers = std::size_t{1} << 16;  // lights of all hits together, 12 bytes each
  return std::max<std::size_t>(kVectorLanes, kAnswers / std::max<std::size_t>(row(), 1));
}

void GuidedLighting::evaluate(std::span<const GuidedQuery> queries, GuidedBlock& block) const {
  const FrameLights& lights = lighting_.lights();
  block.hits.assign(queries.size(), {});
  for (int c = 0; c < 3; ++c) {
    block.near_direction[c].assign(queries.size() * near_lanes_, c == 2 ? 1.f : 0.f);
    block.near_irradiance[c].assign(queries.size() * near_lanes_, 0);
    block.answer[c].resize(std::max(block.answer[c].size(), queries.size() * row()));
  }
  block.last_corner = {};
  block.corners.clear();
  block.taken.clear();
  block.used = 0;
  for (GuidedBlock::Nearest& list : block.near_weights) list.weight.clear();
  for (std::size_t h = 0; h < queries.size(); ++h) {
    GuidedBlock::Hit& hit = block.hits[h];
    blend(queries[h], hit);
    const std::size_t near = h * near_lanes_;
    for (std::size_t k = 0; k < lights.near_lights.size(); ++k) {  // Eq. 11: A(|p* - p_l|) I_l
      const Vector<ObjectSpace> to_light = lights.near_lights[k].position - queries[h].hit->p_star;
      const double d = std::max(length(to_light), options_.min_distance);
      const LookUp& look_up = *queries[h].look_up;
      const std::array<float, 3> l =
          floats(normalize(to_light).value_or(look_up.acquisition_from_object.inverse() * look_up.normal).raw());
      const std::array<float, 3> e = floats(lights.near_lights[k].intensity / (d * d));
      for (int c = 0; c < 3; ++c) block.near_direction[c][near + k] = l[c], block.near_irradiance[c][near + k] = e[c];
    }
    if (!(hit.gate > 0)) continue;
    block.model_values += modelAnswers(hit.model, hit.model_view, lanesOf(direction_), channels(irradiance_),
                                       distant_lanes_, channels<float>(block.answer, h * row()));
    block.model_values += modelAnswers(hit.model, hit.model_view, lanesOf(block.near_direction, near),
                                       channels(std::as_const(block.near_irradiance), near), near_lanes_,
                                       channels<float>(block.answer, h * row() + distant_lanes_));
  }
}

void GuidedLighting::share(const VisibilityBits& bits, std::uint32_t list, const SurfaceHit& hit,
                           std::vector<float>& shares) const {
  const std::uint64_t* rows[SurfaceHit::kMostPoints];
  for (int i = 0; i < hit.count; ++i) rows[i] = bits.row(hit.point[i]);
  if (lists_[list].in_order) {
    // The list may be shorter than a row, and its padding longer.
    const std::size_t columns = std::min(shares.size(), 64 * bits.wordsPerPoint());
    std::fill(shares.begin() + static_cast<std::ptrdiff_t>(columns), shares.end(), 0.f);
    const auto like_first = [&](const std::uint64_t* row) { return sameWords(row, rows[0], bits.wordsPerPoint()); };
    if (!std::all_of(rows + 1, rows + hit.count, like_first))
      return shareBits(rows, hit.weight, hit.count, columns, shares.data());
    float weight = 0;  // as they add up one after the other
    for (int i = 0; i < hit.count; ++i) weight += hit.weight[i];
    return shareBits(rows, &weight, 1, columns, shares.data());
  }
  std::fill(shares.begin(), shares.end(), 0.f);
  const std::vector<LightId>& ids = lighting_.lists()[list].ids();
  for (std::size_t i = 0; i < ids.size(); ++i) {
    float sum = 0;
    for (int k = 0; k < hit.count; ++k)
      if (bits.get(hit.point[k], ids[i].value)) sum += hit.weight[k];
    shares[i] = std::min(sum, 1.f);
  }
}

CapturedLanes GuidedLighting::readCaptured(std::uint32_t list_index, GuidedBlock& block,
                                           const GuidedBlock::Hit& hit) const {
  const AcquiredLights& list = lighting_.lists()[list_index];
  const std::size_t lanes = lightPad(list.count());
  if (!list.distant()) {
    block.captured.resize(lanes);
    for (const std::uint32_t i : list.usable()) putCaptured(list, i, hit.query.look_up->p, block.captured);
  }
  const CapturedLanes captured = (list.distant() ? lists_[list_index].captured : block.captured).lanes();
  for (std::vector<float>* of : {&block.lit, &block.usable, &block.facing, &block.disagree, &block.gate})
    of->resize(lanes);
  const SurfaceHit& surface = *hit.query.hit;
  std::uint8_t marks = 0;
  for (int i = 0; i < surface.count; ++i) marks |= marks_[surface.point[i]];
  share(fit_.lit, list_index, surface, block.lit);
  share(fit_.lit_around, list_index, surface, block.usable);
  block.disagrees = marks & kOverruled;
  if (block.disagrees) {
    share(fit_.lit_by_rays, list_index, surface, block.disagree);
    for (std::size_t i = 0; i < lanes; ++i)
      block.disagree[i] = captured.known[i] * std::fabs(block.lit[i] - block.disagree[i]);
  }
  block.same_gate = options_.model_alone || !(marks & kWorseSomewhere);
  if (block.same_gate) {
    std::fill(block.gate.begin(), block.gate.end(), hit.gate);
  } else {
    share(fit_.worse, list_index, surface, block.gate);
    for (float& gate : block.gate) gate = hit.gate * (1 - gate);
  }
  facingCaptured(hit.reflectance.normal, captured, lanes, block.lit.data(), block.usable.data(), block.facing.data());
  return captured;
}

void GuidedLighting::findNear(GuidedBlock& block, std::uint32_t list_index) const {
  block.near_weights.resize(lists_.size());
  GuidedBlock::Nearest& found = block.near_weights[list_index];
  const auto cells = lighting_.lists()[list_index].cells();
  if (!found.weight.empty() || !(lighting_.options().sharing > 0) || !cells) return;
  const std::vector<NearLight>& lights = lighting_.lights().near_lights;
  const std::size_t lanes = paddedLanes(block.hits.size()),
                    k = static_cast<std::size_t>(lighting_.lists()[list_index].k());
  found.weight.resize(lights.size() * k * lanes);
  found.light.resize(found.weight.size());
  block.near_cells.resize(lanes);
  for (auto& axis : block.near_axis) axis.assign(lanes, 0);
  const auto [x, y, z] = channels<float>(block.near_axis);
  for (std::size_t l = 0; l < lights.size(); ++l) {
    for (std::size_t h = 0; h < lanes; ++h) {
      const std::size_t at = std::min(h, block.hits.size() - 1);
      const DirectionLanes d = lanesOf(block.near_direction, at * near_lanes_ + l);
      const Vec3 direction =
          block.hits[at].query.look_up->acquisition_from_object.raw() * Vec3{double{*d.x}, double{*d.y}, double{*d.z}};
      x[h] = static_cast<float>(direction.x), y[h] = static_cast<float>(direction.y);
      z[h] = static_cast<float>(direction.z);
    }
    lightCells(x, y, z, lanes, cells->resolution, block.near_cells.data());
    nearestWeights(*cells, x, y, z, block.near_cells.data(), block.hits.size(), static_cast<int>(k), lanes,
                   &found.weight[l * k * lanes], &found.light[l * k * lanes]);
  }
}

float GuidedLighting::spread(GuidedBlock& block, const GuidedBlock::Hit& hit, const CapturedLanes& captured,
                             const Direction<AcquisitionSpace>& direction, float cosine, LightSight sight,
                             const std::array<float, 3>& e) const {
  const bool off = options_.shadows == Shadows::off;
  const std::array<float, 3> l = floats(direction.raw());
  const auto [x, y, z] = captured.direction;
  // What the captured lights about this one say: of the shadow, those that shine on the surface at all; and how far
  // the nearest is.
  float lit = 0, lit_facing = 0, facing = 0, usable = 0, disagree = 0, gate = 0, nearest = 4;
  for (const auto& [i, weight] : block.weights) {
    const auto w = static_cast<float>(weight);
    lit += w * block.lit[i];
    lit_facing += w * block.facing[i] * block.lit[i];
    facing += w * block.facing[i];
    usable += w * block.usable[i];
    if (block.disagrees) disagree += w * block.disagree[i];
    gate += w * block.gate[i];
    nearest = std::min(nearest, square(l[0] - x[i]) + square(l[1] - y[i]) + square(l[2] - z[i]));
  }
  if (!off && !(cosine > 0)) sight = kHidden;
  if (block.same_gate) gate = hit.gate;
  float visible = sight != kNotAsked ? static_cast<float>(sight) : facing > 0 ? lit_facing / facing : 1;
  if (disagree > 0 && !off) {
    visible *= 1 - disagree;
    for (const auto& [i, weight] : block.weights)
      visible += static_cast<float>(weight) * block.disagree[i] * block.lit[i];
  }
  const float nearness = nearest < kNotNear * kNotNear ? 1 - smoothstepf(kNear, kNotNear, std::sqrt(nearest)) : 0;
  // Below the horizon only the difference beside a captured light, or of unlit lights, could count.
  if (!(cosine > 0) && gate >= 1 && !(hit.indirect_shadow > 0) && !(nearness > 0)) return 0;
  const float shown = options_.shadows == Shadows::captured ? visible + nearness * (lit - visible) : visible;
  if (options_.model_alone) return gate * shown;

  // Of the residual: as it is, of lights that light the point, and of those that do not.
  const float reaches = cosine > 0 ? visible : 0, far = off ? 1 : 1 - nearness;
  const float indirect = off ? 0 : hit.indirect, indirect_shadow = off ? 0 : hit.indirect_shadow;
  const auto relight = [](float share) { return share > 0 ? smoothstepf(0, kFade, share) / share : 0; };
  const float as_is = 1 - far + far * reaches * indirect;
  const float relit = far * (1 - indirect) * reaches * relight(usable);
  const float unlit = far * indirect_shadow * (1 - reaches) * relight(1 - lit);
  for (const auto& [i, weight] : block.weights) {
    const auto w = static_cast<float>(weight);
    const float ratio =
        std::min(kMostRatio, cosine / std::max(dot3(hit.reflectance.normal, x[i], y[i], z[i]), kCosine));
    const float from_lit = w * gate * relit * block.usable[i] * ratio, from_all = w * gate * as_is;
    const float from_dark = w * gate * unlit * (1 - block.lit[i]);
    const float photograph = from_lit + from_all + from_dark + w * (1 - gate),
                model = from_lit + from_all * block.lit[i];
    block.singles.push_back(
        {i, {photograph * e[0], photograph * e[1], photograph * e[2]}, {model * e[0], model * e[1], model * e[2]}});
  }
  return gate * shown;
}

const SharedStandIns::Corner& GuidedLighting::corner(GuidedBlock& block, int slot, const SharedKey& key) const {
  // Neighbouring hits mostly want the same ones.
  for (int i = 0; i < 4; ++i) {
    const int at = (slot + i) % 4;
    if (block.last_corner[at] && block.last_key[at] == key) return *block.last_corner[at];
  }
  block.last_key[slot] = key;
  block.last_corner[slot] = &stand_ins_.at(key, lighting_);
  return *block.last_corner[slot];
}

ResidualShares GuidedLighting::spreadShared(GuidedBlock& block, std::size_t index, std::uint32_t list_index,
                                            std::array<float, 3>& sum) const {
  const GuidedBlock::Hit& hit = block.hits[index];
  const AcquiredLights& list = lighting_.lists()[list_index];
  const std::size_t pad = lightPad(list.count());
  const bool off = options_.shadows == Shadows::off;

  if (block.corners.empty()) {
    block.corners.resize(block.hits.size());
    lighting_.sharedCorners(
        [&](std::size_t h) -> const auto& { return block.hits[h].query.look_up->acquisition_from_object; },
        block.corners);
  }
  const OrientationGrid::Blend& blend = block.corners[index];
  std::array<const float*, 4> vectors{};
  const SharedStandIns::Corner* nearest = nullptr;  // of the corner that counts most
  float most = 0;
  for (int i = 0; i < 4; ++i) {
    if (!(blend.share[i] > 0)) continue;
    const SharedStandIns::Corner& at = corner(block, i, {list_index, blend.corner[i]});
    vectors[i] = at.irradiance.data();
    if (blend.share[i] > most) most = blend.share[i], nearest = &at;
  }

  // What reaches the surface of each light, and of what lies about each captured one. What no ray was sent to is as
  // the captured light about it, where that can tell; where photographs overrule the rays, these count as far less.
  block.shown.resize(3 * pad);
  shownBySight(block.lit.data(), block.facing.data(), block.disagrees && !off ? block.disagree.data() : nullptr, pad,
               block.shown.data());
  block.energy.assign(4 * pad, 0);
  sum = distantSums(hit.model.n, {lanesOf(direction_), energy_.data()},
                    channels(std::as_const(block.answer), index * row()), block.sight.data() + index * row(),
                    nearest->nearest.data(), {block.shown.data(), pad, block.same_gate ? nullptr : block.gate.data()},
                    distant_lanes_, block.energy.data());
  if (block.same_gate)
    for (float& channel : sum) channel *= hit.gate;

  // The residual as it is, and the lit one: of each captured light as much as of the light about it is shown; together
  // what reaches the surface.
  const float* shared = nearest->irradiance.data();
  if (most < 1) {
    for (auto& vector : vectors)
      if (!vector) vector = shared;  // its share is 0
    block.shared.resize(3 * pad);
    blendVectors(vectors, blend.share, 3 * pad, block.shared.data());
    shared = block.shared.data();
  }
  return {off ? 0 : hit.indirect,
          off ? 0 : hit.indirect_shadow,
          kMostRatio,
          block.energy.data(),
          block.gate.data(),
          block.lit.data(),
          block.usable.data(),
          {shared, shared + pad, shared + 2 * pad}};
}

std::uint32_t GuidedLighting::gather(GuidedBlock& block, std::size_t index, std::uint32_t list_index, LightGather& out,
                                     std::array<double, 3>& color) const {
  const GuidedBlock::Hit& hit = block.hits[index];
  const FrameLights& lights = lighting_.lights();
  const AcquiredLights& list = lighting_.lists()[list_index];
  const LookUp& look_up = *hit.query.look_up;
  const std::size_t pad = lightPad(list.count()), near_count = lights.near_lights.size();
  // The weights are written last: until then their memory can come near.
  if (out.own.capacity() - out.own.size() >= 3 * pad)
    for (std::size_t i = 0; i < 3 * pad; i += kVectorLanes) __builtin_prefetch(out.own.data() + out.own.size() + i, 1);
  double list_share = 0;
  for (const ChosenView& chosen : hit.query.chosen)
    if (list_of_view_[chosen.view] == list_index) list_share += chosen.weight;
  const auto add = [&](double share, const std::array<float, 3>& sum) {
    for (int c = 0; c < 3; ++c) color[c] += share * double{sum[c]};
  };

  const CapturedLanes captured = readCaptured(list_index, block, hit);
  // What reaches the eye by the model, and what stands for it among the photographs.
  // Few lights are taken one by one: only so the photograph returns near a captured one.
  const bool shared = lighting_.shares(list_index) && lights.distant.size() >= FrameLighting::kFewestShared;
  block.singles.clear();
  const auto answer = channels(std::as_const(block.answer), index * row());
  ResidualShares shares{};
  if (shared) {
    std::array<float, 3> sum;
    shares = spreadShared(block, index, list_index, sum);
    add(list_share, sum);
  } else if (!lights.distant.empty()) {
    block.reach.assign(distant_lanes_, 0);
    for (std::size_t k = 0; k < lights.distant.size(); ++k) {
      const std::array<float, 3> e{irradiance_[0][k], irradiance_[1][k], irradiance_[2][k]};
      const Direction<AcquisitionSpace> direction = look_up.acquisition_from_object * lights.distant[k].direction;
      list.nearest(direction, look_up.p, block.order, block.weights);
      block.reach[k] = spread(block, hit, captured, direction,
                              dot3(hit.model.n, direction_[0][k], direction_[1][k], direction_[2][k]),
                              static_cast<LightSight>(block.sight[index * row() + k]), e);
    }
    add(list_share, shownSums(answer, block.reach.data(), distant_lanes_));
  }
  if (near_count > 0) {
    findNear(block, list_index);
    const GuidedBlock::Nearest& found = block.near_weights[list_index];
    std::array<float, 3> sum{};
    const DirectionLanes l = lanesOf(block.near_direction, index * near_lanes_);
    const std::array<const float*, 3> irradiance = channels(std::as_const(block.near_irradiance), index * near_lanes_);
    for (std::size_t k = 0; k < near_count; ++k) {
      const auto direction = look_up.acquisition_from_object *
                             Direction<ObjectSpace>::fromUnit(Vec3{double{l.x[k]}, double{l.y[k]}, double{l.z[k]}});
      block.weights.clear();
      const std::size_t lanes = paddedLanes(block.hits.size());
      for (std::size_t j = 0; !found.weight.empty() && j < static_cast<std::size_t>(list.k()); ++j) {
        const std::size_t at = (k * list.k() + j) * lanes + index;
        if (!(found.weight[at] > 0)) break;  // by falling weight
        block.weights.push_back({found.light[at], found.weight[at]});
      }
      if (block.weights.empty()) list.nearest(direction, look_up.p, block.order, block.weights);
      const float shown = spread(block, hit, captured, direction, dot3(hit.model.n, l.x[k], l.y[k], l.z[k]),
                                 static_cast<LightSight>(block.sight[index * row() + distant_lanes_ + k]),
                                 {irradiance[0][k], irradiance[1][k], irradiance[2][k]});
      for (int c = 0; c < 3; ++c) sum[c] += shown * answer[c][distant_lanes_ + k];
    }
    add(list_share, sum);
  }

  for (const RestLight& rest : lights.rest) {  // a light of the capture itself: only the view differs
    const auto at = list.find(rest.light);
    if (!at) continue;
    std::array<std::vector<float>, 3> l, e;
    const std::array<float, 3> direction{captured.direction.x[*at], captured.direction.y[*at],
                                         captured.direction.z[*at]};
    for (int c = 0; c < 3; ++c) {
      l[c].assign(kVectorLanes, direction[c]);
      e[c].assign(kVectorLanes, 0);
      e[c][0] = block.gate[*at] * static_cast<float>(rest.scale) * block.lit[*at] * captured.irradiance[c][*at];
    }
    if (!options_.model_alone) block.singles.push_back({*at, {0, 0, 0}, {e[0][0], e[1][0], e[2][0]}});
    ModelOfPoint model = modelOfPoint(hit.seen);
    const ModelView view = addView(model, hit.seen, floats(hit.query.view.raw()), 1);
    add(list_share, modelSums(model, &view, 1, lanesOf(l), channels(std::as_const(e)), kVectorLanes));
    block.model_values += 1;
  }

  // The photographs are divided by what their light gave; where a light is dark in a channel they hold nothing.
  // Only the captured lights that count are evaluated for the views.
  LightWeights weights;
  weights.first_entry = static_cast<std::uint32_t>(out.entries.size());
  if (options_.model_alone) return out.append(weights, list.count());
  weights.own = static_cast<std::uint32_t>(out.own.size());
  out.own.resize(out.own.size() + 3 * pad);
  float* const own = out.own.data() + weights.own;
  const bool few = shared;  // single lights: added to what stands for the others
  if (!few) {
    for (int c = 0; c < 3; ++c) {
      block.photograph[c].assign(pad, 0);
      block.model[c].assign(pad, 0);
    }
    for (const GuidedBlock::Single& one : block.singles)
      for (int c = 0; c < 3; ++c) {
        block.photograph[c][one.light] += one.photograph[c];
        block.model[c][one.light] += one.model[c];
      }
  }
  const std::size_t first = block.used;
  for (int c = 0; c < 3; ++c)
    for (std::vector<float>* lanes : {&block.used_direction[c], &block.used_amount[c]})
      lanes->resize(std::max(lanes->size(), first + paddedLanes(pad + (few ? block.singles.size() : 0))));
  const UsedLanes to{channels<float>(block.used_direction, first), channels<float>(block.used_amount, first)};
  std::size_t photographs = 0;
  const ResidualAmounts amounts{channels(std::as_const(block.photograph)), channels(std::as_const(block.model))};
  std::size_t used = usedLights(captured, pad, shared ? &shares : nullptr, few ? nullptr : &amounts,
                                {own, own + pad, own + 2 * pad}, to, photographs);
  if (few && !block.singles.empty()) {
    const std::array<const float*, 3> direction{captured.direction.x, captured.direction.y, captured.direction.z};
    for (const GuidedBlock::Single& one : block.singles) {
      for (int c = 0; c < 3; ++c) {
        const float inverse = captured.inverse[c][one.light];
        own[c * pad + one.light] += one.photograph[c] * inverse;
        to.direction[c][used] = direction[c][one.light];
        to.model[c][used] = inverse > 0 ? one.model[c] : 0;
      }
      ++used;
    }
    photographs += block.singles.size();
    for (std::size_t i = used; i < paddedLanes(used); ++i)
      for (int c = 0; c < 3; ++c) to.direction[c][i] = c == 2, to.model[c][i] = 0;
  }
  for (const RestLight& rest : lights.rest)
    if (const auto at = list.find(rest.light))
      for (int c = 0; c < 3; ++c) own[c * pad + *at] += static_cast<float>(rest.scale);
  if (used > 0) {
    block.taken.push_back({static_cast<std::uint32_t>(index), list_index, first, used});
    block.used += paddedLanes(used);
  }
  if (photographs + lights.rest.size() <= LightGather::fewEntries(list.count())) {
    for (std::uint32_t i = 0; i < static_cast<std::uint32_t>(list.count()); ++i) {
      const Rgb photograph{own[i], own[pad + i], own[2 * pad + i]};
      if (photograph != Rgb{}) out.entries.push_back({i, photograph});
    }
    out.own.resize(weights.own);
    weights.own = LightWeights::kNone;
  }
  return out.append(weights, list.count());
}

void GuidedLighting::takeAway(GuidedBlock& block, std::span<std::array<double, 3>> colors) const {
  for (const GuidedBlock::Taken& taken : block.taken) {
    const GuidedBlock::Hit& hit = block.hits[taken.hit];
    const Point<AcquisitionSpace>& p = hit.query.look_up->p;
    // The lobe as these photographs show it, in their mean.
    block.sights.clear();
    SymmetricMatrix part{};
    float share = 0;
    for (const ChosenView& chosen : hit.query.chosen) {
      if (list_of_view_[chosen.view] != taken.list) continue;
      const Camera<AcquisitionSpace>& camera = views_[chosen.view].camera;
      const auto weight = static_cast<float>(chosen.weight);
      block.sights.push_back({floats(camera.viewDirection(p).raw()), weight});
      const SymmetricMatrix of_view = partSeen(hit.reflectance.normal, block.sights.back().view,
                                               static_cast<float>(photographVariance(camera, chosen.fetch, p)));
      for (int k = 0; k < 6; ++k) part[k] += weight * of_view[k];
      share += weight;
    }
    for (float& of_part : part) of_part = share > 0 ? of_part / share : 0;
    const PointReflectance photographed = seenThrough(hit.reflectance, normalSpread(hit.turn, part));
    ModelOfPoint model = modelOfPoint(photographed);
    block.model_views.clear();
    for (const GuidedBlock::Sight& sight : block.sights)
      block.model_views.push_back(addView(model, photographed, sight.view, sight.weight));
    const std::array<float, 3> sum =
        modelSums(model, block.model_views.data(), block.model_views.size(), lanesOf(block.used_direction, taken.first),
                  channels(std::as_const(block.used_amount), taken.first), paddedLanes(taken.count));
    for (int c = 0; c < 3; ++c) colors[taken.hit][c] -= double{sum[c]};
    block.model_values += taken.count * block.model_views.size();
  }
}

}  // namespace srf
