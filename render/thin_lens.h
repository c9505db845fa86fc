// Depth of field: rays that pass a lens of some width instead of a point (M17).
#pragma once

#include <cstdint>

#include "base/camera.h"

namespace srf {

/// A thin lens at the camera's centre, facing along its axis.
struct ThinLens {
  double aperture = 0;  ///< radius of the lens, units
  double focus = 0;     ///< distance of the plane in focus from the lens along the camera's axis, units
};

/// The ray of sample `index` of `samples` of pixel (x, y): from a point of the lens to where `chief`, the ray through
/// the lens's centre, meets the plane in focus. The samples of a pixel cover the lens evenly; neighbouring pixels cover
/// it differently. A chief ray that does not go forward (fisheye) is left as it is.
Ray<ObjectSpace> throughLens(const ThinLens& lens, const Camera<ObjectSpace>& camera, const Ray<ObjectSpace>& chief,
                             int x, int y, int index, int samples);

}  // namespace srf
