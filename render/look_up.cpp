#include "render/look_up.h"

namespace srf {

LookUp lookUp(const SurfaceHit& hit, FrameMode mode) {
  // At rest acquisition and object space coincide: the fallback of a collapsed point starts from L = identity.
  const Orthogonal<TangentSpace, ObjectSpace> at_rest(hit.acquisition_from_tangent.raw().transposed());
  const DeformedFrame<ObjectSpace> frame = deformedFrame(hit.tangents, mode, at_rest);
  LookUp result;
  result.p = hit.p0;                                                                         // Eq. 3
  result.acquisition_from_object = hit.acquisition_from_tangent * frame.tangent_from_space;  // Eq. 10, M11
  result.normal = Direction<AcquisitionSpace>::fromUnit(hit.acquisition_from_tangent.raw().column(2));
  result.collapsed = frame.collapsed;
  return result;
}

}  // namespace srf
