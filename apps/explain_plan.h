// What a scene calls for, why, and what it costs (M17): the plan of a frame in words or as JSON.
#pragma once

#include "base/json.h"
#include "base/reporter.h"
#include "render/animation.h"

namespace srf {

/// Renders `frame` once, into no file that stays, and tells of each effect and shortcut whether it is on, by which key
/// of the scene, how often it was expected to be asked for and how often it was; then where the time went.
/// {"frame": .., "plan": [{"name", "on", "because", "expected", "measured"}, ..], "seconds": {stage: seconds}}
Json planOfFrame(const Scene& scene, AnimationOptions options, int frame, Reporter& reporter);
void printPlan(const Json& plan);

/// How many times as long a warm frame takes without the shortcuts that `FrameSettings::shortcuts` turns off.
double measuredFactor(const Scene& scene, AnimationOptions options, int frame);

}  // namespace srf
