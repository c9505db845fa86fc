// Pictures that show how a capture's numbers are understood: the axes of its world drawn over a photograph, and each
// silhouette against the hull of all.
#pragma once

#include <string>
#include <vector>

#include "acquire/visual_hull.h"
#include "base/image.h"
#include "field/capture.h"

namespace srf {

/// The axes of acquisition space through `center`, `length` units long (x red, y green, z blue, their positive ends
/// named), over a display picture (3 channels) of any size of the camera's shape; and in the corner the picture's own
/// pixel axes.
Image8 axesPicture(const Image8& picture, const Camera<AcquisitionSpace>& camera, const Point<AcquisitionSpace>& center,
                   double length);

/// A sheet of small pictures, `columns` in a row: grey where silhouette and projected hull agree, red where the
/// silhouette alone is, blue where the hull alone is; with the view's name and its IoU below.
Image8 agreementSheet(const AcquisitionMesh& hull, const std::vector<SilhouetteView>& views,
                      const std::vector<double>& iou, int columns, int tile);

/// Camera and mask of a view at a whole fraction of its size; the mask becomes the mean coverage.
Intrinsics reduced(const Intrinsics& lens, int factor);
Image8 reduced(const Image8& mask, int factor);

}  // namespace srf
