// Captures by formula: an analytic object photographed by exact cameras under exact lights, one at a time, with its own
// cast shadows. Used by tests, demos and `srf synth` alike.
#pragma once

#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include "acquire/synthetic_object.h"
#include "base/reporter.h"
#include "field/capture.h"

namespace srf {

/// sphere: cameras all around. dome: rings of cameras over the upper half, the lowest just above the horizon.
/// turntable: three fixed cameras above a turning object: in the object's frame cameras and lights turn together about
/// z, so each step has its own lights.
enum class SyntheticRig { sphere, dome, turntable };
const std::vector<std::string>& syntheticRigNames();

struct SyntheticCaptureOptions {
  SyntheticShape shape = SyntheticShape::sphere;
  SyntheticMaterial material = SyntheticMaterial::lambert;
  bool interreflection = false;  ///< of matt surfaces: light that reaches a point by way of others
  SyntheticRig rig = SyntheticRig::sphere;
  LightKind light_kind = LightKind::directional;  ///< or point: three radii from the centre
  int views = 48;
  int lights = 48;        ///< seen by each view
  int size = 128;         ///< pixels along the sides of a picture
  int supersampling = 4;  ///< n x n samples a pixel, box filter
  double vfov = 30;       ///< degrees
  double distance = 0;    ///< camera to centre, units; 0: the object fills 80 % of the picture
  double noise = 0;       ///< standard deviation at a white matt surface facing the light, as a share of its radiance
  double exposure = 0;    ///< standard deviation of each photograph's gain, natural logarithm
  double saturation = 0;  ///< photographs hold at most this radiance, as a full sensor does; 0: no bound
  double missing = 0;     ///< share of the photographs that are left out, at random; none of a view's or light's last
  double mask_error = 0;  ///< pixels: each view's mask is shifted by up to this and grown or shrunk by up to this
  int range_views = 0;    ///< range views of a laser scanner, besides the photographs; 0: none
  double range_noise = 0.005;  ///< units, standard deviation along the beam
  double range_outliers = 0;   ///< share of the points that lie anywhere along their beam
  int mesh_cells = 128;        ///< of model.ply, along the longest side: 128 makes some 200,000 triangles, 48 an eighth
  std::uint64_t seed = 1;      ///< of noise, gain, mask errors and missing photographs

  /// Throws a usage error that lists every value out of its range.
  void validate() const;
};

/// Writes transforms.json, images/VIEW/LIGHT.exr (radiance, premultiplied by coverage, half), masks/VIEW.png, model.ply
/// (the true surface), ranges/NNN.ply (the range views, each with its sensor's place) and synthetic.json. A synthetic
/// capture that is there already is replaced when the new one is whole; another folder that is not empty is refused.
/// Same options, same bytes, for any thread count.
void writeSyntheticCapture(const SyntheticCaptureOptions& options, const std::filesystem::path& folder,
                           Reporter& reporter);

/// The object of a capture that writeSyntheticCapture made. Throws bad_input where it is none.
SyntheticObject readSyntheticObject(const std::filesystem::path& folder);

}  // namespace srf
