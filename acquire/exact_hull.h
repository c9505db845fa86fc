// The visual hull as the exact intersection of the silhouettes' cones (M4b): a polyhedron without a grid, the reference
// for carving and a choice of its own. exact_hull.cpp includes CGAL: what links it is GPL-3.0-or-later.
#pragma once

#include <span>
#include <string>
#include <vector>

#include "acquire/visual_hull.h"
#include "base/mesh.h"
#include "base/reporter.h"

namespace srf {

/// The silhouette of one view as polygons.
struct SilhouettePolygons {
  std::string name;
  Camera<AcquisitionSpace> camera;       ///< PINHOLE or ORTHOGRAPHIC: the polygons lie in its picture
  std::vector<std::vector<Vec2>> loops;  ///< simple, disjoint, pixels; inside by the even-odd rule
  /// The silhouette is cropped by the picture's border: the loops enclose the background that the picture shows, and
  /// nothing is known of what lies outside them.
  bool of_background = false;

  std::size_t vertexCount() const;
};

/// The contours of a mask, the lens's distortion taken out, simplified so that no vertex of them lies further than
/// `tolerance` pixels (0 or more) from the polygon that is left (Dyken et al. 2009, which keeps the loops apart).
/// Throws bad_input for a mask that is empty or full, and for a lens that looks sideways (a fisheye beyond 90 degrees).
SilhouettePolygons silhouettePolygons(const SilhouetteView& view, double tolerance);

/// Intersects `bounds` with the cone of every view, with exact arithmetic from cone to cone; views whose silhouette is
/// cropped take away the cone of their background. Rounded to doubles at the end. Closed, outward, no normals; it has
/// slivers and tiny edges, as the polyhedron has. Throws bad_input where nothing is left, naming the view that took
/// the last of it.
AcquisitionMesh exactHull(std::span<const SilhouettePolygons> views, const Box<AcquisitionSpace>& bounds,
                          Reporter& reporter);

/// A mesh fit for deformation: edges of about `edge` units, triangles of like size without slivers, and no triangle
/// that cuts another (figure `remesh.self_intersections` counts what could not be mended). Creases are rounded by
/// less than an edge. `mesh` must be closed. With vertex normals.
AcquisitionMesh remeshed(const AcquisitionMesh& mesh, double edge, Reporter& reporter);

struct ExactHullOptions {
  double tolerance = 0.5;  ///< pixels that a simplified contour may be off
};
/// The exact hull of the views that carving kept, within the carved hull's box, remeshed at the carved cell. Takes the
/// place of the carved mesh; `views` are judged anew. Figures `exact_hull.*`.
VisualHull exactVisualHull(const std::vector<SilhouetteView>& views, const VisualHull& carved,
                           const ExactHullOptions& options, Reporter& reporter);

}  // namespace srf
