// What a FrameRenderer keeps from frame to frame, the plan of one frame, and the blocks of pixels on their way through
// it. Of render/frame_*.cpp alone.
#pragma once

#include <array>
#include <optional>
#include <span>

#include "render/cast_shadows.h"
#include "render/deferred_shading.h"
#include "render/frame_layers.h"
#include "render/frame_renderer.h"
#include "render/ground.h"
#include "render/guided_interpolation.h"
#include "render/level_choice.h"
#include "render/light_weights.h"
#include "render/pixel_rays.h"
#include "render/screen_cover.h"
#include "render/shared_stand_ins.h"
#include "render/sparse_shading.h"
#include "render/view_selection.h"

namespace srf {

struct FramePlan;

/// What a block of pixels goes through before its operations are executed.
enum GatherStage { kTrace, kHits, kGround, kLookUp, kViews, kSupport, kModelValues, kShadows, kWeights, kSort };
constexpr std::array<const char*, 10> kGatherStages{"trace",   "hits",         "ground",  "look_up", "views",
                                                    "support", "model_values", "shadows", "weights", "sort"};

/// One block of pixels on its way.
struct PixelBlock {
  ShadingBatch shading;
  std::vector<std::uint32_t> pixel;           ///< of each target
  std::vector<std::array<double, 3>> guided;  ///< of each target: what the model gives and takes; empty: plain
  std::uint64_t collapsed = 0, not_seen = 0, no_view = 0;
  std::vector<PixelBetween> between;  ///< in this order
  std::vector<GroundSample> ground;   ///< where a ground is asked for
  std::vector<double> alpha;          ///< of each target, where a matte is asked for; else each is 1
  std::uint64_t shadow_rays = 0, model_values = 0, ground_rays = 0, shadows_not_told = 0;
  FrameSupport support;
  std::array<double, kGatherStages.size()> seconds{};  ///< of each of them

  /// Empties it; its memory stays.
  void clear();
  std::size_t bytes() const {
    return shading.operations.capacity() * (sizeof(ShadingOperation) + sizeof(Rgb)) + shading.lights.bytes() +
           pixel.capacity() * sizeof(std::uint32_t) + guided.capacity() * sizeof(guided.front()) +
           between.capacity() * sizeof(PixelBetween) + ground.capacity() * sizeof(GroundSample);
  }
};

/// The colour of each target: what its operations sum to, and what the model gives and takes.
std::vector<std::array<double, 3>> hitColors(const ShadingBatch& shading,
                                             const std::vector<std::array<double, 3>>& guided);

/// A pixel's channel from the sum over its samples. A light beyond the range of float is clamped, so that no NaN or Inf
/// is ever written; `not_finite` counts those.
float pixelValue(double sum, std::size_t samples, std::size_t& not_finite);

/// The hits of one pixel among those of its block.
struct ExplainedPixel {
  std::uint32_t pixel;
  std::vector<ExplainedHit> hits;
  std::vector<std::uint32_t> target;  ///< of each
};

struct FrameRenderer::State {
  State(const std::filesystem::path& srf_folder, const SrfManifest& manifest, const DeformableModel& model,
        const FrameSettings& frame_settings, Reporter& frame_reporter);

  /// From what rays met (which it changes) to operations. `layers` and `explained` may be null: then neither costs
  /// anything.
  void gather(const FramePlan& plan, const PixelRays& in, RaysMet& rays_met, PixelBlock& out, Layers* layers,
              ExplainedPixel* explained) const;
  void addOperations(std::uint32_t target, const PickedView& picked, std::uint32_t lights,
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
  std::optional<CaptureSupport> support;  ///< where layers or the summary ask for it
  std::size_t working_bytes = 0;          ///< for blocks, operations and weights together
  std::optional<BlockCache> cache;
  std::optional<DeferredShading> shading;
  SharedStandIns stand_ins;
  std::vector<std::uint8_t> fit_marks;  ///< of a fit that guides
  std::optional<DeformedModel> rest;    ///< what casts the rest pose's shadows, once they are asked for
  SharedLightVectors shared;
  std::vector<PixelBlock> blocks;         ///< of the frame at hand; kept for their memory
  std::map<std::string, double> seconds;  ///< by stage, over all frames
};

/// What is decided once for a frame, before its first ray: which lights, by which weights, which views may serve, where
/// the samples of a pixel lie. Everything named must outlive it.
struct FramePlan {
  FramePlan(FrameRenderer::State& state, const Camera<ObjectSpace>& frame_camera, const DeformedModel& deformed_model,
            const FrameLights& frame_lights, const FrameEffects& effects);
  FramePlan(const FramePlan&) = delete;
  FramePlan& operator=(const FramePlan&) = delete;

  const Camera<ObjectSpace>& camera;
  const DeformedModel& deformed;
  std::optional<ThinLens> lens;  ///< none: a pinhole
  std::vector<Vec2> pattern;     ///< samples of a pixel
  Shading shading;               ///< Accuracy::shading of one sample a pixel; of several every one is shaded
  int support_step;              ///< supportStep
  ScreenCover cover;
  FrameLights ordered;  ///< where the model guides: the frame's, distant ones ordered by direction
  FrameLighting lighting;
  std::optional<GuidedLighting> guided;  ///< none where nothing guides
  std::optional<CastShadows> cast;       ///< plain interpolation with shadows by rays
  std::optional<GroundShading> ground;   ///< none where none is asked for
  std::vector<std::uint8_t> allowed;     ///< of each view: whether it can show the frame's lights
};

}  // namespace srf
