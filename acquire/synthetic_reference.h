// The exact picture of a scene of a synthetic capture, deformed or not: what a perfect acquisition and interpolation
// would render. It shares no code with the renderer but the look-up L, which the caller gives.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "acquire/synthetic_object.h"
#include "base/camera.h"
#include "base/image.h"
#include "base/reporter.h"
#include "field/capture.h"

namespace srf {

/// Psi as the reference needs it: a differentiable map of space, and the rule that orients the material. Thread-safe.
class ReferenceWarp {
 public:
  virtual ~ReferenceWarp() = default;
  virtual Point<ObjectSpace> map(const Point<AcquisitionSpace>& p0) const = 0;
  virtual Linear<ObjectSpace, AcquisitionSpace> jacobian(const Point<AcquisitionSpace>& p0) const = 0;
  /// L at a point with this Jacobian and rest normal (Eq. 10, M11).
  virtual Orthogonal<AcquisitionSpace, ObjectSpace> lookUp(const Linear<ObjectSpace, AcquisitionSpace>& jacobian,
                                                           const Direction<AcquisitionSpace>& n0) const = 0;
};

struct ReferenceLights {
  struct Distant {
    Direction<ObjectSpace> direction;  ///< to the light
    Vec3 irradiance;                   ///< on a plane facing it
  };
  struct Near {
    Point<ObjectSpace> position;
    Vec3 intensity;
  };
  /// A light of the capture, fixed to the surface's frame.
  struct Rest {
    CaptureLight light;
    double scale = 1;
  };
  std::vector<Distant> distant;
  std::vector<Near> near_lights;
  std::vector<Rest> rest;
};

enum class ReferenceShadows {
  none,      ///< every light that stands above the surface reaches it
  captured,  ///< the rest pose's own, as the photographs hold them: rays at rest along l
  deformed   ///< the deformed object's own: rays along l*. Lights of kind Rest keep the rest pose's
};
const std::vector<std::string>& referenceShadowNames();

/// A thin lens at the camera's centre, facing along its axis.
struct ReferenceLens {
  double aperture = 0;  ///< radius, units
  double focus = 0;     ///< distance of the plane in focus along the camera's axis, units
};
/// The matt plane z = height, lit from above by distant and near lights, seen from above; or only its shadow: black, as
/// opaque as the share of luminance that the object keeps away.
struct ReferenceGround {
  double height = 0;
  Vec3 albedo;
  bool shadow_only = false;
};

struct ReferenceOptions {
  ReferenceShadows shadows = ReferenceShadows::deformed;
  int supersampling = 4;  ///< n x n samples a pixel, box filter; each from another point of the lens, drawn at random
  std::optional<ReferenceLens> lens;
  std::optional<ReferenceGround> ground;
};

/// Width x height x 4: radiance and coverage, premultiplied, linear. At a point, with l = L l* and v = L v*:
/// brdf(p0, l, v) (n0 . l) irradiance(p*), summed over the lights. Interreflection goes with the shadows: with deformed
/// ones light travels in the deformed object, with captured ones in the rest pose from the directions l, with none
/// there is none. Below the surface of wax light travels as at rest. Through glass the object is seen as at rest along
/// v, its points lit as any. Same input, same bits, for any thread count.
ImageF renderReference(const SyntheticObject& object, const ReferenceWarp& warp, const Camera<ObjectSpace>& camera,
                       const ReferenceLights& lights, const ReferenceOptions& options, Reporter& reporter);

}  // namespace srf
