// What a scene may ask for beyond the object itself (M17). What it does not ask for is absent here, and costs nothing.
#pragma once

#include <optional>

#include "base/animated.h"
#include "render/thin_lens.h"

namespace srf {

/// The shutter is open over `shutter` frames, centred on the frame's own moment; the frame is the mean of `samples`
/// moments in it, each the middle of an equal part. Camera, lights and deformation move.
struct MotionBlur {
  Animated<double> shutter;
  int samples = 16;
};
/// See ThinLens.
struct DepthOfField {
  Animated<double> aperture, focus;
};
/// See GroundPlane.
struct Ground {
  Animated<double> height;
  Animated<Vec3> albedo{Vec3{0.5, 0.5, 0.5}};
  bool shadow_only = false;
};

struct Effects {
  bool matte = false;  ///< the object's alpha is the coverage of its photographs' masks
  std::optional<MotionBlur> motion_blur;
  std::optional<DepthOfField> depth_of_field;
  std::optional<Ground> ground;
};

/// The plane z = height of object space, matt, lit from above and seen from above.
struct GroundPlane {
  double height = 0;  ///< units
  Vec3 albedo{0.5, 0.5, 0.5};
  bool shadow_only = false;  ///< black, and opaque only as far as the object keeps light away
};

/// The effects of one moment that rays know of.
struct FrameEffects {
  std::optional<ThinLens> lens;
  std::optional<GroundPlane> ground;
};
FrameEffects effectsAt(const Effects& effects, double frame);

/// The moments of the frame's picture, in order: the frame itself where nothing moves while the shutter is open.
std::vector<double> momentsOf(const Effects& effects, double frame);

}  // namespace srf
