// The visual hull by carving (M4a): the largest shape that every silhouette allows, as a closed, crack-free mesh.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "base/camera.h"
#include "base/image.h"
#include "base/mesh.h"
#include "base/reporter.h"

namespace srf {

struct SilhouetteView {
  std::string name;
  Camera<AcquisitionSpace> camera;
  Image8 mask;  ///< coverage at the camera's size, 0 outside, 255 inside
};

struct HullOptions {
  int resolution = 0;  ///< finest cells along the longest side of the object; 0: one pixel footprint a cell, 64 to 256
  int tolerance = 0;   ///< views that may disagree at a point without carving it away (keep where >= V - m agree)
  bool exclude_outliers = true;  ///< leave out views whose silhouette contradicts the others, with a warning each
  std::optional<Box<AcquisitionSpace>> bounds;  ///< box that holds the object; found from the silhouettes where absent
};

/// How one view's silhouette agrees with the hull projected into it.
struct ViewConsistency {
  std::string name;
  double iou = 0;      ///< intersection over union of the projected hull and the mask, within the picture
  double covered = 0;  ///< share of the mask that the hull covers
  bool excluded = false;
};

struct VisualHull {
  AcquisitionMesh mesh;  ///< closed, manifold, outward; with normals of the distance field
  double cell = 0;       ///< edge of the finest cells, units
  std::vector<ViewConsistency> views;
};

/// Carves max over views of (signed silhouette distance x depth / focal length) over an octree refined near the
/// surface. Outside a picture and behind a camera a view says nothing. Throws bad_input for an empty or all-white mask
/// (naming the view) and for silhouettes that leave nothing (naming the views that disagree most).
VisualHull carveVisualHull(const std::vector<SilhouetteView>& views, const HullOptions& options, Reporter& reporter);

/// The projected hull against each mask; also used by `srf check`.
std::vector<ViewConsistency> silhouetteConsistency(const AcquisitionMesh& mesh,
                                                   const std::vector<SilhouetteView>& views);

}  // namespace srf
