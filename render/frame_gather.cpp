// A block of pixels from its rays to the operations that shade it.
#include <algorithm>
#include <chrono>

#include "base/numeric.h"
#include "render/frame_state.h"
#include "render/look_up.h"

namespace srf {

void FrameRenderer::State::addOperations(std::uint32_t target, const PickedView& picked, std::uint32_t lights,
                                         std::vector<ShadingOperation>& out) const {
  if (!picked.covered) return;
  const StoreGeometry& geometry = selection->views()[picked.view].geometry;
  const float weight = picked.weight;
  const auto view = static_cast<std::uint16_t>(picked.view);
  const int in_x = picked.x & (kTile - 1), in_y = picked.y & (kTile - 1);
  const int tile_x = (picked.x - in_x) / kTile, tile_y = (picked.y - in_y) / kTile;
  const auto tile = [&](int x, int y) { return geometry.tileNumber({picked.level, tile_x + x, tile_y + y}); };
  const auto corner = [](int at) { return static_cast<std::uint8_t>(at); };
  const bool splits_x = in_x == kTile - 1, splits_y = in_y == kTile - 1;
  if (!splits_x && !splits_y) {  // all in one tile
    out.push_back({target,
                   lights,
                   tile(0, 0),
                   view,
                   corner(in_x),
                   corner(in_y),
                   {weight * picked.tap[0], weight * picked.tap[1], weight * picked.tap[2], weight * picked.tap[3]}});
    return;
  }
  // The 2 x 2 texels fall into 2 or 4 tiles; each tile gets the taps that lie in it, at its own first texel.
  for (int y = 0; y <= splits_y; ++y)
    for (int x = 0; x <= splits_x; ++x) {
      const float* const first = picked.tap + 2 * y + x;
      const float right = splits_x ? 0 : first[1], below = splits_y ? 0 : first[2];
      if (!(std::max({first[0], right, below}) > 0)) continue;
      out.push_back({target,
                     lights,
                     tile(x, y),
                     view,
                     corner(x > 0 ? 0 : in_x),
                     corner(y > 0 ? 0 : in_y),
                     {weight * first[0], weight * right, weight * below, 0}});
    }
}

namespace {

/// The rays of a block that are shaded, and memory of choosing them.
struct SparseRays {
  std::vector<MetPlace> places;
  std::vector<std::size_t> shaded;
  PixelRays rays;
};

/// Leaves in `met` what the shaded rays met of a mesh.
void keepShaded(const Camera<ObjectSpace>& camera, const DeformableModel& model, const PixelRays& in, Shading shading,
                RaysMet& met, SparseRays& out, std::vector<PixelBetween>& between) {
  out.places.clear();
  for (const TriangleHit& hit : met.triangles) {
    if (!hit.hit()) {
      out.places.push_back({false, 0, {}});
      continue;
    }
    out.places.push_back(
        {true, hit.distance, pointOfTriangle(model.p0, model.triangles[hit.triangle], hit.b1, hit.b2)});
  }
  out.shaded.clear();
  divideHits(camera, in.pixel, out.places, shading, out.shaded, between);
  out.rays.rays.clear(), out.rays.pixel.clear();
  for (std::size_t i = 0; i < out.shaded.size(); ++i) {  // in rising order
    const std::size_t from = out.shaded[i];
    out.rays.rays.push_back(in.rays[from]);
    out.rays.pixel.push_back(in.pixel[from]);
    met.triangles[i] = met.triangles[from];
  }
  met.triangles.resize(out.shaded.size());
}

/// Of the light that one sample of a pixel stands for (GuidedQuery::variance).
double sampleVariance(const FramePlan& plan, const SurfaceHit& hit) {
  const double size = plan.camera.pixelFootprint(plan.camera.depthOf(hit.p_star));
  return kPixelVariance * size * size / static_cast<double>(plan.pattern.size());
}

}  // namespace

void FrameRenderer::State::gather(const FramePlan& plan, const PixelRays& in, RaysMet& rays_met, PixelBlock& out,
                                  Layers* layers, ExplainedPixel* explained) const {
  const Camera<ObjectSpace>& camera = plan.camera;
  const DeformedModel& deformed = plan.deformed;
  const GuidedLighting* guided = plan.guided ? &*plan.guided : nullptr;
  const int width = camera.lens.width;
  std::span<const Ray<ObjectSpace>> rays = in.rays;
  std::span<const std::uint32_t> pixels = in.pixel;
  using Clock = std::chrono::steady_clock;
  auto clock = Clock::now();
  const auto lap = [&](GatherStage stage) {
    const auto now = Clock::now();
    out.seconds[stage] += std::chrono::duration<double>(now - clock).count();
    clock = now;
  };
  // Without a ground, which wants to know of every ray, triangles that are not shaded need not be blended.
  const bool sparse = plan.shading != Shading::every && !layers;
  const bool before_blend = sparse && !plan.ground && deformed.model().kind == ModelKind::mesh;
  thread_local SparseRays fewer;  // large, and all of it is written
  if (before_blend) {
    keepShaded(camera, deformed.model(), in, plan.shading, rays_met, fewer, out.between);
    rays = fewer.rays.rays, pixels = fewer.rays.pixel;
  }
  thread_local std::vector<SurfaceHit> hit_memory;  // likewise
  if (hit_memory.size() < rays.size()) hit_memory.resize(rays.size());
  const std::span<SurfaceHit> hits(hit_memory.data(), rays.size());
  deformed.blend(rays, rays_met, hits);
  lap(kHits);
  if (plan.ground) {
    out.ground_rays = plan.ground->shade(rays, pixels, width, hits, out.ground);
    lap(kGround);
  }

  thread_local std::vector<std::size_t> met;  // likewise
  met.clear();
  if (sparse && !before_blend) {
    fewer.places.clear();
    for (const SurfaceHit& hit : hits) fewer.places.push_back({hit.count > 0, hit.distance, hit.p0});
    divideHits(camera, pixels, fewer.places, plan.shading, met, out.between);
  } else {
    for (std::size_t i = 0; i < hits.size(); ++i)
      if (hits[i].count > 0) met.push_back(i);
  }
  thread_local std::vector<LookUp> look_up_memory;  // likewise
  if (look_up_memory.size() < met.size()) look_up_memory.resize(met.size());
  const std::span<LookUp> look_ups(look_up_memory.data(), met.size());
  lookUp(hits, met, settings.accuracy.frame, look_ups);  // M11
  for (const LookUp& look_up : look_ups) out.collapsed += look_up.collapsed;
  lap(kLookUp);

  thread_local std::vector<ViewQuery> queries;  // likewise
  queries.clear();
  for (std::size_t m = 0; m < met.size(); ++m) {
    const SurfaceHit& hit = hits[met[m]];
    const LookUp& look_up = look_ups[m];
    ViewQuery& query = queries.emplace_back();
    query.p = look_up.p, query.normal = look_up.normal;
    query.view = look_up.acquisition_from_object * -rays[met[m]].direction;  // v = L v*
    if (!camera.lens.isOrthographic())
      query.eye_distance =
          distance(rays[met[m]].origin, hit.p_star) / std::sqrt(length(cross(hit.tangents.u, hit.tangents.v)));
    query.points = {hit.point, static_cast<std::size_t>(hit.count)};
    query.point_weights = {hit.weight, static_cast<std::size_t>(hit.count)};
  }
  std::vector<std::pair<std::uint32_t, std::uint32_t>> handles;  // (list, light weights) of the hit
  thread_local std::vector<FrameLighting::Wanted> wanted;        // of hits, by handle, weighed below
  wanted.clear();
  out.shading.operations.reserve(met.size() * (static_cast<std::size_t>(settings.accuracy.views) + 1));
  const auto addPicked = [&](std::size_t m, const PickedView& picked) {
    const std::uint32_t list = list_of_view[picked.view];
    auto handle = std::find_if(handles.begin(), handles.end(), [&](const auto& h) { return h.first == list; });
    if (handle == handles.end()) {
      handle = handles.insert(handle, {list, static_cast<std::uint32_t>(wanted.size())});
      wanted.push_back({static_cast<std::uint32_t>(m), list});
    }
    addOperations(static_cast<std::uint32_t>(m), picked, handle->second, out.shading.operations);
  };
  const auto samples = static_cast<double>(plan.pattern.size());
  thread_local ViewSelection::Scratch scratch;
  thread_local ViewSelection::Chosen chosen;
  // Where nothing else asks for the views, a hit's operations are made as soon as they are settled.
  ViewSelection::Take take;
  if (!guided && !settings.matte && !support && !layers && !explained)
    take = [&](std::size_t m, std::span<const PickedView> views) {
      if (levels->mayApply(camera, samples, hits[met[m]], look_ups[m], queries[m].view)) return false;
      handles.clear();
      for (const PickedView& picked : views) addPicked(m, picked);
      return true;
    };
  selection->select(queries, plan.allowed, scratch, chosen, take);  // M12
  for (std::size_t m = 0; m < met.size(); ++m)
    if (const std::size_t count = chosen.first[m + 1] - chosen.first[m])
      levels->apply(camera, samples, hits[met[m]], look_ups[m], queries[m].view,
                    std::span(chosen.views).subspan(chosen.first[m], count));
  if (guided)
    for (std::size_t m = 0; m < met.size(); ++m)
      guided->weigh(hits[met[m]],
                    std::span(chosen.views).subspan(chosen.first[m], chosen.first[m + 1] - chosen.first[m]));
  if (settings.matte) {
    // Each view counts as far as it is covered: what the views add up to is then premultiplied by their coverage.
    for (std::size_t m = 0; m < met.size(); ++m) {
      double& alpha = out.alpha.emplace_back(0);
      for (std::uint32_t i = chosen.first[m]; i < chosen.first[m + 1]; ++i)
        alpha += chosen.views[i].weight *= chosen.views[i].fetch.alpha;
    }
  }

  out.pixel.reserve(met.size());
  Clock::duration supporting{0};
  for (std::size_t m = 0; m < met.size(); ++m) {
    const bool first_of_pixel = out.pixel.empty() || out.pixel.back() != pixels[met[m]];
    out.pixel.push_back(pixels[met[m]]);
    out.not_seen += chosen.result[m] == ViewSelection::Result::not_seen;
    out.no_view += chosen.result[m] == ViewSelection::Result::none;
    handles.clear();
    for (const ChosenView& c : chosen.of(m)) addPicked(m, PickedView::of(c.view, c.weight, c.fetch));
    const SurfaceHit& hit = hits[met[m]];
    if (first_of_pixel && (support || layers)) {
      const int x = static_cast<int>(pixels[met[m]] % width), y = static_cast<int>(pixels[met[m]] / width);
      std::optional<HitSupport> hit_support;
      const bool summed = x % plan.support_step == 0 && y % plan.support_step == 0;
      if (support && (layers || summed)) {
        const auto asked = Clock::now();
        hit_support = support->at(hit, look_ups[m], chosen.of(m), chosen.result[m], plan.lighting);
        supporting += Clock::now() - asked;
        if (summed) out.support.add(*hit_support);
      }
      if (layers) {
        double nearest = kPi;
        for (const SourceView& view : selection->views())
          nearest = std::min(nearest, angleBetween(queries[m].view, view.camera.viewDirection(look_ups[m].p)));
        layers->set(x, y,
                    {hit, look_ups[m], queries[m].view, chosen.of(m), nearest, hit_support ? &*hit_support : nullptr,
                     deformed.model().kind == ModelKind::surfels ? hit.count : 1});
      }
    }
    if (explained && pixels[met[m]] == explained->pixel) {
      const auto views = chosen.of(m);
      explained->target.push_back(static_cast<std::uint32_t>(m));
      explained->hits.push_back({rays[met[m]],
                                 hit,
                                 look_ups[m],
                                 queries[m].view,
                                 chosen.result[m],
                                 {views.begin(), views.end()},
                                 {},
                                 {},
                                 {}});
    }
  }
  out.shading.targets = static_cast<std::uint32_t>(out.pixel.size());
  lap(kViews);
  out.seconds[kSupport] = std::chrono::duration<double>(supporting).count();
  out.seconds[kViews] -= out.seconds[kSupport];

  thread_local GuidedBlock guided_block;  // for its memory
  guided_block.shadow_rays = guided_block.model_values = 0;
  CastShadows::Counts cast_counts;
  const auto light = [&](std::size_t m, LitPoint& point) {
    const LookUp& look_up = look_ups[m];
    point.p = look_up.p, point.p_star = hits[met[m]].p_star;
    point.acquisition_from_object = look_up.acquisition_from_object;
    point.n0 = look_up.normal;
  };
  if (!guided && !plan.cast) {
    thread_local std::vector<LitPoint> points;
    if (points.size() < met.size()) points.resize(met.size());
    for (std::size_t m = 0; m < met.size(); ++m) light(m, points[m]);
    plan.lighting.gather(points, wanted, out.shading.lights);  // M13, M14
  } else if (!guided) {
    LitPoint point;
    for (const auto& [m, list] : wanted) {
      light(m, point);
      plan.cast->gather(list, point, out.shading.lights, cast_counts);
    }
  } else {
    out.guided.resize(met.size());
    thread_local std::vector<GuidedQuery> guided_queries;
    // Of about four hits.
    const int spacing = !sparse ? 1 : plan.shading == Shading::sparse ? 2 : 4;
    const auto cell_side = static_cast<std::uint32_t>(plan.pattern.size() < 4 ? 2 * spacing : 1);
    const auto cellOf = [&](std::uint32_t pixel) -> ShadowCell {
      const std::uint32_t y = pixel / width, x = pixel - y * width;
      return {static_cast<std::int32_t>(x / cell_side), static_cast<std::int32_t>(y / cell_side)};
    };
    std::size_t own = 0;  // room for all at once
    for (const auto& [m, list] : wanted) own += 3 * static_cast<std::size_t>(lightPad(lists[list].count()));
    out.shading.lights.own.reserve(own);
    auto next = wanted.begin();  // in the order of the hits
    for (std::size_t first = 0; first < met.size(); first += guided->hitsAtOnce()) {
      const std::size_t end = std::min(met.size(), first + guided->hitsAtOnce());
      guided_queries.clear();
      for (std::size_t m = first; m < end; ++m)
        guided_queries.push_back({&hits[met[m]], &look_ups[m], queries[m].view, chosen.of(m), cellOf(pixels[met[m]]),
                                  sampleVariance(plan, hits[met[m]])});
      guided->evaluate(guided_queries, guided_block);
      lap(kModelValues);
      guided->castShadows(guided_block);
      lap(kShadows);
      for (LitPoint point; next != wanted.end() && next->point < end; ++next) {
        const auto [m, list] = *next;
        if (guided_block.hits[m - first].gate > 0) {
          guided->gather(guided_block, m - first, list, out.shading.lights, out.guided[m]);
        } else {
          light(m, point);
          plan.lighting.gather(list, point, out.shading.lights);
        }
      }
      lap(kWeights);
      guided->takeAway(guided_block, std::span(out.guided).subspan(first, end - first));
      lap(kModelValues);
    }
  }
  out.shadow_rays = guided_block.shadow_rays + cast_counts.rays;
  out.shadows_not_told = cast_counts.not_told;
  out.model_values = guided_block.model_values;
  lap(kWeights);
  if (settings.order == ExecutionOrder::sorted) sortOperations(out.shading);
  lap(kSort);
}

}  // namespace srf
