// Masks of the object in each view (M3): from files, from alpha, or from a plain background inside a bounding box.
#pragma once

#include <optional>
#include <string>

#include "acquire/visual_hull.h"
#include "field/capture.h"

namespace srf {

struct SilhouetteOptions {
  /// Values (0..1 of the file's encoding, brightest channel) above this are object where the background is plain;
  /// absent: found from the picture.
  std::optional<double> background_threshold;
};

/// Coverage of one view: its mask file, else the alpha of its photographs, else segmentation against a plain dark
/// background: above the threshold, inside the projected capture.bounds, closed 3x3, largest component, holes kept but
/// for specks. Throws bad_input (empty, all white, wrong size, background not dark), naming file and mend.
Image8 silhouette(const Capture& capture, ViewId view, const SilhouetteOptions& options, Reporter& reporter);
/// All views, in parallel. A threshold that is to be found is one for all of them (figure `silhouette.threshold`),
/// which is steadier than what silhouette() finds from its view alone.
std::vector<SilhouetteView> silhouettes(const Capture& capture, const SilhouetteOptions& options, Reporter& reporter);

}  // namespace srf
