// How captured views lie to hits, many at a time: kernels of view_selection over plain arrays. Arrays are padded to
// whole vectors: kernels read and write up to kVectorLanes elements beyond the count, rounded up.
#pragma once

#include <cstddef>

#include "base/camera.h"
#include "render/vector_lanes.h"

namespace srf {

/// A desired ray and the viewer, in units about an origin near the point.
struct NearQuery {
  float p[3], v[3];
  float inverse_eye;  ///< 1 / eye_distance; 0 where the view's resolution does not count
};
/// bound[i] <= viewPenalty of the view whose centre is (x, y, z)[i], all of it usable. About the same origin as the
/// query; off by some 1e-5 of the penalty's radians, always downwards.
void penaltyBounds(const float* x, const float* y, const float* z, std::size_t count, const NearQuery& query,
                   float* bound);

/// squared[i] = |d - (x, y, z)[i]|^2, the same operations in every instruction set.
void squaredChords(const Vec3& d, const double* x, const double* y, const double* z, std::size_t count,
                   double* squared);
/// Squares of chords of the unit sphere to their angles, radians, in place: within 4e-16 of 2 asin(chord / 2),
/// relative.
void chordAngles(double* chord2, std::size_t count);

/// Whether the lens bends lines: its views are placed by Camera::project.
inline bool bendsLines(const Intrinsics& lens) {
  if (lens.model == CameraModel::opencv_fisheye) return true;
  return (lens.model == CameraModel::opencv || lens.model == CameraModel::simple_radial) &&
         (lens.k1 != 0 || lens.k2 != 0 || lens.k3 != 0 || lens.p1 != 0 || lens.p2 != 0);
}

/// Hits, one array an axis.
struct HitLanes {
  const double *px, *py, *pz, *vx, *vy, *vz, *nx, *ny, *nz;
  const double* eye_distance;
};
/// How one view lies to each of them.
struct ViewLanes {
  double* angle;           ///< between v and the view's direction at p, radians
  double* resolution;      ///< resolutionPenalty
  double* foreshortening;  ///< sqrt(n . direction), kept above 0
  double *pixel_x, *pixel_y;
  double* usable;  ///< 0 where the view has no direction or no pixel there, else 1
};
/// A view without lens distortion (pinhole or orthographic). The same operations in every instruction set; the angle is
/// within 1e-15 of atan2's, the rest within two roundings of the scalar forms in view_selection.cpp.
void placeViews(const Camera<AcquisitionSpace>& camera, double least_foreshortening, const HitLanes& hits,
                std::size_t count, const ViewLanes& out);

}  // namespace srf
