#include "render/effects.h"

#include <algorithm>

namespace srf {

FrameEffects effectsAt(const Effects& effects, double frame) {
  FrameEffects at;
  if (const auto& lens = effects.depth_of_field) {
    // Cubic keys may overshoot.
    const ThinLens thin{std::max(0.0, lens->aperture.at(frame)), lens->focus.at(frame)};
    if (thin.aperture > 0 && thin.focus > 0) at.lens = thin;
  }
  if (const auto& ground = effects.ground)
    at.ground = GroundPlane{ground->height.at(frame), ground->albedo.at(frame), ground->shadow_only};
  return at;
}

std::vector<double> momentsOf(const Effects& effects, double frame) {
  const auto& blur = effects.motion_blur;
  const double shutter = blur ? blur->shutter.at(frame) : 0;
  if (!(shutter > 0)) return {frame};
  std::vector<double> moments;
  for (int i = 0; i < blur->samples; ++i) moments.push_back(frame + shutter * ((i + 0.5) / blur->samples - 0.5));
  return moments;
}

}  // namespace srf
