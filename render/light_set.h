// The lights of one frame (M14): point lights, directional lights, and an environment map taken once to point-like
// lights.
#pragma once

#include <filesystem>
#include <span>
#include <vector>

#include "base/image.h"
#include "base/reporter.h"
#include "base/space.h"
#include "field/srf_folder.h"
#include "render/scene.h"

namespace srf {

/// A directional light at infinity in object space.
struct DistantLight {
  Direction<ObjectSpace> direction;  ///< to the light
  Vec3 irradiance;                   ///< on a plane facing it
};
struct NearLight {
  Point<ObjectSpace> position;
  Vec3 intensity;
};
/// A light of the capture, fixed to the surface's frame: shines as in the photographs, times `scale`.
struct RestLight {
  LightId light;
  double scale;
};

struct FrameLights {
  std::vector<DistantLight> distant;  ///< directional lights and the samples of all environments
  std::vector<NearLight> near_lights;
  std::vector<RestLight> rest;
};

/// The box about the directions of lights, of which there are some, whose longest side tells where to part them.
struct DirectionBox {
  Vec3 low, high;
  int longest = 0;
};
DirectionBox directionBox(std::span<const DistantLight> lights);

/// An environment map reduced to N distant lights: each cell of a partition of the sphere gives its integrated energy
/// at its energy centroid (theory: a value at the cell's direction fails on small bright sources). Sum of irradiances =
/// integral of radiance over the sphere to 1e-6. `samples` 0: one light a texel that is not black (of a map less than
/// 64 wide, several). Before rotation. `map`: grey, RGB or RGBA (alpha left out); orientation in formats.md.
struct EnvironmentSamples {
  std::vector<DistantLight> lights;
  std::size_t unusable_texels = 0;  ///< with a negative, NaN or infinite value: such values count as 0
};
EnvironmentSamples sampleEnvironment(const ImageF& map, int samples);
/// The most lights that a map of so many texels gives, which `samples` 0 takes where none is black.
std::size_t mostEnvironmentLights(int width, int height);

/// Reads the scene's maps once and makes the lights of each frame. The scene must outlive it.
class LightSet {
 public:
  /// Throws bad_input where a light does not fit the field: a captured light it does not have, or any other on a field
  /// of unknown illumination.
  LightSet(const Scene& scene, const SrfManifest& field, Reporter& reporter);
  /// Throws bad_input where animated keys leave a direction without length at `frame`.
  FrameLights at(double frame) const;

 private:
  const Scene& scene_;
  std::vector<EnvironmentSamples> environments_;  ///< one for each environment light, in order
  std::vector<LightId> captured_;                 ///< one for each captured light, in order
};

}  // namespace srf
