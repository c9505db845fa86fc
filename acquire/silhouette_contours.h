// The contour of a silhouette as closed loops of points between pixel centres.
#pragma once

#include <vector>

#include "base/image.h"
#include "base/vec.h"

namespace srf {

/// Where the coverage passes one half, by linear interpolation along the grid of pixel centres (marching squares);
/// pixels, the first pixel's centre at 0.5, 0.5. Loops are simple and disjoint: a hole is a loop within a loop, pixels
/// that touch by a corner alone are apart. Beyond the picture the coverage is 0, so a silhouette that reaches the
/// border is closed along it. With `of_background` the loops are those of what is not object.
std::vector<std::vector<Vec2>> silhouetteContours(const Image8& mask, bool of_background = false);

/// The other way round: what share of each pixel loops cover (even-odd), exact along rows, of 16 rows a pixel.
Image8 coverageOf(const std::vector<std::vector<Vec2>>& loops, int width, int height);

/// Whether the silhouette reaches the picture's border: it may go on outside.
bool reachesBorder(const Image8& mask);

}  // namespace srf
