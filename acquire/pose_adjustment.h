// Poses moved a little so that the silhouettes agree (M4): for captures whose calibration is off by a pixel or more.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "acquire/visual_hull.h"

namespace srf {

struct PoseAdjustmentOptions {
  double uncertainty = 4;  ///< pixels: how far a pose may carry the object's picture from where it belongs (1 sigma)
  std::optional<Box<AcquisitionSpace>> bounds;  ///< box that holds the object
};

struct AdjustedView {
  std::string name;
  double turned = 0;  ///< degrees, of the camera about the object's middle
  double moved = 0;   ///< units, of the camera's centre
  double before = 0,
         after = 0;  ///< pixels, how far the hull lies within the silhouette, root mean square of its outline
  double iou_before = 0, iou_after = 0;  ///< with the hull of all views
};
struct PoseAdjustment {
  std::vector<AdjustedView> views;
  double iou_before = 0, iou_after = 0;  ///< mean over the views
  bool kept = false;                     ///< false: the hull did not agree better, and the poses are as they were
};

/// Carves a hull in which single views may be overruled, moves each camera (6 degrees of freedom, Gauss-Newton) so that
/// the outline of that hull, which holds the object, lies nowhere within its silhouette, and begins anew, six times at
/// most. A pose is drawn back to where it was with the strength of its uncertainty, which also holds the whole rig in
/// place. Where the mean agreement (intersection over union) of the hull of all views does not rise, nothing is
/// changed. The cameras of `views` are the result. Expects four views or more; fewer are left alone.
PoseAdjustment adjustPoses(std::vector<SilhouetteView>& views, const PoseAdjustmentOptions& options,
                           Reporter& reporter);

}  // namespace srf
