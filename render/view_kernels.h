// How captured views lie to hits, many at a time: kernels of view_selection over plain arrays. Arrays are padded to
// whole vectors: kernels read and write up to kVectorLanes elements beyond the count, rounded up.
#pragma once

#include <cstddef>
#include <cstdint>

#include "base/camera.h"
#include "render/vector_lanes.h"

namespace srf {

/// Hits about an origin near them, one array an axis.
struct NearLanes {
  const float *px, *py, *pz, *vx, *vy, *vz;
  const float* inverse_eye;   ///< 1 / eye_distance; 0 where the view's resolution does not count
  const std::uint32_t* seen;  ///< bit b of word w of hit i, at seen[w * stride + i]: view 32 w + b sees it
};
/// Views that see some of them: their centres about the same origin, not a number where the centre does not matter, and
/// their numbers.
struct NearViews {
  const float *x, *y, *z;
  const std::uint32_t* view;
  std::size_t count;
};
inline constexpr int kMostNearViews = 9;  ///< that nearestViews finds
/// bound[s * stride + i] <= viewPenalty of view s from hit i, all of it usable; infinite where it does not see the hit.
/// Off by some 1e-5 of the penalty's radians (a thousandth of them at 60 degrees, a fifth at 180), always downwards.
/// nearest[j * stride + i], j < wanted <= kMostNearViews: the numbers of the views of least bound, nearest first, -1:
/// no more; rest[i]: the least bound of the others.
void nearestViews(const NearViews& views, const NearLanes& hits, std::size_t count, std::size_t stride, int wanted,
                  float* bound, std::int32_t* nearest, float* rest);

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
  const double* weight;  ///< of p's points together; negated where a view may see only some of them
};
/// How a view lies to each of them.
struct ViewLanes {
  double* angle;           ///< between v and the view's direction at p, radians
  double* penalty;         ///< viewPenalty of a view whose picture covers all of p; kPenaltyCap where it is unusable
  double* foreshortening;  ///< sqrt(n . direction), kept above 0
  double *pixel_x, *pixel_y;
  /// 0: no direction or no pixel there, or beyond the picture's border; 1: usable; 2: how far must be asked, near the
  /// border or where weight is negative, and the penalty is that of a view that sees all of p.
  double* usable;
  double* border;                               ///< pixels to the picture's border, below 0 outside
  double *floor_x, *floor_y, *part_x, *part_y;  ///< TexelPlace
};
/// Where a pixel lies among the texels of the stored rectangle: the first of its 2 x 2, and the way to the next ones.
struct TexelPlace {
  double floor_x, floor_y, part_x, part_y;
};
/// A view, and the pixel at which its stored rectangle begins.
struct PlacedView {
  Camera<AcquisitionSpace> camera;
  Vec2 crop;
  bool bends;  ///< bendsLines: of its pixels nothing is told, and `usable` is 2 wherever it has a direction
};
/// How view `view[i]` lies to hit i; where view[i] is negative, nothing is written. Hits side by side mostly have the
/// same views: these are placed together. `border`: pixels over which a view fades towards its picture's border. The
/// same operations in every instruction set; the angle is within 1e-15 of atan2's, the rest within two roundings of the
/// scalar forms in view_selection.cpp.
void placeViews(const PlacedView* views, const std::int32_t* view, double least_foreshortening, double border,
                const HitLanes& hits, std::size_t count, const ViewLanes& out);

}  // namespace srf
