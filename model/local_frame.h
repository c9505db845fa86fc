// The local parameterization {p0, r0, u, v} of a model point (Table A; Eq. 5, 7, 8, 9; M7, M11).
#pragma once

#include "base/transform.h"

namespace srf {

/// Which orthonormal pair stands for the deformed tangents (u, v).
enum class FrameMode {
  bisector,  ///< Eq. 8, 9: equal angles to u and v; the patent's
  polar      ///< the nearest orthonormal pair in the tangent plane: independent of the free choice of (u0, v0)
};

/// Sine between tangents below which they give no plane: their directions carry rounding errors near 1e-16, so that the
/// normal would be off by more than 1e-4 rad.
inline constexpr double kCollapsedSine = 1e-12;

/// R0 from the Rodrigues vector r0 = k tan(angle / 2) (Eq. 5). Finite for every finite r0, however long.
Orthogonal<AcquisitionSpace, TangentSpace> rotationFromRodrigues(const Vec3& r0);
/// r0 of R0, guarded at half turns (a normal of exactly -z): |q0| is kept at 2^-20 or more, which turns R0 by at most
/// 2e-6 rad; always finite.
Vec3 rodriguesFromRotation(const Orthogonal<AcquisitionSpace, TangentSpace>& acquisition_from_tangent);
/// R0 = (u0 v0 n0) with n0 = normal and u0 = `tangent` made perpendicular to it (anyPerpendicular where it is
/// parallel).
Orthogonal<AcquisitionSpace, TangentSpace> restFrame(const Direction<AcquisitionSpace>& normal,
                                                     const Direction<AcquisitionSpace>& tangent);
Orthogonal<AcquisitionSpace, TangentSpace> restFrame(const Direction<AcquisitionSpace>& normal);

/// The tangents of a point carried along by the deformation; neither unit nor orthogonal.
template <class Space>
struct Tangents {
  Vector<Space> u, v;
  int handedness = 1;  ///< sign of det D(Psi): -1 where the deformation mirrors; (u, v) alone cannot tell
};

/// How the deformation changed the unit square of the rest tangents.
struct TangentChange {
  double longest = 1, shortest = 1;  ///< lengths of the longest and shortest carried unit tangent, of any phase
  double shear = 0;  ///< radians by which u and v come nearer than a right angle: what Eq. 8 and 9 split evenly
};
template <class Space>
TangentChange tangentChange(const Tangents<Space>& tangents);

/// (u-bar, v-bar, sigma n-bar) as rows, Eq. 7 to 9: x_tangent = frame * x_object. Improper where handedness is -1
/// (M11).
template <class Space>
struct DeformedFrame {
  Orthogonal<TangentSpace, Space> tangent_from_space;
  /// The tangents gave no frame (a zero, infinite or parallel pair): a fallback was made from what is left of them.
  bool collapsed = false;
};
/// The orthonormal frame of deformed tangents, in double. Where they collapse, the frame `at_rest` is returned, turned
/// by the shortest way that takes the tangent which kept most of its length to where it was carried (with both zero, as
/// it is), and `collapsed` is set. So the fallback neither depends on the phase of (u0, v0) nor jumps from point to
/// point, but where the tangent was turned by 180 degrees. It takes over below a sine of 1e-12 between u and v, where
/// their own frame is known to no better than 1e-4 rad.
template <class Space>
DeformedFrame<Space> deformedFrame(const Tangents<Space>& tangents, FrameMode mode,
                                   const Orthogonal<TangentSpace, Space>& at_rest = {});

extern template TangentChange tangentChange(const Tangents<ObjectSpace>&);
extern template DeformedFrame<ObjectSpace> deformedFrame(const Tangents<ObjectSpace>&, FrameMode,
                                                         const Orthogonal<TangentSpace, ObjectSpace>&);
extern template DeformedFrame<AcquisitionSpace> deformedFrame(const Tangents<AcquisitionSpace>&, FrameMode,
                                                              const Orthogonal<TangentSpace, AcquisitionSpace>&);

}  // namespace srf
