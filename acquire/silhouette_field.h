// The field whose zero set is the visual hull (M4a): phi(x) = max over views of D(project(x)) x depth / focal length,
// in units; and the octree that finds the bricks of cells where it may change its sign.
#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "acquire/iso_surface.h"
#include "acquire/signed_silhouette.h"
#include "acquire/visual_hull.h"
#include "base/reporter.h"

namespace srf {

inline constexpr int kMostTolerance = 15;  ///< views that may be overruled

/// A cubic lattice: corner (i, j, k) lies at origin + cell (i, j, k).
struct Lattice {
  Point<AcquisitionSpace> origin;
  double cell = 0;         ///< edge of a cell, units
  std::uint32_t size = 0;  ///< cells along each side: kBrick times a power of two

  Point<AcquisitionSpace> at(const Vec3& corner) const { return origin + Vector<AcquisitionSpace>(cell * corner); }
};
/// The lattice of given cells about a box, with at least two cells around it.
Lattice latticeAround(const Box<AcquisitionSpace>& box, double cell);

/// Views with their distances. The silhouettes must outlive it.
///
/// A view says nothing of points outside its picture or behind its camera. Yet where its silhouette stays off the
/// picture's edge it holds the whole object, so a point is outside that more such views miss than views see it.
class SilhouetteField {
 public:
  /// `tolerance`: views that may call a point outside without carving it: the (tolerance + 1)-th largest value counts.
  SilhouetteField(std::span<const Camera<AcquisitionSpace>> cameras,
                  std::span<const SignedSilhouette* const> silhouettes, int tolerance,
                  const Box<AcquisitionSpace>& bounds);

  /// The brick-sized blocks of the lattice that no bound shows to lie outside, as the box of their corners; empty
  /// where there are none.
  Box<AcquisitionSpace> occupied(const Lattice& lattice) const;
  /// The box of `known` and of what the lattice's corners find inside the surface beyond it; empty where both are.
  Box<AcquisitionSpace> extent(const Lattice& lattice, const Box<AcquisitionSpace>& known) const;
  /// The surface on the lattice, clipped to `bounds`: closed and manifold.
  AcquisitionMesh surface(const Lattice& lattice, Reporter& reporter) const;

 private:
  struct View {
    Camera<AcquisitionSpace> camera;
    const SignedSilhouette* silhouette;
    double stretch;  ///< pixels: bounds how far a movement of the point moves its picture
    double widest;   ///< no point is seen where the length of (x/z, y/z), or a fisheye's angle, is larger
  };
  class Carver;
  std::vector<View> views_;
  int tolerance_;
  Box<AcquisitionSpace> bounds_;
};

}  // namespace srf
