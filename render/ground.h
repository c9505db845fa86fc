// A plane below the object that shows its shadow (M17).
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "base/camera.h"
#include "model/deformed_model.h"
#include "render/effects.h"
#include "render/light_set.h"

namespace srf {

/// What one ray adds to its pixel: premultiplied colour and alpha.
struct GroundSample {
  std::uint32_t pixel = 0;
  std::array<float, 4> rgba{};
};

/// The ground of one frame. Distant and near lights light it; of a captured light nobody knows where it stands in the
/// scene, it does not. The object throws shadows on it, and no light.
class GroundShading {
 public:
  struct Options {
    int shadow_rays = 32;     ///< most a sample for distant lights; the weaker ones then take turns
    double min_distance = 0;  ///< units: least distance of a point light
  };
  /// `lights` and `object` must outlive it.
  GroundShading(const GroundPlane& plane, const FrameLights& lights, const DeformedModel& object,
                const Options& options);

  /// Appends a sample for each ray that meets the ground before the model, and makes its hit a miss. Of `rays`, those
  /// of a pixel stand together; `pixel` numbers them row by row in a picture `width` wide. Returns the shadow rays
  /// cast.
  std::uint64_t shade(std::span<const Ray<ObjectSpace>> rays, std::span<const std::uint32_t> pixel, int width,
                      std::span<SurfaceHit> hits, std::vector<GroundSample>& samples) const;

 private:
  struct Light {
    Direction<ObjectSpace> direction;
    Vec3 irradiance;  ///< on the plane
    double strength;  ///< luminance of it
  };
  GroundPlane plane_;
  const FrameLights& lights_;
  const DeformedModel& object_;
  Options options_;
  Box<ObjectSpace> bounds_;
  Vec3 open_{};                 ///< irradiance of all distant lights where nothing is in the way
  std::vector<Light> always_;   ///< asked by a ray at every sample
  std::vector<Light> in_turn_;  ///< one sample asks some of them
  std::vector<double> up_to_;   ///< of in_turn_: their strengths summed
  int turns_ = 0;               ///< how many of them a sample asks
};

}  // namespace srf
