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
  std::array<double, 3> color{};             ///< their sum
};

struct PixelExplanation {
  int samples = 0;                 ///< of the pixel, whether they met the model or not
  std::vector<ExplainedHit> hits;  ///< of those that did
  /// The merged weights of all lights that some operation uses: operations name them by `lights`. Entries of weight 0
  /// are left out.
  struct Lights {
    std::uint32_t list = 0;  ///< positions refer to SrfManifest views' lights of this list
    std::vector<LightEntry> entries;
  };
  std::vector<Lights> lights;
  std::array<float, 4> rgba{};  ///< to the bit what render() gives this pixel
};

}  // namespace srf
