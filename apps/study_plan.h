// What `srf study` measures of a scene: its knobs, the all-exact setting, and the settings worth trying.
#pragma once

#include <string>
#include <vector>

#include "apps/field_variants.h"
#include "apps/study_file.h"
#include "render/scene.h"

namespace srf {

/// What a first rendering of the scene told.
struct SceneProbe {
  double seconds = 0;  ///< of a frame with one sample a pixel, every shadow ray and light weights that are not shared
  bool guided = false, shadow_rays = false;
};

/// The scene's own values of all knobs.
SceneKeys ownSetting(const Scene& scene, const SceneProbe& probe);
/// The most exact setting of which a frame takes about `seconds` at most: light weights not shared, every shadow ray,
/// and as many environment lights and samples a pixel as the time allows, never fewer than the scene's own. Views and
/// lights are the scene's: how many are interpolated is a choice of the method, not an approximation of it.
SceneKeys exactSetting(const Scene& scene, const SceneProbe& probe, double seconds);
/// About how long a frame of it takes.
double exactSeconds(const Scene& scene, const SceneProbe& probe, const SceneKeys& exact);
/// Each knob from exact to cheap. `memory_bytes`: what --memory gives. `fields`: the knobs of the field, whose variants
/// lie in `folder`.
std::vector<Knob> knobsOf(const SceneKeys& exact, const SceneKeys& own, std::size_t memory_bytes,
                          const std::vector<FieldKnob>& fields, const std::filesystem::path& folder);
/// The settings that promise the least time for errors from 10 % down to 0.03 %, foretold from each knob's own curve:
/// errors add in squares, times multiply. Cheapest first.
std::vector<SceneKeys> worthTrying(const Study& study);

}  // namespace srf
