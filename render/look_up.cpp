#include "render/look_up.h"

#include <algorithm>

#include "model/frame_kernels.h"

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

void lookUp(std::span<const SurfaceHit> hits, std::span<const std::size_t> which, FrameMode mode,
            std::span<LookUp> look_ups) {
  thread_local FramesToLookUp frames;  // for its memory
  for (std::size_t begin = 0; begin < which.size(); begin += kFrameLanes) {
    frames.count = std::min(kFrameLanes, which.size() - begin);
    for (std::size_t i = 0; i < frames.count; ++i) {
      const SurfaceHit& hit = hits[which[begin + i]];
      const Mat3& rest = hit.acquisition_from_tangent.raw();
      const Vec3 &u = hit.tangents.u.raw(), &v = hit.tangents.v.raw();
      for (int axis = 0; axis < 3; ++axis) {
        frames.r_u[axis][i] = rest.row[axis].x, frames.r_v[axis][i] = rest.row[axis].y;
        frames.r_n[axis][i] = rest.row[axis].z;
        frames.t_u[axis][i] = u[axis], frames.t_v[axis][i] = v[axis];
      }
      frames.handedness[i] = hit.tangents.handedness;
    }
    if (mode == FrameMode::bisector) lookUpFrames(frames);
    for (std::size_t i = 0; i < frames.count; ++i) {
      const SurfaceHit& hit = hits[which[begin + i]];
      LookUp& result = look_ups[begin + i];
      if (mode != FrameMode::bisector || !frames.holds[i]) {
        result = lookUp(hit, mode);
        continue;
      }
      const auto& l = frames.l;
      result.p = hit.p0;
      const auto row = [&](int axis) { return Vec3{l[axis][0][i], l[axis][1][i], l[axis][2][i]}; };
      result.acquisition_from_object = Orthogonal<AcquisitionSpace, ObjectSpace>(Mat3{{row(0), row(1), row(2)}});
      result.normal = Direction<AcquisitionSpace>::fromUnit({frames.r_n[0][i], frames.r_n[1][i], frames.r_n[2][i]});
      result.collapsed = false;
    }
  }
}

}  // namespace srf
