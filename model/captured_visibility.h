// Which captured lights reach a model point at rest, by rays, and where a captured shadow's or an occlusion's outline
// is near.
#pragma once

#include <span>

#include "base/reporter.h"
#include "field/srf_folder.h"
#include "model/deformable_model.h"

namespace srf {

struct CapturedVisibility {
  VisibilityBits lit;          ///< point x LightId: faces the light and nothing lies between
  VisibilityBits lit_by_rays;  ///< the same, which a hull's photographs correct along outlines alone
  VisibilityBits lit_around;   ///< lit, and so are four points 1.7 capture pixels around on the surface
  VisibilityBits seen_around;  ///< point x ViewId: visible, and those four points are too
};

/// How far above the surface a shadow ray begins, units: as far as the surface may be off, and at least where floats
/// and a tessellation's facets would shadow themselves (tried on true meshes of diameter 2.4: 0.001 to 0.004 is best).
double shadowRayOffset(const DeformableModel& model);

/// 1.7 pixels of the middle view on the object, units: how far around a point outlines are looked for.
double aroundReach(const SrfManifest& field, const DeformableModel& model);

/// Lights under which no view sees a point are left 0 there.
CapturedVisibility castCapturedVisibility(const SrfManifest& field, const DeformableModel& model,
                                          std::span<const Direction<AcquisitionSpace>> normals, Reporter& reporter);

}  // namespace srf
