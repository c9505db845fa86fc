// Which captured views see which points of the surface, at rest.
#pragma once

#include <span>

#include "base/ray_scene.h"
#include "model/deformable_model.h"

namespace srf {

/// A view sees a point that faces it, lies inside its picture and in front of it, and from which a ray reaches it that
/// meets nothing of the surface in `scene` beyond `least_distance` (units).
VisibilityBits findVisibility(std::span<const Point<AcquisitionSpace>> points,
                              std::span<const Direction<AcquisitionSpace>> normals,
                              const RayScene<AcquisitionSpace>& scene, std::span<const StoredView> views,
                              double least_distance, Reporter& reporter);

/// `visible` without the views in whose pictures a point lies so close to an outline inside the silhouette that a
/// look-up would blend another part of the surface in: one further than 3 pixels and `least_distance` off the point's
/// tangent plane. They stay where no other view sees the point well.
VisibilityBits withoutMixedTexels(const VisibilityBits& visible, std::span<const Point<AcquisitionSpace>> points,
                                  std::span<const Direction<AcquisitionSpace>> normals,
                                  const RayScene<AcquisitionSpace>& scene, std::span<const StoredView> views,
                                  double least_distance, Reporter& reporter);

}  // namespace srf
