// How a pixel comes about: the frame's own stages for one pixel, and every number in between.
#include <algorithm>

#include "base/check.h"
#include "render/frame_state.h"
#include "render/texel_products.h"

namespace srf {
namespace {

/// The entries of a vector of light weights (float[3][lightPad(count)]).
std::vector<LightEntry> nonzero(const float* vector, int count) {
  std::vector<LightEntry> entries;
  const int pad = lightPad(count);
  for (int j = 0; j < count; ++j) {
    const Rgb weight{vector[j], vector[pad + j], vector[2 * pad + j]};
    if (weight != Rgb{}) entries.push_back({static_cast<std::uint32_t>(j), weight});
  }
  return entries;
}

}  // namespace

PixelExplanation FrameRenderer::explain(const Camera<ObjectSpace>& camera, const DeformedModel& deformed,
                                        const FrameLights& lights, int x, int y, const FrameEffects& effects) {
  State& s = *state_;
  SRF_CHECK(x >= 0 && y >= 0 && x < camera.lens.width && y < camera.lens.height);
  const FramePlan plan(s, camera, deformed, lights, effects);
  const auto pixel = static_cast<std::uint32_t>(y * camera.lens.width + x);
  PixelRays rays;
  RaysMet met;
  PixelBlock block;
  ExplainedPixel asked;
  const auto gather = [&] {
    asked = {pixel, {}, {}};
    block.clear();
    deformed.trace(rays.rays, met);
    s.gather(plan, rays, met, block, nullptr, &asked);
  };
  // As the frame does, with its neighbours: hits side by side share shadow rays.
  raysOfPiece(camera, plan.lens, plan.pattern, plan.cover, pieceOfPixel(camera, plan.pattern.size(), x, y), rays);
  gather();
  if (asked.hits.empty() && plan.shading != Shading::every) {  // it takes the mean of its neighbours: as if shaded
    rays = {};
    rays.add(camera, plan.lens, plan.pattern, x, y);
    gather();
  }
  PixelExplanation result;
  result.samples = static_cast<int>(plan.pattern.size());
  result.hits = std::move(asked.hits);
  std::vector<int> hit_of(block.shading.targets, -1);
  for (std::size_t i = 0; i < asked.target.size(); ++i) hit_of[asked.target[i]] = static_cast<int>(i);
  s.shared.want(block.shading.lights, plan.lighting);
  s.shared.compute(plan.lighting);
  s.shading->execute({&block.shading, 1}, s.settings.order);
  const auto colors = hitColors(block.shading, block.guided);
  std::array<double, 4> sum{};
  for (std::size_t i = 0; i < result.hits.size(); ++i) {
    const std::size_t t = asked.target[i];
    if (!block.guided.empty()) result.hits[i].guided = block.guided[t];
    result.hits[i].color = colors[t];
    for (int c = 0; c < 3; ++c) sum[c] += colors[t][c];
    sum[3] += block.alpha.empty() ? 1 : block.alpha[t];
  }
  for (const GroundSample& sample : block.ground)
    for (int c = 0; c < 4; ++c) sum[c] += sample.pixel == pixel ? sample.rgba[c] : 0;
  std::size_t not_finite = 0;
  for (int c = 0; c < 4; ++c) result.rgba[c] = pixelValue(sum[c], plan.pattern.size(), not_finite);

  result.merged.resize(block.shading.lights.weights.size());
  TexelProducts products;
  for (std::size_t i = 0; i < block.shading.operations.size(); ++i) {
    const ShadingOperation& operation = block.shading.operations[i];
    if (hit_of[operation.target] < 0) continue;
    ExplainedHit& hit = result.hits[hit_of[operation.target]];
    hit.operations.push_back(operation);
    hit.results.push_back(block.shading.results[i]);
    const StoreGeometry& geometry = s.selection->views()[operation.view].geometry;
    const int pad = geometry.lightPad();
    std::vector<float> scratch(3 * static_cast<std::size_t>(pad));
    const LightGather& gathered = block.shading.lights;
    const float* vector = gathered.vector(gathered.weights[operation.lights], pad, scratch.data());
    result.merged[operation.lights] = nonzero(vector, geometry.light_count);
    const TilePlace place = geometry.place(operation.tile);
    const BlockCache::Handle handle = s.cache->get(ViewId{operation.view}, operation.tile);
    products.begin(handle.block(), geometry.light_count);
    for (int t = 0; t < 4; ++t) {
      if (!(operation.tap[t] > 0)) continue;
      ShadingOperation alone = operation;
      for (int other = 0; other < 4; ++other) alone.tap[other] = other == t;
      Rgb product;
      products.add(alone, gathered, product);
      products.flush();
      // At a coarser level the first of the pixels that the texel stands for.
      hit.texels.push_back({operation.view,
                            geometry.crop_x + ((place.x * kTile + operation.x + t % 2) << place.level),
                            geometry.crop_y + ((place.y * kTile + operation.y + t / 2) << place.level),
                            operation.tap[t],
                            {product[0], product[1], product[2]}});
    }
  }
  for (ExplainedHit& hit : result.hits)
    if (!hit.chosen.empty()) s.explainLights(lights, plan.lighting.options(), hit);
  return result;
}

void FrameRenderer::State::explainLights(const FrameLights& lights, FrameLighting::Options options,
                                         ExplainedHit& hit) const {
  options.sharing = 0;
  options.only_orientation.reset();
  const auto most = std::max_element(hit.chosen.begin(), hit.chosen.end(),
                                     [](const ChosenView& a, const ChosenView& b) { return a.weight < b.weight; });
  const std::uint32_t list = list_of_view[most->view];
  const auto& acquisition_from_object = hit.look_up.acquisition_from_object;
  const LitPoint point{hit.look_up.p, hit.hit.p_star, acquisition_from_object, hit.look_up.normal};
  const Direction<ObjectSpace> normal = point.normal();
  const auto add = [&](ExplainedLight::Kind kind, const Direction<ObjectSpace>& direction, const FrameLights& one) {
    LightGather gathered;
    FrameLighting(one, lists, options).gather(list, point, gathered);
    const int count = lists[list].count(), pad = lightPad(count);
    std::vector<float> scratch(3 * static_cast<std::size_t>(pad));
    const float* vector = gathered.vector(gathered.weights.front(), pad, scratch.data());
    hit.lights.push_back({kind, direction, acquisition_from_object * direction, nonzero(vector, count)});
  };
  for (const DistantLight& light : lights.distant)
    add(ExplainedLight::Kind::distant, light.direction, {{light}, {}, {}});
  for (const NearLight& light : lights.near_lights)
    add(ExplainedLight::Kind::near_light, normalize(light.position - hit.hit.p_star).value_or(normal),
        {{}, {light}, {}});
  for (const RestLight& light : lights.rest) add(ExplainedLight::Kind::captured, normal, {{}, {}, {light}});
}

}  // namespace srf
