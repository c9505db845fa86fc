// How captured views lie to hits, many at a time: kernels of view_selection over plain arrays. Arrays are padded to
// whole vectors: kernels read and write up to kVectorLanes elements beyond the count, rounded up.
#pragma once

#include <cstddef>
#include <cstdint>

#include "base/camera.h"
#include "render/vector_lanes.h"
#include "render/whole_texels.h"

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
/// nearest[j * stride + i], j < wanted <= kMostNearViews: the numbers of the views of least bound, rising, before them
/// -1 where there are fewer; rest[i]: the least bound of the others.
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
  const double* weight;         ///< of p's points together; negated where a view may see only some of them
  const std::uint32_t* by_all;  ///< bit b of word w of hit i, at by_all[w * stride + i]: view 32 w + b sees all of them
  std::size_t stride;
};
/// What is known of a view at a hit.
enum ViewState : std::int32_t {
  kViewUnusable,  ///< no direction or no pixel there, or beyond the picture's border
  kViewUsable,    ///< and all is known of it
  kViewAsked,     ///< how far it counts must be asked: it may see only some points, or lies near the picture's border
  kViewMixed      ///< the same; or its four texels are not all covered
};
/// How views lie to hits.
struct ViewLanes {
  double* angle;           ///< between v and the view's direction at p, radians
  double* penalty;         ///< viewPenalty: kPenaltyCap where unusable; where it must be asked, that of a view that
                           ///< shows all of p
  double* foreshortening;  ///< sqrt(n . direction), kept above 0
  double *pixel_x, *pixel_y;
  double* border;       ///< pixels to the picture's border, below 0 outside
  std::int32_t* state;  ///< ViewState
  // Where the four texels are all covered:
  std::int32_t *x, *y;  ///< the first of them in the stored rectangle
  float* tap;           ///< four a hit: what each counts
};
/// A view as it is placed.
struct PlacedView {
  Vec3 center, forward;
  Mat3 rotation;  ///< columns: the camera's axes
  double fl_x, skew, cx, fl_y, cy;
  double width, height;           ///< pixels of the picture
  double crop_x = 0, crop_y = 0;  ///< where its stored rectangle begins
  double across = 0, down = 0;    ///< texels of that
  double tiles_x = 0;             ///< tiles beside one another
  double first_tile = 0;          ///< in WholeTexels
  bool orthographic;
  bool bends;  ///< bendsLines: of its pixels nothing is told, and it is kViewMixed wherever it has a direction

  explicit PlacedView(const Camera<AcquisitionSpace>& camera);
};
/// How view `view[i]` lies to hit i; a negative one is unusable. `border`: pixels over which a view fades towards its
/// picture's border. The same operations in every instruction set; the angle is within 1e-15 of atan2's, the rest
/// within two roundings of the scalar forms in view_selection.cpp.
void placeViews(const PlacedView* views, const WholeTexels& whole, const std::int32_t* view,
                double least_foreshortening, double border, const HitLanes& hits, std::size_t count,
                const ViewLanes& out);

/// Pairs of hits and views: rank j < ranks of hit i at j * stride + i, those of a hit by rising view. Penalties at
/// kPenaltyCap are of none.
struct RankedLanes {
  const double *penalty, *foreshortening;
  const float* rest;  ///< of each hit: no other view's penalty is less; infinite: there is none
  std::size_t ranks, stride;
};
/// The weights of M12, as lumigraphWeights has them, times foreshortening and with sum 1, of the k pairs of least
/// penalty among more than k ranks, k < kMostNearViews: in their order, `pair[r * stride + i]` and its weight, r <
/// taken[i]. taken[i] is 0 where other views may count too, and where no weight is above 0. The same bits in every
/// instruction set.
void weighViews(const RankedLanes& lanes, std::size_t count, int k, std::int64_t* pair, double* weight,
                std::int64_t* taken);

}  // namespace srf
