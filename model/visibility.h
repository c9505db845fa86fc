// Which captured views see which points of the surface, at rest.
#pragma once

#include <span>

#include "model/deformable_model.h"

namespace srf {

/// A view sees a point that faces it, lies inside its picture and in front of it, and from which a ray reaches it that
/// meets nothing of `surface` beyond `least_distance` (units).
VisibilityBits findVisibility(std::span<const Point<AcquisitionSpace>> points,
                              std::span<const Direction<AcquisitionSpace>> normals, const AcquisitionMesh& surface,
                              std::span<const StoredView> views, double least_distance, Reporter& reporter);

}  // namespace srf
