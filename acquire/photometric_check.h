// Whether photographs and light table belong together: what the hull's surface should look like under the lights as
// they are told, and under the same lights mirrored, exchanged or taken from another photograph.
#pragma once

#include <cstddef>
#include <optional>
#include <string>
#include <vector>

#include "base/mesh.h"
#include "field/capture.h"

namespace srf {

/// A photograph in small: mean luminance over blocks of `step` x `step` pixels; empty where it could not be read.
struct SmallPhoto {
  int width = 0, height = 0, step = 1;
  std::vector<float> luminance;
  bool empty() const { return luminance.empty(); }
};

/// A light whose photographs fit another light's place better than its own.
struct ForeignLight {
  LightId light, fits;
  double before = 0, after = 0;  ///< correlation of shading and photographs
};
/// A light whose photographs fit no place of the table: where they seem to be lit from.
struct StrayLight {
  LightId light;
  Direction<AcquisitionSpace> seen_from;
  double off = 0;                ///< degrees between there and what the table says
  double before = 0, after = 0;  ///< correlation
};
/// A photograph that fits when it is turned or mirrored.
struct TurnedPhoto {
  std::size_t view = 0, photo = 0;
  std::string how;  ///< "turned by 90 degrees clockwise" ..
  double before = 0, after = 0;
};

struct PhotometricReport {
  std::string why_not;  ///< why nothing could be told of the lights; empty: it could
  double fit = 0;       ///< median over the lights of the correlation of shading and photographs, as told
  /// A change of the axes of the whole light table (a signed permutation) that fits far better.
  std::optional<Mat3> axes;
  double axes_fit = 0;
  std::vector<ForeignLight> foreign;
  std::vector<StrayLight> stray;
  std::vector<TurnedPhoto> turned;
  /// Gain of each view against the others, of points that they share; empty where too few do.
  std::vector<double> gain;
  double drift = 0;        ///< change of the gain over the capture, as a share, from a line through it
  double drift_error = 0;  ///< its standard error
};

/// `photos` and `masks` stand as the capture's views and their photographs do; a view whose mask is null is left out.
/// The masks may be smaller than the camera by a whole factor. Lambert's law is assumed, without cast shadows: enough
/// to tell a wrong table of lights, not to measure one. Deterministic for any number of threads.
PhotometricReport checkPhotometry(const Capture& capture, const AcquisitionMesh& hull,
                                  const std::vector<std::vector<SmallPhoto>>& photos,
                                  const std::vector<const Image8*>& masks);

/// "x negated", "(x, y, z) becomes (x, -z, y)": a signed permutation in words.
std::string axesText(const Mat3& m);

}  // namespace srf
