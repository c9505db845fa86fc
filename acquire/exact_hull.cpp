#include "acquire/exact_hull.h"

#include <CGAL/Constrained_Delaunay_triangulation_2.h>
#include <CGAL/Constrained_triangulation_plus_2.h>
#include <CGAL/Exact_predicates_exact_constructions_kernel.h>
#include <CGAL/Exact_predicates_inexact_constructions_kernel.h>
#include <CGAL/Polygon_mesh_processing/corefinement.h>
#include <CGAL/Polyline_simplification_2/Squared_distance_cost.h>
#include <CGAL/Polyline_simplification_2/simplify.h>
#include <CGAL/Surface_mesh.h>
#include <CGAL/Triangulation_face_base_with_info_2.h>
#include <CGAL/Triangulation_vertex_base_with_info_2.h>

#include <algorithm>
#include <cmath>
#include <deque>
#include <map>
#include <memory>

#include "acquire/silhouette_contours.h"
#include "base/error.h"
#include "base/numeric.h"

namespace srf {
namespace {

using Exact = CGAL::Exact_predicates_exact_constructions_kernel;
using Plane = CGAL::Exact_predicates_inexact_constructions_kernel;
using ExactMesh = CGAL::Surface_mesh<Exact::Point_3>;
using Point3 = Point<AcquisitionSpace>;

Intrinsics withoutDistortion(const Intrinsics& lens) {
  Intrinsics out = lens;
  if (!lens.isOrthographic()) out.model = CameraModel::pinhole;
  out.k1 = out.k2 = out.k3 = out.k4 = out.p1 = out.p2 = 0;
  return out;
}

// The squared distance as the cost, with a share so small that it tells equal costs apart: which of two vertices goes
// first would else be left to CGAL's queue, whose order comes from where things lie in memory.
struct DistinctCost {
  template <class Triangulation, class Iterator>
  boost::optional<double> operator()(const Triangulation& triangulation, Iterator vertex) const {
    const auto cost = CGAL::Polyline_simplification_2::Squared_distance_cost()(triangulation, vertex);
    if (!cost) return cost;
    const auto& p = (*vertex)->point();
    const double turns = 0.7548776662466927 * p.x() + 0.5698402909980532 * p.y(), share = turns - std::floor(turns);
    return *cost * (1 - 1e-9 * share) - 1e-12 * share;
  }
};

// The same loops as fewer points, none of them crossing itself or another.
std::vector<std::vector<Vec2>> simplified(const std::vector<std::vector<Vec2>>& loops, double tolerance) {
  namespace Simplification = CGAL::Polyline_simplification_2;
  using Vertex = Simplification::Vertex_base_2<Plane>;
  using Face = CGAL::Constrained_triangulation_face_base_2<Plane>;
  using Triangulation = CGAL::Constrained_triangulation_plus_2<CGAL::Constrained_Delaunay_triangulation_2<
      Plane, CGAL::Triangulation_data_structure_2<Vertex, Face>, CGAL::Exact_predicates_tag>>;
  Triangulation triangulation;
  std::vector<Triangulation::Constraint_id> inserted;  // the triangulation's own list is sorted by address
  for (const auto& loop : loops) {
    std::vector<Plane::Point_2> points;
    for (const Vec2& p : loop) points.emplace_back(p.x, p.y);
    inserted.push_back(triangulation.insert_constraint(points.begin(), points.end(), true));
  }
  Simplification::simplify(triangulation, DistinctCost(),
                           Simplification::Stop_above_cost_threshold(tolerance * tolerance));
  std::vector<std::vector<Vec2>> out;
  for (const auto c : inserted) {
    std::vector<Vec2> loop;
    for (auto v = triangulation.vertices_in_constraint_begin(c); v != triangulation.vertices_in_constraint_end(c); ++v)
      loop.push_back({(*v)->point().x(), (*v)->point().y()});
    if (loop.size() > 1 && loop.front() == loop.back()) loop.pop_back();
    if (loop.size() >= 3) out.push_back(std::move(loop));
  }
  return out;
}

// The inside of loops (even-odd) as triangles, counter-clockwise in x, y; and the sides of its border, with the inside
// to their left. Loops are lists of points with the numbers that the triangles name them by.
struct FilledPolygons {
  std::vector<Triangle> triangles;
  std::vector<std::array<std::uint32_t, 2>> border;
};
template <class Kernel>
using NumberedLoop = std::vector<std::pair<typename Kernel::Point_2, std::uint32_t>>;
template <class Kernel>
FilledPolygons filled(const std::vector<NumberedLoop<Kernel>>& loops) {
  struct Depth {
    int value = -1;
  };
  using Vertex = CGAL::Triangulation_vertex_base_with_info_2<std::uint32_t, Kernel>;
  using Face =
      CGAL::Triangulation_face_base_with_info_2<Depth, Kernel, CGAL::Constrained_triangulation_face_base_2<Kernel>>;
  using Triangulation =
      CGAL::Constrained_Delaunay_triangulation_2<Kernel, CGAL::Triangulation_data_structure_2<Vertex, Face>>;
  FilledPolygons out;
  Triangulation triangulation;
  for (const auto& loop : loops) {
    std::vector<typename Triangulation::Vertex_handle> handles;
    for (const auto& [point, number] : loop) {
      handles.push_back(triangulation.insert(point));
      handles.back()->info() = number;
    }
    for (std::size_t i = 0; i < handles.size(); ++i)
      triangulation.insert_constraint(handles[i], handles[(i + 1) % handles.size()]);
  }
  // How many sides lie between each face and the unbounded one.
  std::deque<typename Triangulation::Face_handle> queue{triangulation.infinite_face()};
  triangulation.infinite_face()->info().value = 0;
  while (!queue.empty()) {
    const auto face = queue.front();
    queue.pop_front();
    for (int i = 0; i < 3; ++i) {
      const auto beside = face->neighbor(i);
      if (beside->info().value >= 0) continue;
      beside->info().value = face->info().value + triangulation.is_constrained({face, i});
      queue.push_back(beside);
    }
  }
  for (auto f = triangulation.finite_faces_begin(); f != triangulation.finite_faces_end(); ++f) {
    if (f->info().value % 2 == 0) continue;
    out.triangles.push_back({f->vertex(0)->info(), f->vertex(1)->info(), f->vertex(2)->info()});
    for (int i = 0; i < 3; ++i)
      if (f->neighbor(i)->info().value % 2 == 0)
        out.border.push_back({f->vertex((i + 1) % 3)->info(), f->vertex((i + 2) % 3)->info()});
  }
  return out;
}

// A polyhedron whose triangles know the plane that they lie in: those of one facet lie in one plane exactly.
struct Polyhedron {
  using Facets = ExactMesh::Property_map<ExactMesh::Face_index, std::uint32_t>;
  ExactMesh mesh;
  Facets facet = mesh.add_property_map<ExactMesh::Face_index, std::uint32_t>("f:facet", 0).first;

  bool add(ExactMesh::Vertex_index a, ExactMesh::Vertex_index b, ExactMesh::Vertex_index c, std::uint32_t number) {
    const auto face = mesh.add_face(a, b, c);
    if (face == ExactMesh::null_face()) return false;
    facet[face] = number;
    return true;
  }
  void takeFrom(Polyhedron& other) {
    mesh = std::move(other.mesh);
    facet = mesh.property_map<ExactMesh::Face_index, std::uint32_t>("f:facet").first;
  }
};

// The planes of all facets by number, as their normals, not exact: they tell along which axis a facet is looked at.
using FacetNormals = std::vector<Vec3>;

Exact::Point_3 exactPoint(const Vec3& p) {
  return {p.x, p.y, p.z};
}

std::unique_ptr<Polyhedron> boxPolyhedron(const Vec3& low, const Vec3& high, FacetNormals& normals) {
  auto box = std::make_unique<Polyhedron>();
  std::vector<ExactMesh::Vertex_index> corner;
  for (int i = 0; i < 8; ++i)
    corner.push_back(
        box->mesh.add_vertex(exactPoint({i & 1 ? high.x : low.x, i & 2 ? high.y : low.y, i & 4 ? high.z : low.z})));
  const int quads[6][4] = {{0, 2, 3, 1}, {4, 5, 7, 6}, {0, 1, 5, 4}, {2, 6, 7, 3}, {0, 4, 6, 2}, {1, 3, 7, 5}};
  const Vec3 facing[6] = {{0, 0, -1}, {0, 0, 1}, {0, -1, 0}, {0, 1, 0}, {-1, 0, 0}, {1, 0, 0}};
  for (int i = 0; i < 6; ++i) {
    const auto number = static_cast<std::uint32_t>(normals.size());
    normals.push_back(facing[i]);
    const int* q = quads[i];
    box->add(corner[q[0]], corner[q[1]], corner[q[2]], number);
    box->add(corner[q[0]], corner[q[2]], corner[q[3]], number);
  }
  return box;
}

// The cone (orthographic: prism) over the polygons between two depths, about `origin`. Its sides are planes exactly:
// every point is the camera's centre plus a multiple of its ray, without rounding.
std::unique_ptr<Polyhedron> conePolyhedron(const SilhouettePolygons& view, double near_depth, double far_depth,
                                           const Point3& origin, FacetNormals& normals) {
  const Intrinsics& lens = view.camera.lens;
  auto cone = std::make_unique<Polyhedron>();
  std::vector<NumberedLoop<Plane>> loops;
  std::vector<ExactMesh::Vertex_index> near_ring, far_ring;
  std::vector<Vec3> rays;
  const auto along = [](const Vec3& start, const Vec3& ray, double depth) {
    const auto coordinate = [&](int i) { return Exact::FT(start[i]) + Exact::FT(ray[i]) * Exact::FT(depth); };
    const Exact::Point_3 p(coordinate(0), coordinate(1), coordinate(2));
    p.exact();
    return p;
  };
  const Vec3 centre = (view.camera.pose.origin() - origin).raw(), forward = view.camera.forward().raw();
  for (const auto& loop : view.loops) {
    loops.emplace_back();
    for (const Vec2& p : loop) {
      loops.back().emplace_back(Plane::Point_2(p.x, p.y), static_cast<std::uint32_t>(rays.size()));
      const double v = (p.y - lens.cy) / lens.fl_y, u = (p.x - lens.cx - lens.skew * v) / lens.fl_x;
      const Vec3 across = (view.camera.pose.rotation() * Vector<CameraSpace>(u, v, 0)).raw();
      const Vec3 start = lens.isOrthographic() ? centre + across : centre;
      const Vec3 ray = lens.isOrthographic() ? forward : forward + across;
      near_ring.push_back(cone->mesh.add_vertex(along(start, ray, near_depth)));
      far_ring.push_back(cone->mesh.add_vertex(along(start, ray, far_depth)));
      rays.push_back(lens.isOrthographic() ? across : ray);
    }
  }
  const FilledPolygons base = filled<Plane>(loops);
  // A cone of background is taken away: its sides then face the other way.
  const auto number = [&](const Vec3& normal) {
    normals.push_back(view.of_background ? -normal : normal);
    return static_cast<std::uint32_t>(normals.size() - 1);
  };
  // Camera space is right-handed with z forwards: counter-clockwise in x, y faces away from the camera. The ends are
  // not planes to the last bit, so each of their triangles is a facet of its own; they lie outside the bounds anyway.
  for (const Triangle& t : base.triangles) {
    cone->add(near_ring[t[0]], near_ring[t[2]], near_ring[t[1]], number(-forward));
    cone->add(far_ring[t[0]], far_ring[t[1]], far_ring[t[2]], number(forward));
  }
  for (const auto& [p, q] : base.border) {
    const auto side = number(lens.isOrthographic() ? cross(rays[q] - rays[p], forward) : cross(rays[q], rays[p]));
    cone->add(near_ring[p], near_ring[q], far_ring[q], side);
    cone->add(near_ring[p], far_ring[q], far_ring[p], side);
  }
  return cone;
}

// Pieces of a triangle, and copies of it, stay in its facet.
struct FacetVisitor : CGAL::Polygon_mesh_processing::Corefinement::Default_visitor<ExactMesh> {
  using Face = ExactMesh::Face_index;
  struct State {
    Polyhedron &hull, &cone;
    std::uint32_t split = 0;
    Polyhedron::Facets& facetsOf(const ExactMesh& mesh) { return &mesh == &hull.mesh ? hull.facet : cone.facet; }
  };
  State* state;
  explicit FacetVisitor(State* s) : state(s) {}
  void before_subface_creations(Face old, ExactMesh& mesh) { state->split = state->facetsOf(mesh)[old]; }
  void after_subface_created(Face fresh, ExactMesh& mesh) { state->facetsOf(mesh)[fresh] = state->split; }
  void after_face_copy(Face from, const ExactMesh& source, Face to, ExactMesh& target) {
    state->facetsOf(target)[to] = state->facetsOf(source)[from];
  }
};

// The same polyhedron without the vertices that corefinement left within facets and on straight edges. Those are cut
// again by every further cone and their numbers grow with each cut; the true corners, where three planes meet, stay
// short. Nothing where the result would not be manifold.
std::unique_ptr<Polyhedron> withWholeFacets(const Polyhedron& from, const FacetNormals& normals) {
  using Halfedge = ExactMesh::Halfedge_index;
  using VertexIndex = ExactMesh::Vertex_index;
  const ExactMesh& mesh = from.mesh;
  const auto isBorder = [&](Halfedge h) { return from.facet[mesh.face(h)] != from.facet[mesh.face(mesh.opposite(h))]; };
  std::vector<bool> kept(mesh.num_vertices());
  for (const VertexIndex v : mesh.vertices()) {
    VertexIndex ends[2];
    int borders = 0;
    for (const Halfedge h : CGAL::halfedges_around_target(v, mesh))
      if (isBorder(h)) {
        if (borders < 2) ends[borders] = mesh.source(h);
        ++borders;
      }
    kept[v] =
        borders > 2 || (borders == 2 && !CGAL::collinear(mesh.point(ends[0]), mesh.point(v), mesh.point(ends[1])));
  }
  auto out = std::make_unique<Polyhedron>();
  std::vector<VertexIndex> fresh(mesh.num_vertices());
  for (const VertexIndex v : mesh.vertices())
    if (kept[v]) fresh[v] = out->mesh.add_vertex(mesh.point(v));

  std::vector<bool> face_done(mesh.num_faces(), false), edge_done(mesh.num_halfedges(), false);
  for (const auto first : mesh.faces()) {
    if (face_done[first]) continue;
    const std::uint32_t facet = from.facet[first];
    const Vec3 normal = normals[facet];
    int axis = 0;
    for (int i = 1; i < 3; ++i)
      if (std::fabs(normal[i]) > std::fabs(normal[axis])) axis = i;
    // The facet as it is seen along the axis from the positive side.
    const auto flat = [&](VertexIndex v) {
      const auto& p = mesh.point(v);
      return Exact::Point_2(p[(axis + 1) % 3], p[(axis + 2) % 3]);
    };
    std::vector<Halfedge> starts;
    std::vector<ExactMesh::Face_index> stack{first};
    face_done[first] = true;
    while (!stack.empty()) {
      const auto face = stack.back();
      stack.pop_back();
      for (const Halfedge h : CGAL::halfedges_around_face(mesh.halfedge(face), mesh)) {
        if (isBorder(h)) {
          starts.push_back(h);
          continue;
        }
        const auto beside = mesh.face(mesh.opposite(h));
        if (!face_done[beside]) face_done[beside] = true, stack.push_back(beside);
      }
    }
    std::vector<NumberedLoop<Exact>> loops;
    for (const Halfedge start : starts) {
      if (edge_done[start]) continue;
      NumberedLoop<Exact> loop;
      for (Halfedge h = start; !edge_done[h];) {
        edge_done[h] = true;
        const VertexIndex v = mesh.target(h);
        if (kept[v]) loop.emplace_back(flat(v), fresh[v].idx());
        h = mesh.next(h);
        while (!isBorder(h)) h = mesh.next(mesh.opposite(h));
      }
      if (loop.size() < 3) return nullptr;
      loops.push_back(std::move(loop));
    }
    std::vector<Triangle> triangles;
    if (loops.size() == 1 && loops[0].size() == 3) {
      triangles.push_back({loops[0][0].second, loops[0][1].second, loops[0][2].second});
    } else {
      triangles = filled<Exact>(loops).triangles;
      if (normal[axis] < 0)
        for (Triangle& t : triangles) std::swap(t[1], t[2]);
    }
    for (const Triangle& t : triangles)
      if (!out->add(VertexIndex(t[0]), VertexIndex(t[1]), VertexIndex(t[2]), facet)) return nullptr;
  }
  if (!CGAL::is_closed(out->mesh)) return nullptr;
  return out;
}

// Depths that hold the box as a camera sees it; the nearer one stays before the camera.
std::pair<double, double> depthsOf(const Box<AcquisitionSpace>& box, const Camera<AcquisitionSpace>& camera) {
  double low = INFINITY, high = -INFINITY;
  for (int i = 0; i < 8; ++i) {
    const Point3 p(i & 1 ? box.max.x : box.min.x, i & 2 ? box.max.y : box.min.y, i & 4 ? box.max.z : box.min.z);
    const double z = camera.pose.inverseTimes(p).raw().z;
    low = std::min(low, z), high = std::max(high, z);
  }
  const double margin = 0.25 * box.diameter();
  low -= margin, high += margin;
  return {camera.lens.isOrthographic() ? low : std::max(low, 1e-3 * box.diameter()), high};
}

// Views far apart first, so that the hull is small from early on.
std::vector<std::size_t> spreadOrder(std::span<const SilhouettePolygons> views) {
  std::vector<std::size_t> order;
  std::vector<double> nearest(views.size(), INFINITY);
  std::vector<bool> taken(views.size(), false);
  for (std::size_t next = 0; order.size() < views.size();) {
    order.push_back(next);
    taken[next] = true;
    for (std::size_t i = 0; i < views.size(); ++i)
      // A view from the other side shows nearly the same outline, mirrored: the lines count, not the directions.
      nearest[i] =
          std::min(nearest[i], 1 - square(dot(views[i].camera.forward(), views[order.back()].camera.forward())));
    next = 0;
    for (std::size_t i = 0; i < views.size(); ++i)
      if (!taken[i] && (taken[next] || nearest[i] > nearest[next])) next = i;
  }
  return order;
}

}  // namespace

std::size_t SilhouettePolygons::vertexCount() const {
  std::size_t count = 0;
  for (const auto& loop : loops) count += loop.size();
  return count;
}

SilhouettePolygons silhouettePolygons(const SilhouetteView& view, double tolerance) {
  const Intrinsics& lens = view.camera.lens;
  SilhouettePolygons out{view.name, {withoutDistortion(lens), view.camera.pose}, {}, reachesBorder(view.mask)};
  auto loops = silhouetteContours(view.mask, out.of_background);
  if (loops.empty())
    throw badInput(view.name, out.of_background ? "the mask is all object; leave the view out"
                                                : "the mask is empty; leave the view out");
  if (lens.model != out.camera.lens.model || lens.k1 != 0)
    for (auto& loop : loops)
      for (Vec2& p : loop) {
        const auto ray = lens.unproject(p);
        const auto pixel = ray ? out.camera.lens.project(Point<CameraSpace>(ray->raw())) : std::nullopt;
        if (!pixel)
          throw badInput(view.name,
                         "its lens sees part of the outline sideways or not at all; carve this hull "
                         "(--hull carved)");
        p = *pixel;
      }
  out.loops = simplified(loops, tolerance);
  if (out.loops.empty()) throw badInput(view.name, "nothing is left of its outline; simplify it less");
  return out;
}

AcquisitionMesh exactHull(std::span<const SilhouettePolygons> views, const Box<AcquisitionSpace>& bounds,
                          Reporter& reporter) {
  namespace PMP = CGAL::Polygon_mesh_processing;
  if (views.empty()) throw badInput("exact hull", "there are no silhouettes to intersect");
  if (bounds.empty() || !(minComponent(bounds.max - bounds.min) > 0))
    throw badInput("exact hull", "the bounds hold no volume; give the object's box");
  const Point3 origin = bounds.center();
  FacetNormals normals;
  auto hull = boxPolyhedron(bounds.min - origin.raw(), bounds.max - origin.raw(), normals);
  Reporter::Stage stage(reporter, "exact hull", views.size());
  for (const std::size_t i : spreadOrder(views)) {
    const SilhouettePolygons& view = views[i];
    const auto [near_depth, far_depth] = depthsOf(bounds, view.camera);
    stage.advance();
    if (far_depth <= near_depth) continue;  // the box lies behind the camera
    // Side by side: corefinement works in an order that comes from which of the two lies first in memory.
    struct {
      Polyhedron hull, cone;
    } both;
    both.hull.takeFrom(*hull);
    both.cone.takeFrom(*conePolyhedron(view, near_depth, far_depth, origin, normals));
    ExactMesh &result = both.hull.mesh, &cone = both.cone.mesh;
    FacetVisitor::State state{both.hull, both.cone};
    const auto visitor = CGAL::parameters::visitor(FacetVisitor(&state));
    const bool whole = view.of_background ? PMP::corefine_and_compute_difference(result, cone, result, visitor)
                                          : PMP::corefine_and_compute_intersection(result, cone, result, visitor);
    if (!whole)
      throw Error(ErrorKind::failed,
                  "its cone leaves parts that touch in a point or a line, which is no closed surface; simplify the "
                  "contours a little more or less, or carve the hull",
                  view.name);
    if (result.is_empty())
      throw badInput(view.name,
                     "its silhouette takes away the last of the hull: no point lies in all silhouettes; "
                     "check its mask and camera, or leave it out");
    result.collect_garbage();
    // The numbers themselves in place of how they came about: memory stays small and later tests are quick.
    for (const auto v : result.vertices()) result.point(v).exact();
    if (auto simpler = withWholeFacets(both.hull, normals))
      hull = std::move(simpler);
    else
      hull->takeFrom(both.hull);
  }
  AcquisitionMesh mesh;
  for (const auto v : hull->mesh.vertices()) {
    const auto& p = hull->mesh.point(v).exact();
    mesh.positions.push_back(
        origin + Vector<AcquisitionSpace>(CGAL::to_double(p.x()), CGAL::to_double(p.y()), CGAL::to_double(p.z())));
  }
  for (const auto f : hull->mesh.faces()) {
    Triangle t{};
    int k = 0;
    for (const auto v : CGAL::vertices_around_face(hull->mesh.halfedge(f), hull->mesh)) t[k++] = v.idx();
    mesh.triangles.push_back(t);
  }
  return mesh;
}

VisualHull exactVisualHull(const std::vector<SilhouetteView>& views, const VisualHull& carved,
                           const ExactHullOptions& options, Reporter& reporter) {
  std::vector<SilhouettePolygons> polygons;
  std::size_t vertices = 0, most = 0;
  for (std::size_t i = 0; i < views.size(); ++i) {
    if (carved.views[i].excluded) continue;
    polygons.push_back(silhouettePolygons(views[i], options.tolerance));
    vertices += polygons.back().vertexCount();
    most = std::max(most, polygons.back().vertexCount());
  }
  reporter.figure("exact_hull.contour_vertices.mean",
                  static_cast<double>(vertices) / static_cast<double>(std::max<std::size_t>(1, polygons.size())));
  reporter.figure("exact_hull.contour_vertices.most", static_cast<double>(most));
  // The carved box and a little more: the polygons may lie outside the contours by their tolerance.
  Box<AcquisitionSpace> bounds = carved.mesh.bounds();
  const Vec3 margin = (3 + 2 * options.tolerance) * carved.cell * Vec3{1, 1, 1};
  bounds.min -= margin, bounds.max += margin;
  const AcquisitionMesh exact = exactHull(polygons, bounds, reporter);
  reporter.figure("exact_hull.vertices", static_cast<double>(exact.positions.size()));
  reporter.figure("exact_hull.volume", meshVolume(exact));
  VisualHull hull{remeshed(exact, carved.cell, reporter), carved.cell, {}};
  hull.views = silhouetteConsistency(hull.mesh, views);
  for (std::size_t i = 0; i < views.size(); ++i) hull.views[i].excluded = carved.views[i].excluded;
  return hull;
}

}  // namespace srf
