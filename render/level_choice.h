// Which level of a store a sample of the picture is taken from: a coarser one where the sample covers several texels.
#pragma once

#include <span>
#include <vector>

#include "render/look_up.h"
#include "render/view_selection.h"

namespace srf {

class LevelChoice {
 public:
  /// `texels`: across a sample, from which on a coarser level is taken; 0: never. At 2 and more a photograph seen from
  /// where it was taken, pixel by pixel, is taken from level 0. `views` must outlive this; `bounds`: of the model.
  LevelChoice(std::span<const SourceView> views, const Box<AcquisitionSpace>& bounds, double texels);

  /// Moves the fetches of chosen views to the levels that fit a sample of the camera. The sample's extent is that of a
  /// square of the same area: its pixel's, carried by distance and slant to the deformed surface, by the tangents' area
  /// to the surface at rest, and by slant and distance to the photograph. A level whose texels show less of the object
  /// there than level 0 does is not taken.
  void apply(const Camera<ObjectSpace>& camera, double samples_per_pixel, const SurfaceHit& hit, const LookUp& look_up,
             const Direction<AcquisitionSpace>& view, std::span<ChosenView> chosen) const;

  /// Whether apply() may do anything for a hit; for most samples the answer costs neither root nor division.
  bool mayApply(const Camera<ObjectSpace>& camera, double samples_per_pixel, const SurfaceHit& hit,
                const LookUp& look_up, const Direction<AcquisitionSpace>& view) const;

 private:
  std::span<const SourceView> views_;
  double texels_;
  double densest_ = 0;  ///< most texels of any view on a unit of the surface's area
};

}  // namespace srf
