// One frame: rays to hits (M10), hits through L (M11), view and light weights (M12, M13), gathered and sorted shading
// operations executed against a small cache (M15), pixels and layers.
#pragma once

#include <map>
#include <memory>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include "base/image.h"
#include "base/reporter.h"
#include "field/block_cache.h"
#include "field/reflectance_store.h"
#include "field/srf_folder.h"
#include "model/deformed_model.h"
#include "model/reflectance_fit.h"
#include "render/deferred_shading.h"
#include "render/effects.h"
#include "render/frame_layers.h"
#include "render/light_set.h"
#include "render/pixel_explanation.h"

namespace srf {

struct Frame {
  ImageF rgba;                           ///< premultiplied, linear
  std::map<std::string, ImageF> layers;  ///< channel name ("P.X", "view.0") to a one-channel image
  std::optional<FrameSupport> support;   ///< where FrameSettings asks for it
};

struct FrameSettings {
  Accuracy accuracy;
  const ReflectanceFit* fit = nullptr;  ///< guides the interpolation; none: plain. Must outlive the renderer
  Shadows shadows = Shadows::captured;
  bool matte = false;        ///< alpha from the coverage of the photographs' masks
  bool model_alone = false;  ///< what the fit shows without the photographs
  /// Per pixel, a regular or stratified pattern (deterministic); more where surfels are smaller than a pixel, up to 64.
  int samples = 1;
  std::set<std::string> layers;  ///< groups asked for; others cost nothing
  bool support = false;  ///< how much of the picture the capture supports: of every fourth pixel that shows the object
  std::size_t memory_bytes = std::size_t{1} << 30;  ///< of the whole program: what is left is for blocks and operations
  // For measuring:
  bool shortcuts = true;  ///< off: every hit has light weights of its own, as if no two were turned alike
  std::optional<std::size_t> cache_bytes;         ///< for blocks; none: half of what is left
  bool direct_reads = false;                      ///< past the system's cache of files
  ExecutionOrder order = ExecutionOrder::sorted;  ///< immediate: hit by hit
};

class FrameRenderer {
 public:
  /// Opens the field's stores. `model` must outlive it.
  FrameRenderer(const std::filesystem::path& srf_folder, const SrfManifest& manifest, const DeformableModel& model,
                const FrameSettings& settings, Reporter& reporter);
  ~FrameRenderer();
  /// Same input, same bits, for any thread count and memory budget.
  Frame render(const Camera<ObjectSpace>& camera, const DeformedModel& deformed, const FrameLights& lights,
               const FrameEffects& effects = {});
  /// How pixel (x, y) of that picture comes about. x, y must lie in the picture.
  PixelExplanation explain(const Camera<ObjectSpace>& camera, const DeformedModel& deformed, const FrameLights& lights,
                           int x, int y, const FrameEffects& effects = {});

  struct State;  ///< render/frame_state.h

 private:
  std::unique_ptr<State> state_;
};

}  // namespace srf
