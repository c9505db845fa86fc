// Everything that made one pixel, with every number in between (srf explain): what FrameRenderer::explain fills in.
#pragma once

#include <array>
#include <vector>

#include "model/deformed_model.h"
#include "render/light_weights.h"
#include "render/look_up.h"
#include "render/shading_operation.h"
#include "render/view_selection.h"

namespace srf {

/// A texel of a photograph that a hit fetched.
struct ExplainedTexel {
  std::uint32_t view = 0;
  int x = 0, y = 0;               ///< pixel of the photograph
  float tap = 0;                  ///< view weight times bilinear weight over coverage
  std::array<double, 3> relit{};  ///< the texel under the frame's lights: what tap multiplies
};
/// One of the frame's lights at a hit, taken alone and exactly (without sharing).
struct ExplainedLight {
  enum class Kind { distant, near_light, captured } kind = Kind::distant;
  Direction<ObjectSpace> direction;     ///< l*; captured lights have none
  Direction<AcquisitionSpace> look_up;  ///< l = L l*
  std::vector<LightEntry> entries;      ///< the acquired lights that stand for it, and their weights
};

/// One sample of the pixel that met the model.
struct ExplainedHit {
  Ray<ObjectSpace> ray;
  SurfaceHit hit;
  LookUp look_up;
  Direction<AcquisitionSpace> view;  ///< v = L v*
  ViewSelection::Result seen = ViewSelection::Result::none;
  std::vector<ChosenView> chosen;
  std::vector<ShadingOperation> operations;  ///< of this hit, in the order in which they are added
  std::vector<Rgb> results;                  ///< what each operation adds
  std::array<double, 3> guided{};            ///< what the fitted model gives and takes; 0 where nothing guides
  std::array<double, 3> color{};             ///< the sum of both, not below 0 where the model guides
  std::vector<ExplainedTexel> texels;        ///< their texels: the sum of tap times relit is their sum again, in double
  std::vector<ExplainedLight> lights;        ///< by the lights of the view of most weight
};

struct PixelExplanation {
  int samples = 0;                 ///< of the pixel, whether they met the model or not
  std::vector<ExplainedHit> hits;  ///< of those that did
  /// The weights of all lights together, at the handles that operations name (`lights`): positions in the
  /// StoredView::lights of the operation's view. Weights of 0 are left out.
  std::vector<std::vector<LightEntry>> merged;
  std::array<float, 4> rgba{};  ///< to the bit what render() gives this pixel
};

}  // namespace srf
