// Shadows by rays without a fitted model (M17): plain interpolation with each light of the frame asked whether it
// reaches the surface in the deformed model, and with the rest pose's own shadows divided out of the photographs where
// it can be told: of the captured lights that stand for one, only those that light the place at rest do.
#pragma once

#include <cstdint>

#include "model/deformed_model.h"
#include "render/light_weights.h"
#include "render/scene.h"

namespace srf {

/// Of the distance to a point light, which may stand in the object itself.
inline constexpr double kShortOfLight = 0.999;

class CastShadows {
 public:
  struct Options {
    Shadows shadows = Shadows::deformed;  ///< deformed, both or off
    int shadow_rays = 32;                 ///< most a hit for distant lights; the weaker ones stay as photographed
  };
  struct Counts {
    std::uint64_t rays = 0;
    /// Lights at hits where hardly any captured light nearby lights the place at rest: taken as photographed.
    std::uint64_t not_told = 0;
  };
  /// `rest`: the model at rest; not needed for Shadows::both. All must outlive it.
  CastShadows(const FrameLighting& lighting, const DeformedModel& deformed, const DeformedModel* rest,
              const Options& options);
  /// As FrameLighting::gather; nothing is shared between hits.
  std::uint32_t gather(std::uint32_t list, const LitPoint& point, LightGather& out, Counts& counts) const;

 private:
  const FrameLighting& lighting_;
  const DeformedModel& deformed_;
  const DeformedModel* rest_;
  Options options_;
  double offset_, rest_offset_;  ///< of rays along the normal, units
};

}  // namespace srf
