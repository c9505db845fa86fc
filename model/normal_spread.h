// How far the normals of a surface spread over what a pixel sees of it. A lobe seen through that pixel is as much
// wider: left out, it would be found as roughness, too much of it where the surface bends and pixels are coarse, and of
// two kinds where it bends one way.
//
// D of GGX is that of an ellipsoid of axes alpha_x, alpha_y and 1; turned at random by small angles of variance
// Sigma, the ellipsoid's squared axes become, in the mean, A + Sigma - (Sigma A + A Sigma) / 2 (the matrices of SGGX,
// Heitz et al. 2015): nothing at alpha 1, where D is the same in every direction. That mean keeps second moments,
// which for the long tails of GGX is too little: of all lobes (1 + x^2 / a)^-2 the one nearest, in squares, to one that
// is blurred by Sigma has 3 Sigma in Sigma's place (it would be 2 for Beckmann's, as in Olano and Baker 2010, Kaplanyan
// et al. 2016).
#pragma once

#include <algorithm>
#include <array>
#include <span>
#include <vector>

#include "base/space.h"
#include "model/reflectance_model.h"

namespace srf {

/// Symmetric, of acquisition space: xx xy xz yy yz zz.
using SymmetricMatrix = std::array<float, 6>;
/// a u u' + b (u v' + v u') + c v v'.
SymmetricMatrix symmetricInPlane(double a, double b, double c, const Vec3& u, const Vec3& v);

/// How the normal of each point turns along the surface, radians a unit (the shape operator; its sign means nothing):
/// the straight fit to the normals of the points nearer than `reach`, units, that face the same way; up to eight times
/// as far where these are too few to tell, and 0 where those are.
std::vector<SymmetricMatrix> normalTurns(const std::vector<Point<AcquisitionSpace>>& points,
                                         std::span<const Direction<AcquisitionSpace>> normals, double reach);

/// Where the light of a pixel's value comes from, on a plane that faces the camera: variance along any axis of it, in
/// squares of the pixel's size. Of a pixel as it is, whose square light comes from alike ...
inline constexpr double kPixelVariance = 1.0 / 12;
/// ... and of a value between texels, `x` and `y` of the way on to the next one (0 to 1).
constexpr double betweenTexelsVariance(double x, double y) {
  return kPixelVariance + 0.5 * (x * (1 - x) + y * (1 - y));
}

/// Where the light comes from on the surface: of what has `variance`, squares of units, along any axis of a plane that
/// faces `view`, the part of a slanted surface is as much longer, up to where normalTurns looked. Sums of parts are
/// parts.
inline SymmetricMatrix partSeen(const std::array<float, 3>& normal, const std::array<float, 3>& view, float variance) {
  constexpr float kLeastCosine = 0.3f;  // a pixel's deviation reaches as far as the points around, 1.7 pixels
  const auto [nx, ny, nz] = normal;
  const float cosine = nx * view[0] + ny * view[1] + nz * view[2], least = std::max(cosine, kLeastCosine);
  const float x = view[0] - cosine * nx, y = view[1] - cosine * ny, z = view[2] - cosine * nz;  // down the slope
  const float longer = variance * (1 / (least * least) - 1) / std::max(1 - cosine * cosine, 1e-6f);
  return {variance + longer * x * x, longer * x * y, longer * x * z,
          variance + longer * y * y, longer * y * z, variance + longer * z * z};
}
/// Variance of the normal over a part of the surface, radians squared.
inline SymmetricMatrix normalSpread(const SymmetricMatrix& turn, const SymmetricMatrix& part) {
  const auto [xx, xy, xz, yy, yz, zz] = turn;
  const std::array<float, 3> row[3] = {{xx, xy, xz}, {xy, yy, yz}, {xz, yz, zz}};
  const auto [pxx, pxy, pxz, pyy, pyz, pzz] = part;
  SymmetricMatrix spread;
  int at = 0;
  for (int i = 0; i < 3; ++i) {
    const auto [x, y, z] = row[i];
    const float px = pxx * x + pxy * y + pxz * z, py = pxy * x + pyy * y + pyz * z, pz = pxz * x + pyz * y + pzz * z;
    for (int j = i; j < 3; ++j) spread[at++] = px * row[j][0] + py * row[j][1] + pz * row[j][2];
  }
  return spread;
}

/// The lobe as it is seen where the normal spreads.
PointReflectance seenThrough(const PointReflectance& point, const SymmetricMatrix& spread);

}  // namespace srf
