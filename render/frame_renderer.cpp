#include "render/frame_renderer.h"

#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <limits>
#include <numeric>

#include "base/check.h"
#include "base/memory.h"
#include "base/numeric.h"
#include "base/parallel.h"
#include "render/guided_interpolation.h"
#include "render/level_choice.h"
#include "render/light_weights.h"
#include "render/look_up.h"
#include "render/projected_weights.h"
#include "render/view_selection.h"

namespace srf {
namespace {

constexpr int kBlock = 16;  // pixels along the side of the blocks that a frame is gathered in

using Clock = std::chrono::steady_clock;
double secondsSince(Clock::time_point start) {
  return std::chrono::duration<double>(Clock::now() - start).count();
}

/// Where the samples of a pixel lie in it: a regular grid for square numbers, else the R2 sequence (Roberts 2018).
std::vector<Vec2> samplePattern(int samples) {
  std::vector<Vec2> pattern;
  const int side = static_cast<int>(std::lround(std::sqrt(samples)));
  if (side * side == samples) {
    for (int y = 0; y < side; ++y)
      for (int x = 0; x < side; ++x) pattern.push_back({(x + 0.5) / side, (y + 0.5) / side});
    return pattern;
  }
  constexpr double kPlastic = 1.32471795724474602596;  // root of x^3 = x + 1
  const auto wrap = [](double x) { return x - std::floor(x); };
  for (int i = 0; i < samples; ++i)
    pattern.push_back({wrap(0.5 + i / kPlastic), wrap(0.5 + i / (kPlastic * kPlastic))});
  return pattern;
}

/// Samples of a pixel: as many as asked for, and where surfels are smaller than a pixel, as many as these lie in it
/// (the low-pass of EWA splatting, by quadrature: every sample is a look-up of its own. A splat enlarged to the pixel
/// would blend places and then look up one of them, which still is one texel out of many).
int samplesOf(const FrameSettings& settings, const Camera<ObjectSpace>& camera, const DeformedModel& deformed) {
  constexpr int kMostAcross = 8;
  const int across = std::min(deformed.raysAcross(camera), kMostAcross);
  return std::max({1, settings.samples, across * across});
}

struct LayerGroup {
  const char* name;
  std::vector<const char*> channels;  ///< of the group "view": made from k
};
const std::vector<LayerGroup>& layerGroups() {
  static const std::vector<LayerGroup> groups{
      {"P", {"P.X", "P.Y", "P.Z"}},
      {"P0", {"P0.X", "P0.Y", "P0.Z"}},
      {"N", {"N.X", "N.Y", "N.Z"}},
      {"L", {"L.X", "L.Y", "L.Z", "L.W"}},
      {"handedness", {"handedness"}},
      {"stretch", {"stretch.max", "stretch.min"}},
      {"shear", {"shear"}},
      {"fallback", {"fallback"}},
      {"overlap", {"overlap"}},
      {"V", {"V.X", "V.Y", "V.Z"}},
      {"Z", {"Z"}},
      {"view", {}},
      {"confidence", {"confidence"}},
  };
  return groups;
}

/// What the layers show of one hit.
struct LayerValues {
  const SurfaceHit& hit;
  const LookUp& look_up;
  const Direction<AcquisitionSpace>& view;
  const std::vector<ChosenView>& chosen;
  int surfaces;  ///< blended at the hit: overlapping splats, or one triangle
};

/// The layers asked for, one image a channel.
class Layers {
 public:
  Layers(const std::set<std::string>& groups, int views, int width, int height) : views_(views) {
    const auto add = [&](const std::string& channel, float fill) {
      images_.emplace(channel, ImageF(width, height, 1, fill));
    };
    for (const LayerGroup& group : layerGroups()) {
      if (!groups.contains(group.name)) continue;
      for (const char* channel : group.channels) add(channel, 0);
      if (std::string(group.name) != "view") continue;
      for (int i = 0; i < views; ++i) {
        add("view." + std::to_string(i), -1);
        add("view.weight." + std::to_string(i), 0);
      }
    }
  }
  bool wanted() const { return !images_.empty(); }
  void set(int x, int y, const LayerValues& at) {
    put(x, y, "P", at.hit.p_star.raw());
    put(x, y, "P0", at.look_up.p.raw());
    put(x, y, "N", (at.look_up.acquisition_from_object.inverse() * at.look_up.normal).raw());
    put(x, y, "V", at.view.raw());
    const double sign = determinant(at.look_up.acquisition_from_object) < 0 ? -1 : 1;
    if (images_.contains("L.W")) {
      const Quaternion q = quaternionFromRotation(sign * at.look_up.acquisition_from_object.raw());
      put(x, y, "L", {q.x, q.y, q.z});
      put(x, y, "L.W", q.w);
    }
    put(x, y, "handedness", sign);
    const TangentChange change = tangentChange(at.hit.tangents);
    put(x, y, "stretch.max", change.longest);
    put(x, y, "stretch.min", change.shortest);
    put(x, y, "shear", degrees(change.shear));
    put(x, y, "fallback", at.look_up.collapsed);
    put(x, y, "overlap", at.surfaces);
    put(x, y, "Z", at.hit.distance);
    for (int i = 0; i < std::min<int>(views_, static_cast<int>(at.chosen.size())); ++i) {
      put(x, y, "view." + std::to_string(i), at.chosen[i].view);
      put(x, y, "view.weight." + std::to_string(i), at.chosen[i].weight);
    }
    double nearest = kPi;
    for (const ChosenView& chosen : at.chosen) nearest = std::min(nearest, chosen.angle);
    put(x, y, "confidence", degrees(nearest));
  }
  std::map<std::string, ImageF> take() { return std::move(images_); }

 private:
  void put(int x, int y, const std::string& channel, double value) {
    const auto image = images_.find(channel);
    if (image != images_.end()) image->second.at(x, y) = std::isfinite(value) ? static_cast<float>(value) : 0.f;
  }
  void put(int x, int y, const std::string& group, const Vec3& value) {
    put(x, y, group + ".X", value.x);
    put(x, y, group + ".Y", value.y);
    put(x, y, group + ".Z", value.z);
  }

  int views_;
  std::map<std::string, ImageF> images_;
};

/// L of every point of the model, where it is the same for all: the frame is at rest or moved rigidly (or scaled).
std::optional<Orthogonal<AcquisitionSpace, ObjectSpace>> onlyOrientation(const DeformedModel& deformed,
                                                                         FrameMode mode) {
  constexpr double kSame = 1e-9;  // far above rounding, far below what weights of lights can show
  const DeformableModel& model = deformed.model();
  std::optional<Orthogonal<AcquisitionSpace, ObjectSpace>> only;
  for (std::size_t i = 0; i < model.size(); ++i) {
    SurfaceHit hit;
    hit.acquisition_from_tangent = rotationFromRodrigues(model.r0[i]);
    hit.tangents = deformed.tangents()[i];
    const LookUp look_up = lookUp(hit, mode);
    if (look_up.collapsed) return std::nullopt;
    if (!only) only = look_up.acquisition_from_object;
    for (int row = 0; row < 3; ++row)
      for (int column = 0; column < 3; ++column)
        if (!(std::fabs(look_up.acquisition_from_object.raw().row[row][column] - only->raw().row[row][column]) <=
              kSame))
          return std::nullopt;
  }
  return only;
}

/// Rays through pixels, those of a pixel one after the other.
struct PixelRays {
  std::vector<Ray<ObjectSpace>> rays;
  std::vector<std::uint32_t> pixel;  ///< of each ray
  double samples_per_pixel = 1;

  void add(const Camera<ObjectSpace>& camera, std::span<const Vec2> pattern, int x, int y) {
    samples_per_pixel = static_cast<double>(pattern.size());
    for (const Vec2& at : pattern)
      if (const auto ray = camera.ray({x + at.x, y + at.y})) {
        rays.push_back(*ray);
        pixel.push_back(static_cast<std::uint32_t>(y * camera.lens.width + x));
      }
  }
};
PixelRays raysOfBlock(const Camera<ObjectSpace>& camera, std::span<const Vec2> pattern, int block) {
  const int width = camera.lens.width, height = camera.lens.height;
  const int blocks_x = (width + kBlock - 1) / kBlock;
  const int x0 = block % blocks_x * kBlock, y0 = block / blocks_x * kBlock;
  PixelRays result;
  for (int y = y0; y < std::min(height, y0 + kBlock); ++y)
    for (int x = x0; x < std::min(width, x0 + kBlock); ++x) result.add(camera, pattern, x, y);
  return result;
}

/// A pixel's channel from the sum over its samples. A light beyond the range of float is clamped, so that no NaN or Inf
/// is ever written.
float pixelValue(double sum, std::size_t samples, std::size_t& not_finite) {
  constexpr double kMost = std::numeric_limits<float>::max();
  const double value = sum / static_cast<double>(samples);
  not_finite += !(std::fabs(value) <= kMost);
  return static_cast<float>(std::isnan(value) ? 0 : std::clamp(value, -kMost, kMost));
}

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

/// What a block of pixels goes through before its operations are executed.
enum GatherStage { kTrace, kLookUp, kViews, kShadows, kWeights, kSort };
constexpr std::array<const char*, 6> kGatherStages{"trace", "look_up", "views", "shadows", "weights", "sort"};

/// One block of pixels on its way.
struct PixelBlock {
  ShadingBatch shading;
  std::vector<std::uint32_t> pixel;           ///< of each target
  std::vector<std::array<double, 3>> guided;  ///< of each target: what the model gives and takes; empty: plain
  std::uint64_t collapsed = 0, not_seen = 0, no_view = 0;
  std::uint64_t shadow_rays = 0, model_values = 0;
  std::array<double, kGatherStages.size()> seconds{};  ///< of each of them

  std::size_t bytes() const {
    return shading.operations.capacity() * (sizeof(ShadingOperation) + sizeof(Rgb)) + shading.lights.bytes() +
           pixel.capacity() * sizeof(std::uint32_t) + guided.capacity() * sizeof(guided.front());
  }
};

/// The colour of each target: what its operations sum to, and what the model gives and takes.
std::vector<std::array<double, 3>> hitColors(const ShadingBatch& shading,
                                             const std::vector<std::array<double, 3>>& guided) {
  std::vector<std::array<double, 3>> colors = sumResults(shading);
  // A difference of model values may overshoot where the photographs are dark.
  for (std::size_t t = 0; t < guided.size(); ++t)
    for (int c = 0; c < 3; ++c) colors[t][c] = std::max(0.0, colors[t][c] + guided[t][c]);
  return colors;
}

}  // namespace

std::vector<std::string> knownLayers() {
  std::vector<std::string> names;
  for (const LayerGroup& group : layerGroups()) names.emplace_back(group.name);
  return names;
}

struct FrameRenderer::State {
  State(const std::filesystem::path& srf_folder, const SrfManifest& manifest, const DeformableModel& model,
        const FrameSettings& frame_settings, Reporter& frame_reporter);

  FrameLighting::Options lightingOptions(const DeformedModel& deformed, const FrameLights& lights) const;
  std::vector<std::uint8_t> allowedViews(const FrameLighting& lighting) const;
  /// None where nothing guides. Both must outlive it.
  std::optional<GuidedLighting> guidedLighting(const DeformedModel& deformed, const FrameLighting& lighting);
  /// `layers` and `explained` may be null: then neither costs anything.
  void gather(const Camera<ObjectSpace>& camera, const DeformedModel& deformed, const FrameLighting& lighting,
              const GuidedLighting* guided, std::span<const std::uint8_t> allowed, const PixelRays& in, PixelBlock& out,
              Layers* layers, std::vector<ExplainedHit>* explained) const;
  void addOperations(std::uint32_t target, const ChosenView& chosen, std::uint32_t lights,
                     std::vector<ShadingOperation>& out) const;
  /// Fills in the lights of a hit that has views.
  void explainLights(const FrameLights& lights, FrameLighting::Options options, ExplainedHit& hit) const;

  FrameSettings settings;
  Reporter& reporter;
  double diameter;
  std::vector<std::unique_ptr<ReflectanceStore>> stores;  ///< of each view; none for a view of silhouette alone
  std::vector<AcquiredLights> lists;
  std::vector<std::uint32_t> list_of_view;
  std::optional<ViewSelection> selection;
  std::optional<LevelChoice> levels;
  std::size_t working_bytes = 0;  ///< for blocks, operations and weights together
  std::optional<BlockCache> cache;
  std::optional<DeferredShading> shading;
  SharedStandIns stand_ins;
  std::optional<DeformedModel> rest;  ///< what casts captured shadows, once guided interpolation asks for them
  SharedLightVectors shared;
  std::map<std::string, double> seconds;  ///< by stage, over all frames
};

FrameRenderer::State::State(const std::filesystem::path& srf_folder, const SrfManifest& manifest,
                            const DeformableModel& model, const FrameSettings& frame_settings, Reporter& frame_reporter)
    : settings(frame_settings), reporter(frame_reporter), diameter(model.bounds().diameter()) {
  const std::size_t most_views = std::numeric_limits<decltype(ShadingOperation::view)>::max();
  if (manifest.views.size() > most_views)
    throw badInput(srf_folder.string(), "has " + std::to_string(manifest.views.size()) + " views; at most " +
                                            std::to_string(most_views) + " can be rendered");
  settings.accuracy.views = std::max(1, settings.accuracy.views);
  settings.accuracy.lights = std::max(1, settings.accuracy.lights);

  std::vector<SourceView> views;
  std::vector<StoreGeometry> geometry;
  std::vector<const ReflectanceStore*> opened;
  const Box<AcquisitionSpace> box = model.bounds();
  for (const StoredView& view : manifest.views) {
    SourceView source{view.camera, {}, nullptr, view.black_background};
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
  // What the program holds already (the model, its tree, the stores' indices) counts too. An eighth is for what passes:
  // the picture, scratch memory, what the allocator keeps.
  const std::size_t held = residentBytes() + settings.memory_bytes / 8;
  const std::size_t least = settings.memory_bytes / 4;
  working_bytes = settings.memory_bytes > held + least ? settings.memory_bytes - held : least;
  BlockCache::ReadAhead ahead;
  ahead.bytes = std::clamp<std::size_t>(working_bytes / 16, std::size_t{1} << 20, std::size_t{256} << 20);
  const std::size_t half = working_bytes / 2;
  cache.emplace(opened, settings.cache_bytes.value_or(half > ahead.bytes ? half - ahead.bytes : 1), ahead);
  shading.emplace(std::move(geometry), *cache);
}

void FrameRenderer::State::addOperations(std::uint32_t target, const ChosenView& chosen, std::uint32_t lights,
                                         std::vector<ShadingOperation>& out) const {
  // The 2 x 2 texels fall into at most 2 x 2 tiles; each tile gets the taps that lie in it.
  const StoreGeometry& geometry = selection->views()[chosen.view].geometry;
  const std::size_t first = out.size();
  for (int t = 0; t < 4; ++t) {
    if (!(chosen.fetch.tap[t] > 0)) continue;
    const int x = chosen.fetch.x + t % 2, y = chosen.fetch.y + t / 2;
    const int tile_x = x / kTile, tile_y = y / kTile;
    const std::uint32_t tile = geometry.tileNumber({chosen.fetch.level, tile_x, tile_y});
    // The first texel of the fetch, or where the fetch enters the tile.
    const int corner_x = std::max(chosen.fetch.x - tile_x * kTile, 0);
    const int corner_y = std::max(chosen.fetch.y - tile_y * kTile, 0);
    std::size_t at = first;
    while (at < out.size() && out[at].tile != tile) ++at;
    if (at == out.size())
      out.push_back({target,
                     lights,
                     tile,
                     static_cast<std::uint16_t>(chosen.view),
                     static_cast<std::uint8_t>(corner_x),
                     static_cast<std::uint8_t>(corner_y),
                     {}});
    out[at].tap[(y % kTile - corner_y) * 2 + (x % kTile - corner_x)] =
        static_cast<float>(chosen.weight * chosen.fetch.tap[t]);
  }
}

FrameLighting::Options FrameRenderer::State::lightingOptions(const DeformedModel& deformed,
                                                             const FrameLights& lights) const {
  FrameLighting::Options options;
  options.sharing = settings.accuracy.light_sharing;
  options.min_distance = std::max(settings.accuracy.min_distance, 1e-9) * diameter;
  if (!lights.distant.empty()) options.only_orientation = onlyOrientation(deformed, settings.accuracy.frame);
  return options;
}

std::vector<std::uint8_t> FrameRenderer::State::allowedViews(const FrameLighting& lighting) const {
  std::vector<std::uint8_t> allowed;
  for (std::size_t v = 0; v < stores.size(); ++v) allowed.push_back(stores[v] && lighting.serves(list_of_view[v]));
  return allowed;
}

std::optional<GuidedLighting> FrameRenderer::State::guidedLighting(const DeformedModel& deformed,
                                                                   const FrameLighting& lighting) {
  if (!settings.fit) return std::nullopt;
  const bool at_rest = settings.shadows == Shadows::captured;
  if (at_rest && !rest) rest.emplace(deformed.model());
  GuidedLighting::Options guide;
  guide.shadows = settings.shadows;
  guide.shadow_rays = settings.accuracy.shadow_rays;
  guide.min_distance = lighting.options().min_distance;
  guide.model_alone = settings.model_alone;
  stand_ins.prepare(lighting, working_bytes / 8);
  return std::optional<GuidedLighting>(std::in_place, *settings.fit, lighting, stand_ins, at_rest ? *rest : deformed,
                                       selection->views(), list_of_view, guide);
}

void FrameRenderer::State::gather(const Camera<ObjectSpace>& camera, const DeformedModel& deformed,
                                  const FrameLighting& lighting, const GuidedLighting* guided,
                                  std::span<const std::uint8_t> allowed, const PixelRays& in, PixelBlock& out,
                                  Layers* layers, std::vector<ExplainedHit>* explained) const {
  const int width = camera.lens.width;
  const std::vector<Ray<ObjectSpace>>& rays = in.rays;
  const std::vector<std::uint32_t>& pixels = in.pixel;
  auto clock = Clock::now();
  const auto lap = [&](GatherStage stage) {
    const auto now = Clock::now();
    out.seconds[stage] += std::chrono::duration<double>(now - clock).count();
    clock = now;
  };
  std::vector<SurfaceHit> hits(rays.size());
  deformed.intersect(rays, hits);  // M10
  lap(kTrace);

  std::vector<std::size_t> met;
  std::vector<LookUp> look_ups;
  for (std::size_t i = 0; i < hits.size(); ++i)
    if (hits[i].count > 0) {
      met.push_back(i);
      look_ups.push_back(lookUp(hits[i], settings.accuracy.frame));  // M11
      out.collapsed += look_ups.back().collapsed;
    }
  lap(kLookUp);

  ViewSelection::Scratch scratch;
  std::vector<ChosenView> chosen, all_chosen;                    // of the hit, of all of them
  std::vector<std::size_t> first_chosen;                         // of each hit, in all_chosen
  std::vector<Direction<AcquisitionSpace>> directions;           // v of each hit
  std::vector<std::pair<std::uint32_t, std::uint32_t>> handles;  // (list, light weights) of the hit
  std::vector<std::pair<std::uint32_t, std::uint32_t>> wanted;   // (position in met, list) by handle, weighed below
  for (std::size_t m = 0; m < met.size(); ++m) {
    const SurfaceHit& hit = hits[met[m]];
    const LookUp& look_up = look_ups[m];
    const auto target = static_cast<std::uint32_t>(out.pixel.size());
    const bool first_of_pixel = out.pixel.empty() || out.pixel.back() != pixels[met[m]];
    out.pixel.push_back(pixels[met[m]]);

    const Direction<AcquisitionSpace> view = look_up.acquisition_from_object * -rays[met[m]].direction;  // v = L v*
    ViewQuery query{look_up.p, view, look_up.normal};
    if (!camera.lens.isOrthographic()) query.eye_distance = distance(camera.center(), hit.p_star);
    query.points = {hit.point, static_cast<std::size_t>(hit.count)};
    query.point_weights = {hit.weight, static_cast<std::size_t>(hit.count)};
    const ViewSelection::Result seen = selection->select(query, allowed, scratch, chosen);  // M12
    levels->apply(camera, in.samples_per_pixel, hit, look_up, view, chosen);
    if (guided) {
      directions.push_back(view);
      first_chosen.push_back(all_chosen.size());
      all_chosen.insert(all_chosen.end(), chosen.begin(), chosen.end());
    }
    out.not_seen += seen == ViewSelection::Result::not_seen;
    out.no_view += seen == ViewSelection::Result::none;

    handles.clear();
    for (const ChosenView& c : chosen) {
      const std::uint32_t list = list_of_view[c.view];
      auto handle = std::find_if(handles.begin(), handles.end(), [&](const auto& h) { return h.first == list; });
      if (handle == handles.end()) {
        handle = handles.insert(handle, {list, static_cast<std::uint32_t>(wanted.size())});
        wanted.emplace_back(static_cast<std::uint32_t>(m), list);
      }
      addOperations(target, c, handle->second, out.shading.operations);
    }
    if (first_of_pixel && layers)
      layers->set(static_cast<int>(pixels[met[m]] % width), static_cast<int>(pixels[met[m]] / width),
                  {hit, look_up, view, chosen, deformed.model().kind == ModelKind::surfels ? hit.count : 1});
    if (explained) explained->push_back({rays[met[m]], hit, look_up, view, seen, chosen, {}, {}, {}});
  }
  out.shading.targets = static_cast<std::uint32_t>(out.pixel.size());
  lap(kViews);

  GuidedBlock guided_block;
  if (guided) {
    std::vector<GuidedQuery> queries;
    for (std::size_t m = 0; m < met.size(); ++m) {
      const std::size_t end = m + 1 < met.size() ? first_chosen[m + 1] : all_chosen.size();
      queries.push_back({&hits[met[m]], &look_ups[m], directions[m],
                         std::span(all_chosen).subspan(first_chosen[m], end - first_chosen[m])});
    }
    guided->prepare(queries, guided_block);
    out.guided.resize(met.size());
    lap(kShadows);
  }
  for (const auto& [m, list] : wanted) {  // M13, M14
    const LookUp& look_up = look_ups[m];
    if (guided && guided_block.hits[m].gate > 0) {
      guided->gather(guided_block, m, list, out.shading.lights, out.guided[m]);
      continue;
    }
    lighting.gather(list,
                    {look_up.p, hits[met[m]].p_star, look_up.acquisition_from_object,
                     look_up.acquisition_from_object.inverse() * look_up.normal},
                    out.shading.lights);
  }
  out.shading.lights.known = {};
  out.shadow_rays = guided_block.shadow_rays;
  out.model_values = guided_block.model_values;
  lap(kWeights);
  if (settings.order == ExecutionOrder::sorted) sortOperations(out.shading);
  lap(kSort);
}

FrameRenderer::FrameRenderer(const std::filesystem::path& srf_folder, const SrfManifest& manifest,
                             const DeformableModel& model, const FrameSettings& settings, Reporter& reporter)
    : state_(std::make_unique<State>(srf_folder, manifest, model, settings, reporter)) {}
FrameRenderer::~FrameRenderer() = default;

Frame FrameRenderer::render(const Camera<ObjectSpace>& camera, const DeformedModel& deformed,
                            const FrameLights& lights) {
  State& s = *state_;
  const int width = camera.lens.width, height = camera.lens.height;
  const std::vector<Vec2> pattern = samplePattern(samplesOf(s.settings, camera, deformed));
  auto clock = Clock::now();
  const auto lap = [&](const std::string& stage) {
    s.seconds[stage] += secondsSince(clock);
    clock = Clock::now();
  };

  const FrameLighting lighting(lights, s.lists, s.lightingOptions(deformed, lights));
  const std::optional<GuidedLighting> guided = s.guidedLighting(deformed, lighting);
  s.shared.prepare(lighting);
  const std::vector<std::uint8_t> allowed = s.allowedViews(lighting);
  lap("weights");

  // Double sums: with many samples a float would lose digits.
  std::vector<std::array<double, 4>> sums(static_cast<std::size_t>(width) * height);
  Layers layers(s.settings.layers, s.settings.accuracy.views, width, height);
  const int blocks = ((width + kBlock - 1) / kBlock) * ((height + kBlock - 1) / kBlock);
  // Gathered in groups until the budget is full; a group is small against it, and large enough for the threads.
  const std::size_t budget = s.working_bytes / 2;
  const std::size_t ray_bytes = 2048;  // a hit's operations, weights and share of new vectors, generously
  const std::size_t block_bytes = kBlock * kBlock * pattern.size() * ray_bytes;
  const int group = static_cast<int>(std::clamp<std::size_t>(budget / 4 / block_bytes, 1, 256));
  std::uint64_t hit_count = 0, operation_count = 0, vector_count = 0;
  std::vector<std::uint64_t> first_plan;  // of the frame
  for (int next = 0; next < blocks;) {
    std::vector<PixelBlock> batch;
    std::size_t bytes = 0;
    if (s.shared.bytes() > budget / 2) s.shared.clear();
    while (next < blocks && bytes + s.shared.bytes() < budget) {
      throwIfInterrupted();
      const int count = std::min(group, blocks - next);
      const std::size_t first = batch.size();
      batch.resize(first + count);
      parallelFor(count, 1, [&](std::size_t begin, std::size_t end) {
        for (std::size_t i = begin; i < end; ++i)
          s.gather(camera, deformed, lighting, guided ? &*guided : nullptr, allowed,
                   raysOfBlock(camera, pattern, next + static_cast<int>(i)), batch[first + i],
                   layers.wanted() ? &layers : nullptr, nullptr);
      });
      std::array<double, kGatherStages.size()> spent{};
      for (std::size_t i = first; i < batch.size(); ++i) {
        bytes += batch[i].bytes();
        s.shared.want(batch[i].shading.lights.wanted, lighting);
        for (std::size_t stage = 0; stage < spent.size(); ++stage) spent[stage] += batch[i].seconds[stage];
      }
      // The threads worked on all of these at once: each stage's part of the time that passed.
      const double passed = secondsSince(clock), all = std::accumulate(spent.begin(), spent.end(), 1e-12);
      for (std::size_t stage = 0; stage < spent.size(); ++stage)
        if (spent[stage] > 0) s.seconds[kGatherStages[stage]] += passed * spent[stage] / all;
      clock = Clock::now();
      next += count;
    }
    const std::uint64_t computed_before = s.shared.computed();
    s.shared.compute(lighting);
    vector_count += s.shared.computed() - computed_before;
    lap("weights");
    std::vector<ShadingBatch> shading;
    shading.reserve(batch.size());
    for (PixelBlock& block : batch) {
      s.shared.resolve(block.shading.lights);
      shading.push_back(std::move(block.shading));
    }
    s.shading->execute(shading, s.settings.order);  // M15
    if (first_plan.empty()) first_plan = s.shading->lastPlan();
    lap("execute");
    parallelFor(batch.size(), 16, [&](std::size_t begin, std::size_t end) {
      for (std::size_t b = begin; b < end; ++b) {
        const auto colors = hitColors(shading[b], batch[b].guided);
        for (std::size_t t = 0; t < colors.size(); ++t) {
          auto& sum = sums[batch[b].pixel[t]];
          for (int c = 0; c < 3; ++c) sum[c] += colors[t][c];
          sum[3] += 1;
        }
      }
    });
    lap("resolve");
    std::uint64_t collapsed = 0, not_seen = 0, no_view = 0, shadow_rays = 0, model_values = 0;
    for (std::size_t b = 0; b < batch.size(); ++b) {
      hit_count += shading[b].targets;
      operation_count += shading[b].operations.size();
      vector_count += shading[b].lights.weights.size();
      collapsed += batch[b].collapsed;
      not_seen += batch[b].not_seen;
      no_view += batch[b].no_view;
      shadow_rays += batch[b].shadow_rays;
      model_values += batch[b].model_values;
    }
    if (collapsed) s.reporter.count("frame.collapsed", collapsed);
    if (not_seen) s.reporter.count("hits.no_visible_view", not_seen);
    if (no_view) s.reporter.count("hits.no_view", no_view);
    if (shadow_rays) s.reporter.count("shadow_rays", shadow_rays);
    if (model_values) s.reporter.count("model_values", model_values);
  }

  s.cache->plan(first_plan);  // while the next frame is gathered
  Frame frame;
  frame.rgba = ImageF(width, height, 4);
  std::size_t not_finite = 0;
  for (std::size_t i = 0; i < sums.size(); ++i)
    for (int c = 0; c < 4; ++c) frame.rgba.data()[4 * i + c] = pixelValue(sums[i][c], pattern.size(), not_finite);
  frame.layers = layers.take();
  lap("resolve");

  s.reporter.figure("samples_per_pixel", static_cast<double>(pattern.size()));
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

PixelExplanation FrameRenderer::explain(const Camera<ObjectSpace>& camera, const DeformedModel& deformed,
                                        const FrameLights& lights, int x, int y) {
  State& s = *state_;
  SRF_CHECK(x >= 0 && y >= 0 && x < camera.lens.width && y < camera.lens.height);
  const std::vector<Vec2> pattern = samplePattern(samplesOf(s.settings, camera, deformed));
  const FrameLighting lighting(lights, s.lists, s.lightingOptions(deformed, lights));
  s.shared.prepare(lighting);
  PixelRays rays;
  rays.add(camera, pattern, x, y);
  PixelBlock block;
  PixelExplanation result;
  result.samples = static_cast<int>(pattern.size());
  const std::optional<GuidedLighting> guided = s.guidedLighting(deformed, lighting);
  s.gather(camera, deformed, lighting, guided ? &*guided : nullptr, s.allowedViews(lighting), rays, block, nullptr,
           &result.hits);
  s.shared.want(block.shading.lights.wanted, lighting);
  s.shared.compute(lighting);
  s.shared.resolve(block.shading.lights);
  s.shading->execute({&block.shading, 1});
  const auto colors = hitColors(block.shading, block.guided);
  std::array<double, 4> sum{};
  for (std::size_t t = 0; t < colors.size(); ++t) {
    if (!block.guided.empty()) result.hits[t].guided = block.guided[t];
    result.hits[t].color = colors[t];
    for (int c = 0; c < 3; ++c) sum[c] += colors[t][c];
    sum[3] += 1;
  }
  std::size_t not_finite = 0;
  for (int c = 0; c < 4; ++c) result.rgba[c] = pixelValue(sum[c], pattern.size(), not_finite);

  result.merged.resize(block.shading.lights.weights.size());
  for (std::size_t i = 0; i < block.shading.operations.size(); ++i) {
    const ShadingOperation& operation = block.shading.operations[i];
    ExplainedHit& hit = result.hits[operation.target];
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
    const ReflectanceBlock& texels = handle.block();
    ProjectedWeights projected(texels, geometry);
    if (!texels.basis.empty()) vector = projected.of(gathered, gathered.weights[operation.lights]);
    for (int t = 0; t < 4; ++t) {
      if (!(operation.tap[t] > 0)) continue;
      ShadingOperation alone = operation;
      for (int other = 0; other < 4; ++other) alone.tap[other] = other == t;
      // At a coarser level the first of the pixels that the texel stands for.
      hit.texels.push_back({operation.view, geometry.crop_x + ((place.x * kTile + operation.x + t % 2) << place.level),
                            geometry.crop_y + ((place.y * kTile + operation.y + t / 2) << place.level),
                            operation.tap[t],
                            reflectanceDotReference(texels.halves.data(), texels.pad, alone, vector)});
    }
  }
  for (ExplainedHit& hit : result.hits)
    if (!hit.chosen.empty()) s.explainLights(lights, lighting.options(), hit);
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
  const Direction<ObjectSpace> normal = acquisition_from_object.inverse() * hit.look_up.normal;
  const LitPoint point{hit.look_up.p, hit.hit.p_star, acquisition_from_object, normal};
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
