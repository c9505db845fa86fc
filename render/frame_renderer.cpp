#include "render/frame_renderer.h"

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cmath>
#include <limits>
#include <numeric>

#include "base/memory.h"
#include "base/parallel.h"
#include "render/frame_state.h"
#include "render/look_up.h"

namespace srf {
namespace {

// Of scratch memory of threads and libraries, bytes, besides what grows with the budget.
constexpr std::size_t kPassing = std::size_t{32} << 20;

// Pieces whose rays are traced one after the other: the scene's tree then stays in the processor's cache.
constexpr std::size_t kTracedTogether = 4;

using Clock = std::chrono::steady_clock;
double secondsSince(Clock::time_point start) {
  return std::chrono::duration<double>(Clock::now() - start).count();
}

/// Samples of a pixel: as many as asked for, and where surfels are smaller than a pixel, as many as these lie in it
/// (the low-pass of EWA splatting, by quadrature: every sample is a look-up of its own. A splat enlarged to the pixel
/// would blend places and then look up one of them, which still is one texel out of many).
int samplesOf(const FrameSettings& settings, const Camera<ObjectSpace>& camera, const DeformedModel& deformed) {
  constexpr int kMostAcross = 8;
  const int across = std::min(deformed.raysAcross(camera), kMostAcross);
  return std::max({1, settings.samples, across * across});
}

/// L of every point of the model, where it is the same for all: the frame is at rest or moved rigidly (or scaled).
std::optional<Orthogonal<AcquisitionSpace, ObjectSpace>> onlyOrientation(const DeformedModel& deformed,
                                                                         FrameMode mode) {
  constexpr double kSame = 1e-9;  // far above rounding, far below what weights of lights can show
  const DeformableModel& model = deformed.model();
  if (model.size() == 0) return std::nullopt;
  const auto hitAt = [&](std::size_t i, SurfaceHit& hit) {
    hit.acquisition_from_tangent = rotationFromRodrigues(model.r0[i]);
    hit.tangents = deformed.tangents()[i];
  };
  SurfaceHit first;
  hitAt(0, first);
  const Mat3 only = lookUp(first, mode).acquisition_from_object.raw();
  std::atomic<bool> differ = false;
  parallelFor(model.size(), 4096, [&](std::size_t begin, std::size_t end) {
    constexpr std::size_t kAtOnce = 64;
    std::array<SurfaceHit, kAtOnce> hits;
    std::array<LookUp, kAtOnce> look_ups;
    std::array<std::size_t, kAtOnce> which;
    std::iota(which.begin(), which.end(), std::size_t{0});
    for (std::size_t i = begin; i < end && !differ; i += kAtOnce) {
      const std::size_t count = std::min(kAtOnce, end - i);
      for (std::size_t k = 0; k < count; ++k) hitAt(i + k, hits[k]);
      lookUp(hits, std::span(which).first(count), mode, look_ups);
      for (std::size_t k = 0; k < count; ++k) {
        bool same = !look_ups[k].collapsed;
        for (int row = 0; row < 3; ++row)
          for (int column = 0; column < 3; ++column) {
            const double off = look_ups[k].acquisition_from_object.raw().row[row][column] - only.row[row][column];
            same = same && std::fabs(off) <= kSame;
          }
        if (!same) differ = true;
      }
    }
  });
  if (differ) return std::nullopt;
  return Orthogonal<AcquisitionSpace, ObjectSpace>(only);
}

FrameLighting::Options lightingOptions(const FrameRenderer::State& state, const DeformedModel& deformed,
                                       const FrameLights& lights) {
  FrameLighting::Options options;
  options.sharing = state.settings.shortcuts ? state.settings.accuracy.light_sharing : 0;
  options.min_distance = std::max(state.settings.accuracy.min_distance, 1e-9) * state.diameter;
  if (state.settings.shortcuts && !lights.distant.empty())
    options.only_orientation = onlyOrientation(deformed, state.settings.accuracy.frame);
  return options;
}

}  // namespace

void PixelBlock::clear() {
  shading.targets = 0;
  shading.operations.clear(), shading.runs.clear(), shading.lights.clear(), shading.results.clear();
  pixel.clear(), guided.clear(), between.clear(), ground.clear(), alpha.clear();
  collapsed = not_seen = no_view = 0;
  shadow_rays = model_values = ground_rays = shadows_not_told = 0;
  support = {};
  seconds = {};
}

std::vector<std::array<double, 3>> hitColors(const ShadingBatch& shading,
                                             const std::vector<std::array<double, 3>>& guided) {
  std::vector<std::array<double, 3>> colors = sumResults(shading);
  // A difference of model values may overshoot where the photographs are dark.
  for (std::size_t t = 0; t < guided.size(); ++t)
    for (int c = 0; c < 3; ++c) colors[t][c] = std::max(0.0, colors[t][c] + guided[t][c]);
  return colors;
}

float pixelValue(double sum, std::size_t samples, std::size_t& not_finite) {
  constexpr double kMost = std::numeric_limits<float>::max();
  const double value = samples == 1 ? sum : sum / static_cast<double>(samples);
  if (std::fabs(value) <= kMost) return static_cast<float>(value);
  ++not_finite;
  return static_cast<float>(std::isnan(value) ? 0 : std::clamp(value, -kMost, kMost));
}

namespace {

/// Writes the pixels of a piece; says how many of their values were not finite.
std::size_t resolve(const PixelBlock& block, const ShadingBatch& shading, std::size_t samples, ImageF& rgba) {
  using Sum = std::array<double, 4>;  // double: with many samples a float would lose digits
  std::array<Sum, kBlockPixels> sums;
  std::array<std::uint32_t, kBlockPixels> pixel_of;
  std::array<bool, kBlockPixels> known{};
  const auto width = static_cast<std::uint32_t>(rgba.width());
  const auto sumOf = [&](std::uint32_t pixel) -> Sum& {
    const std::size_t at = placeInBlock(pixel, width);
    if (!known[at]) known[at] = true, pixel_of[at] = pixel, sums[at] = {};
    return sums[at];
  };
  const auto colors = hitColors(shading, block.guided);
  for (std::size_t t = 0; t < colors.size(); ++t) {
    Sum& sum = sumOf(block.pixel[t]);
    for (int c = 0; c < 3; ++c) sum[c] += colors[t][c];
    sum[3] += block.alpha.empty() ? 1 : block.alpha[t];
  }
  for (const PixelBetween& between : block.between) {
    Sum& sum = sumOf(between.pixel);
    const double share = 1.0 / between.count;  // of 2 or 4: exact
    for (int n = 0; n < between.count; ++n)
      for (int c = 0; c < 4; ++c) sum[c] += share * sums[between.neighbour[n]][c];
  }
  for (const GroundSample& sample : block.ground) {
    Sum& sum = sumOf(sample.pixel);
    for (int c = 0; c < 4; ++c) sum[c] += sample.rgba[c];
  }
  std::size_t not_finite = 0;
  for (int at = 0; at < kBlockPixels; ++at)
    if (known[at])
      for (int c = 0; c < 4; ++c)
        rgba.data()[4 * std::size_t{pixel_of[at]} + c] = pixelValue(sums[at][c], samples, not_finite);
  return not_finite;
}

}  // namespace

FrameRenderer::State::State(const std::filesystem::path& srf_folder, const SrfManifest& manifest,
                            const DeformableModel& model, const FrameSettings& frame_settings, Reporter& frame_reporter)
    : settings(frame_settings), reporter(frame_reporter), diameter(model.bounds().diameter()) {
  const std::size_t most_views = std::numeric_limits<decltype(ShadingOperation::view)>::max();
  if (manifest.views.size() > most_views)
    throw badInput(srf_folder.string(), "has " + std::to_string(manifest.views.size()) + " views; at most " +
                                            std::to_string(most_views) + " can be rendered");
  settings.accuracy.views = std::max(1, settings.accuracy.views);
  settings.accuracy.lights = std::max(1, settings.accuracy.lights);
  if (settings.fit) fit_marks = fitMarks(*settings.fit);

  std::vector<SourceView> views;
  std::vector<StoreGeometry> geometry;
  std::vector<const ReflectanceStore*> opened;
  const Box<AcquisitionSpace> box = model.bounds();
  for (const StoredView& view : manifest.views) {
    SourceView source{view.camera, {}, nullptr, view.black_background, settings.matte};
    stores.push_back(nullptr);
    if (!view.file.empty()) {
      const std::filesystem::path file = srf_folder / view.file;
      stores.back() = std::make_unique<ReflectanceStore>(file, settings.direct_reads);
      const ReflectanceStore& store = *stores.back();
      if (store.contentHash() != view.hash || store.geometry().light_count != static_cast<int>(view.lights.size()))
        throw badInput(file.string(),
                       "is not the store that the manifest describes (hash " + hexHash(store.contentHash()) + ", " +
                           std::to_string(store.geometry().light_count) + " lights; expected " + hexHash(view.hash) +
                           ", " + std::to_string(view.lights.size()) + "): run srf acquire again");
      source.geometry = store.geometry();
      source.coverage = store.coverages();
    }
    views.push_back(source);
    geometry.push_back(source.geometry);
    opened.push_back(stores.back().get());
    const auto same =
        std::find_if(lists.begin(), lists.end(), [&](const auto& list) { return list.ids() == view.lights; });
    list_of_view.push_back(static_cast<std::uint32_t>(same - lists.begin()));
    if (same == lists.end()) lists.emplace_back(view.lights, manifest.lights, box, settings.accuracy.lights);
  }
  selection.emplace(std::move(views), model.visible, settings.accuracy.views);
  levels.emplace(selection->views(), box, settings.accuracy.texels);
  if (settings.support || CaptureSupport::wanted(settings.layers))
    support.emplace(selection->views(), lists, list_of_view, box);
  // What the program holds already (the model, its tree, the stores' indices) counts too, and what passes: the picture,
  // scratch memory, what the allocator keeps.
  const std::size_t passing = std::min(settings.memory_bytes / 4, settings.memory_bytes / 8 + kPassing);
  const std::size_t held = residentBytes() + passing;
  const std::size_t least = settings.memory_bytes / 8;
  working_bytes = settings.memory_bytes > held + least ? settings.memory_bytes - held : least;
  BlockCache::ReadAhead ahead;
  ahead.bytes = std::clamp<std::size_t>(working_bytes / 16, std::size_t{1} << 20, std::size_t{256} << 20);
  const std::size_t half = working_bytes / 2;
  cache.emplace(opened, settings.cache_bytes.value_or(half > ahead.bytes ? half - ahead.bytes : 1), ahead);
  shading.emplace(std::move(geometry), *cache);
}

namespace {

FrameLights orderedByDirection(FrameLights lights) {
  orderByDirection(lights.distant);
  return lights;
}

}  // namespace

FramePlan::FramePlan(FrameRenderer::State& state, const Camera<ObjectSpace>& frame_camera,
                     const DeformedModel& deformed_model, const FrameLights& frame_lights, const FrameEffects& effects)
    : camera(frame_camera),
      deformed(deformed_model),
      lens(effects.lens),
      pattern(samplePattern(samplesOf(state.settings, frame_camera, deformed_model))),
      shading(pattern.size() == 1 ? state.settings.accuracy.shading : Shading::every),
      support_step(supportStep(camera.lens.width, camera.lens.height)),
      cover(effects.lens || effects.ground ? ScreenCover() : ScreenCover(frame_camera, deformed_model)),
      ordered(state.settings.fit ? orderedByDirection(frame_lights) : FrameLights()),
      lighting(state.settings.fit ? ordered : frame_lights, state.lists,
               lightingOptions(state, deformed_model, frame_lights)) {
  for (std::size_t v = 0; v < state.stores.size(); ++v)
    allowed.push_back(state.stores[v] && lighting.serves(state.list_of_view[v]));
  state.shared.prepare(lighting);
  if (effects.ground)
    ground.emplace(*effects.ground, frame_lights, deformed_model,
                   GroundShading::Options{state.settings.accuracy.shadow_rays, lighting.options().min_distance});
  const Shadows shadows = state.settings.shadows;
  const bool at_rest = shadows == Shadows::captured;
  const bool plain_rays = !state.settings.fit && !at_rest;
  if ((plain_rays ? shadows != Shadows::both : state.settings.fit && at_rest) && !state.rest)
    state.rest.emplace(deformed.model());
  if (plain_rays)
    cast.emplace(lighting, deformed, state.rest ? &*state.rest : nullptr,
                 CastShadows::Options{shadows, state.settings.accuracy.shadow_rays});
  if (!state.settings.fit) return;
  GuidedLighting::Options guide;
  guide.shadows = state.settings.shadows;
  guide.shadow_rays = state.settings.accuracy.shadow_rays;
  guide.min_distance = lighting.options().min_distance;
  guide.model_alone = state.settings.model_alone;
  state.stand_ins.prepare(lighting, state.working_bytes / 8);
  guided.emplace(*state.settings.fit, state.fit_marks, lighting, state.stand_ins, at_rest ? *state.rest : deformed,
                 state.selection->views(), state.list_of_view, guide);
}

FrameRenderer::FrameRenderer(const std::filesystem::path& srf_folder, const SrfManifest& manifest,
                             const DeformableModel& model, const FrameSettings& settings, Reporter& reporter)
    : state_(std::make_unique<State>(srf_folder, manifest, model, settings, reporter)) {}
FrameRenderer::~FrameRenderer() = default;

Frame FrameRenderer::render(const Camera<ObjectSpace>& camera, const DeformedModel& deformed, const FrameLights& lights,
                            const FrameEffects& effects) {
  State& s = *state_;
  const int width = camera.lens.width, height = camera.lens.height;
  auto clock = Clock::now();
  const auto lap = [&](const std::string& stage) {
    s.seconds[stage] += secondsSince(clock);
    clock = Clock::now();
  };

  const FramePlan plan(s, camera, deformed, lights, effects);
  lap("weights");

  Frame frame;
  frame.rgba = ImageF(width, height, 4);
  lap("resolve");
  Layers layers(s.settings.layers, s.settings.accuracy.views, width, height);
  const int pieces = pixelPieces(camera, plan.pattern.size());
  // Gathered in groups until the budget is full; a group is small against it, and large enough for the threads.
  const std::size_t budget = s.working_bytes / 2;
  const std::size_t ray_bytes = 2048;  // a hit's operations, weights and share of new vectors, generously
  const std::size_t piece_rays = piecePixels(plan.pattern.size()) * plan.pattern.size();
  const int group = static_cast<int>(std::clamp<std::size_t>(budget / 4 / (piece_rays * ray_bytes), 1, 256));
  std::uint64_t hit_count = 0, operation_count = 0, vector_count = 0;
  std::size_t not_finite = 0;
  std::vector<std::uint64_t> first_plan;  // of the frame
  FrameSupport frame_support;
  for (int next = 0; next < pieces;) {
    std::size_t used = 0, bytes = 0;
    if (s.shared.bytes() > budget / 2) s.shared.clear();
    while (next < pieces && bytes + s.shared.bytes() < budget) {
      throwIfInterrupted();
      const int count = std::min(group, pieces - next);
      const std::size_t first = used;
      used += count;
      if (s.blocks.size() < used) s.blocks.resize(used);
      parallelFor(count, kTracedTogether, [&](std::size_t begin, std::size_t end) {
        struct Traced {
          PixelRays rays;
          RaysMet met;
        };
        thread_local std::array<Traced, kTracedTogether> traced;  // for its memory
        for (std::size_t i = begin; i < end; ++i) {
          const auto start = Clock::now();
          auto& [rays, met] = traced[i - begin];
          raysOfPiece(camera, plan.lens, plan.pattern, plan.cover, next + static_cast<int>(i), rays);
          deformed.trace(rays.rays, met);  // M10
          PixelBlock& block = s.blocks[first + i];
          block.clear();
          block.seconds[kTrace] += secondsSince(start);
        }
        for (std::size_t i = begin; i < end; ++i) {
          auto& [rays, met] = traced[i - begin];
          PixelBlock& block = s.blocks[first + i];
          s.gather(plan, rays, met, block, layers.wanted() ? &layers : nullptr, nullptr);
          const auto gathered = Clock::now();
          s.shared.want(block.shading.lights, plan.lighting);
          block.seconds[kWeights] += secondsSince(gathered);
        }
      });
      std::array<double, kGatherStages.size()> spent{};
      for (std::size_t i = first; i < used; ++i) {
        bytes += s.blocks[i].bytes();
        for (std::size_t stage = 0; stage < spent.size(); ++stage) spent[stage] += s.blocks[i].seconds[stage];
      }
      std::size_t kept = bytes;  // those of earlier batches that this one has not used count too
      for (std::size_t i = used; i < s.blocks.size(); ++i) kept += s.blocks[i].bytes();
      if (kept > budget) s.blocks.resize(used);
      // The threads worked on all of these at once: each stage's part of the time that passed.
      const double passed = secondsSince(clock), all = std::accumulate(spent.begin(), spent.end(), 1e-12);
      for (std::size_t stage = 0; stage < spent.size(); ++stage)
        if (spent[stage] > 0) s.seconds[kGatherStages[stage]] += passed * spent[stage] / all;
      clock = Clock::now();
      next += count;
    }
    const std::uint64_t computed_before = s.shared.computed();
    s.shared.compute(plan.lighting);
    vector_count += s.shared.computed() - computed_before;
    lap("weights");
    const std::span<PixelBlock> batch(s.blocks.data(), used);
    std::vector<ShadingBatch> shading;
    shading.reserve(batch.size());
    for (PixelBlock& block : batch) shading.push_back(std::move(block.shading));
    s.shading->execute(shading, s.settings.order);  // M15
    if (first_plan.empty()) first_plan = s.shading->lastPlan();
    lap("execute");
    std::vector<std::size_t> not_finite_of(batch.size());
    parallelFor(batch.size(), 16, [&](std::size_t begin, std::size_t end) {
      for (std::size_t b = begin; b < end; ++b)
        not_finite_of[b] = resolve(batch[b], shading[b], plan.pattern.size(), frame.rgba);
    });
    lap("resolve");
    not_finite = std::accumulate(not_finite_of.begin(), not_finite_of.end(), not_finite);
    std::uint64_t collapsed = 0, not_seen = 0, no_view = 0, shadow_rays = 0, model_values = 0, ground_rays = 0,
                  ground_samples = 0, not_told = 0, between = 0;
    for (std::size_t b = 0; b < batch.size(); ++b) {
      between += batch[b].between.size();
      hit_count += shading[b].targets;
      operation_count += shading[b].operations.size();
      vector_count += shading[b].lights.weights.size();
      collapsed += batch[b].collapsed;
      not_seen += batch[b].not_seen;
      no_view += batch[b].no_view;
      ground_rays += batch[b].ground_rays;
      ground_samples += batch[b].ground.size();
      shadow_rays += batch[b].shadow_rays;
      model_values += batch[b].model_values;
      not_told += batch[b].shadows_not_told;
      frame_support.add(batch[b].support);
      batch[b].shading = std::move(shading[b]);  // for its memory
    }
    if (collapsed) s.reporter.count("frame.collapsed", collapsed);
    if (not_seen) s.reporter.count("hits.no_visible_view", not_seen);
    if (no_view) s.reporter.count("hits.no_view", no_view);
    if (between) s.reporter.count("pixels.between", between);
    if (ground_rays) s.reporter.count("ground.shadow_rays", ground_rays);
    if (ground_samples) s.reporter.count("ground.samples", ground_samples);
    if (shadow_rays) s.reporter.count("shadow_rays", shadow_rays);
    if (not_told) s.reporter.count("shadows.not_told", not_told);
    if (model_values) s.reporter.count("model_values", model_values);
  }

  s.cache->plan(first_plan);  // while the next frame is gathered
  frame.layers = layers.take();
  if (s.settings.support) frame.support = frame_support;
  lap("resolve");

  s.reporter.figure("samples_per_pixel", static_cast<double>(plan.pattern.size()));
  s.reporter.count("hits", hit_count);
  s.reporter.count("operations", operation_count);
  s.reporter.count("light_vectors", vector_count);
  if (not_finite) s.reporter.count("pixels.not_finite", not_finite);
  const CacheStatistics statistics = s.cache->statistics();
  s.reporter.figure("cache.hits", static_cast<double>(statistics.hits));
  s.reporter.figure("cache.misses", static_cast<double>(statistics.misses));
  s.reporter.figure("cache.reread", static_cast<double>(statistics.reread));
  s.reporter.figure("cache.bytes_read", static_cast<double>(statistics.bytes_read));
  s.reporter.figure("cache.peak_bytes", static_cast<double>(statistics.peak_bytes));
  s.reporter.figure("cache.requests", static_cast<double>(statistics.requests));
  s.reporter.figure("cache.peak_ahead_bytes", static_cast<double>(statistics.peak_ahead_bytes));
  s.reporter.figure("seconds.reading", statistics.seconds_reading);
  s.reporter.figure("seconds.waiting", statistics.seconds_waiting);
  for (const auto& [stage, seconds] : s.seconds) s.reporter.figure("seconds." + stage, seconds);
  return frame;
}

}  // namespace srf
