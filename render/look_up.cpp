#include "render/look_up.h"

namespace srf {

LookUp lookUp(const SurfaceHit& hit, FrameMode mode) {
  const DeformedFrame<ObjectSpace> frame = deformedFrame(hit.tangents, mode);
  LookUp result;
  result.p = hit.p0;                                                                         // Eq. 3
  result.acquisition_from_object = hit.acquisition_from_tangent * frame.tangent_from_space;  // Eq. 10, M11
  result.normal = Direction<AcquisitionSpace>::fromUnit(hit.acquisition_from_tangent.raw().column(2));
  result.collapsed = frame.collapsed;
  return result;
}

}  // namespace srf
