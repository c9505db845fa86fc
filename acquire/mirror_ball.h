// Lights from their reflections in a mirror ball. The outline of a ball is the section of a cone with the image: a
// conic under perspective, a circle (in units) under orthography. Its rays d satisfy d . w = 1 for one vector w along
// the ball's centre with |w| = 1 / cos(half angle), so that fitting it is a problem of three numbers, with the lens's
// distortion inside. All of camera space is as in camera.h.
#pragma once

#include <optional>
#include <span>
#include <vector>

#include "base/camera.h"
#include "base/image.h"

namespace srf {

/// A circle in an image, pixels.
struct ImageCircle {
  Vec2 center;
  double radius = 0;
};
/// The circle with the centroid and the area of a mask (values of 128 and more). Throws bad_input where it is empty.
ImageCircle circleOfMask(const Image8& mask);

/// A ball seen by a camera. Under orthography its depth is unknown and taken as 0.
struct Ball {
  Point<CameraSpace> center;
  double radius = 1;  ///< units; 1 where nothing tells the true one
};

/// Three numbers that make an outline: w of a perspective view; x, y and radius in units of an orthographic one.
using OutlineParameters = Vec3;
/// The ball behind an outline. `radius`: of the ball where it is known, units (else 1); orthography measures it.
Ball ballFromOutline(const Intrinsics& lens, const OutlineParameters& outline, double radius = 1);
/// The outline of a ball, or nothing where the camera is inside it.
std::optional<OutlineParameters> outlineOfBall(const Intrinsics& lens, const Ball& ball);
/// The outline that a circle in the image comes nearest to. Throws bad_input where it lies outside the lens's range.
OutlineParameters outlineFromCircle(const Intrinsics& lens, const ImageCircle& circle);
/// Pixels of the outline at `count` angles about its middle; those out of the lens's range are left out.
std::vector<Vec2> outlinePixels(const Intrinsics& lens, const OutlineParameters& outline, int count);

struct OutlineOptions {
  double search = 0.12;  ///< how far from the start the outline may lie, as a share of its radius
  int rays = 720;        ///< directions about the centre along which edges are looked for
};
struct FittedOutline {
  OutlineParameters outline;
  Mat3 covariance;     ///< of the three numbers, from the scatter of the edges
  double rms = 0;      ///< of the edges' distances from it, pixels
  double covered = 0;  ///< share of the outline along which its edge was found
};
/// Fits an outline to the edges of `image` (one channel: best the mean of all photographs) near `start`, to sub-pixel:
/// of all edges across the search band the ones that agree on one outline are taken, then least squares over them.
/// Throws bad_input where less than a fifth of the outline shows an edge. Same input, same result.
FittedOutline fitOutline(const ImageF& image, const Intrinsics& lens, const OutlineParameters& start,
                         const OutlineOptions& options = {});

/// The outline of a circle that is known already: centre and radius to `sigma` pixels each.
FittedOutline givenOutline(const Intrinsics& lens, const ImageCircle& circle, double sigma = 0.5);

/// The brightest spot inside an outline.
struct Highlight {
  Vec2 pixel;         ///< centroid of the spot and two pixels around it, weighted by values over the ring beyond
  double sigma = 0;   ///< of the centroid, pixels: 0.1 and 5 % of the spot's radius, added as squares
  double radius = 0;  ///< of a disc as large as the spot, pixels
  double peak = 0;    ///< largest value; four times that where brighter ones are masked
};
/// Values that are not finite (masked as saturated) count as the brightest. Nothing where no spot stands out: the peak
/// is below four times the median inside the ball, or the spot covers more than a tenth of the ball.
std::optional<Highlight> findHighlight(const ImageF& image, const Intrinsics& lens, const OutlineParameters& outline);

/// Where the ray through a pixel meets a ball, and what it mirrors there.
struct Reflection {
  Point<CameraSpace> point;
  Direction<CameraSpace> direction;  ///< from the ball to what is mirrored
};
std::optional<Reflection> reflectionAt(const Intrinsics& lens, const Ball& ball, const Vec2& pixel);

/// One light mirrored by one ball in one view.
struct MirrorSighting {
  Camera<AcquisitionSpace> camera;
  FittedOutline outline;
  double ball_radius = 1;  ///< units
  Highlight highlight;
};

/// A distant light: the mean of what the sightings say, weighted by their certainty.
struct DistantEstimate {
  Direction<AcquisitionSpace> direction;
  double sigma = 0;   ///< radians, one direction across; at least what the sightings scatter by
  double spread = 0;  ///< largest angle of a sighting from the mean, radians
};
/// Nothing where no sighting's pixel lies on its ball.
std::optional<DistantEstimate> estimateDistant(std::span<const MirrorSighting> sightings);

/// A near light: the point that the reflected rays come nearest to, by least squares of angles.
struct NearEstimate {
  Point<AcquisitionSpace> position;
  Mat3 covariance;  ///< units^2: from outlines and highlights, raised where the rays miss each other by more
  double miss = 0;  ///< RMS angle between rays and position over its expectation; about 1 when all is well
};
/// Needs two sightings or more from balls of known radius in perspective views; nothing where there are fewer, where
/// the rays are parallel to within their uncertainty, or where they meet behind a ball.
std::optional<NearEstimate> estimateNear(std::span<const MirrorSighting> sightings);

}  // namespace srf
