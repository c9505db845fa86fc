// A point of the surface in a photograph: the stored texels that show it, and what each counts.
#pragma once

#include <cmath>

#include "base/camera.h"
#include "field/coverage.h"
#include "field/store_geometry.h"

namespace srf {

/// A captured view as fetches see it.
struct SourceView {
  Camera<AcquisitionSpace> camera;
  StoreGeometry geometry;
  /// Of each level of the stored rectangle; none: the view holds no reflectance and is never chosen.
  const Coverage* coverage = nullptr;
  bool black_background = true;  ///< pixels are premultiplied by coverage
  bool matte = false;            ///< texels of any coverage count, and a fetch tells how much of it the object covers
};

/// A mask-aware bilinear fetch (doc: formats, images): the 2 x 2 texels about a pixel and what each counts.
struct Fetch {
  int x = 0, y = 0;    ///< of the first texel in the stored rectangle, at its level; may be -1
  float tap[4] = {};   ///< bilinear weight / coverage, over the usable texels: (x,y), (x+1,y), (x,y+1), (x+1,y+1)
  double covered = 0;  ///< share of the bilinear weight that falls on usable texels; 0: nothing can be fetched
  int level = 0;       ///< of the store
  double alpha = 1;    ///< of a matte view: the coverage of the 2 x 2 texels by their bilinear weights
};
/// A coordinate among texel centres: the texel at or below it, and the way on to the next one, 0 to 1. What lies within
/// 1e-6 of a texel is on it, for the rounding of a projection must not make one texel two.
struct TexelAndPart {
  double texel, part;
};
inline TexelAndPart texelAndPart(double at) {
  const double nearest = std::floor(at + 0.5);
  const double snapped = std::fabs(at - nearest) < 1e-6 ? nearest : at;
  const double texel = std::floor(snapped);
  return {texel, snapped - texel};
}
/// `pixel`: of the photograph, whatever the level.
Fetch bilinearFetch(const SourceView& view, const Vec2& pixel, int level = 0);

}  // namespace srf
