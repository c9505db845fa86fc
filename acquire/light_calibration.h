// A capture's lights: from a matt ball, from files, and how strong they are by a white target. Mirror balls are in
// mirror_ball.h.
#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "acquire/mirror_ball.h"
#include "field/capture.h"

namespace srf {

/// The light that shines on a matt (Lambert) ball, distant, with an even term for stray light where asked for.
struct LambertFit {
  Direction<CameraSpace> direction;
  double sigma = 0;     ///< of the direction, radians, from the residuals
  Vec3 level;           ///< per channel: radiance of the ball where it faces the light (irradiance albedo / pi)
  Vec3 stray;           ///< per channel: radiance where the light does not reach
  double residual = 0;  ///< RMS of lit pixels over the mean of them (mean of the channels)
};
struct LambertOptions {
  double white = INFINITY;  ///< pixels at this or above in a channel are saturated and left out
  double margin = 0.05;     ///< the rim that is left out, as a share of the radius
  /// Whether to look for stray light too. Where the light stands near the camera the ball is lit all over, and a real
  /// ball's departure from Lambert's law passes for stray light: leave it off in a dark room.
  bool stray = false;
};
/// Least squares of level max(0, n . l) + stray over the pixels inside the outline. Pixels that are not finite are left
/// out. Nothing where fewer than 20 pixels are lit or they do not fix a direction.
std::optional<LambertFit> fitLambertBall(const ImageF& image, const Intrinsics& lens, const OutlineParameters& outline,
                                         const LambertOptions& options = {});

/// One line of a .lp file.
struct LpLight {
  std::string file;              ///< as written
  Vec3 direction;                ///< of length 1; camera frame with x right, y up, z towards the camera
  bool normalised_here = false;  ///< the file's vector was not of length 1 within 1e-3
};
/// Reads a .lp file: its count, then `file x y z` a line. File names may hold blanks; decimal commas are read as
/// points; tabs, a byte-order mark and Windows line ends are fine. Throws bad_input that names the line: a count that
/// is not that of the lines, a vector of no length, a line of another form.
std::vector<LpLight> readLp(const std::filesystem::path& file);
void writeLp(const std::filesystem::path& file, const std::vector<LpLight>& lights);
/// Between the .lp frame (y up, z towards the camera) and camera space.
inline Direction<CameraSpace> fromLpFrame(const Vec3& d) {
  return Direction<CameraSpace>::fromUnit({d.x, -d.y, -d.z});
}
inline Vec3 toLpFrame(const Direction<CameraSpace>& d) {
  return {d.raw().x, -d.raw().y, -d.raw().z};
}

/// Lights from a JSON file with "lights" as in transforms.json, acquisition space; or the directions of a RelightLab
/// .dome file, which are in the .lp frame of `camera` and are named by their number from 0. Throws bad_input.
std::vector<CaptureLight> readDome(const std::filesystem::path& file, const Camera<AcquisitionSpace>& camera);

/// A flat matt target of known reflectance.
struct WhiteTarget {
  Vec3 reflectance{0.9, 0.9, 0.9};  ///< per channel, 0 to 1
  Direction<AcquisitionSpace> normal;
  Point<AcquisitionSpace> position;  ///< its middle; of use for near lights only
};
/// Mean radiance of the pixels where `region` is 128 or more. Throws bad_input where more than 1 % of them are masked
/// or at `white` or above in a channel, or none is left.
Vec3 meanRadiance(const ImageF& image, const Image8& region, double white = INFINITY);
/// The strength that makes the target that bright: of a directional light the irradiance, of a point light the
/// intensity. Throws bad_input where the light stands behind the target or within 5 degrees of its plane.
Vec3 strengthFromWhite(const CaptureLight& light, const Vec3& radiance, const WhiteTarget& target);

/// Sets strengths from a table `light,r,g,b` (or `light,value` for grey ones). Throws bad_input where a light is
/// missing, a name is unknown, or a value is not above 0.
void setStrengths(std::vector<CaptureLight>& lights, const std::filesystem::path& table);

}  // namespace srf
