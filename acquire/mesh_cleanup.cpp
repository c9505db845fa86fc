// remeshed() of exact_hull.h.
#include <CGAL/AABB_face_graph_triangle_primitive.h>
#include <CGAL/AABB_traits.h>
#include <CGAL/AABB_tree.h>
#include <CGAL/Exact_predicates_inexact_constructions_kernel.h>
#include <CGAL/Polygon_mesh_processing/manifoldness.h>
#include <CGAL/Polygon_mesh_processing/remesh.h>
#include <CGAL/Polygon_mesh_processing/repair.h>
#include <CGAL/Polygon_mesh_processing/repair_degeneracies.h>
#include <CGAL/Polygon_mesh_processing/repair_self_intersections.h>
#include <CGAL/Polygon_mesh_processing/self_intersections.h>
#include <CGAL/Polygon_mesh_processing/tangential_relaxation.h>
#include <CGAL/Surface_mesh.h>

#include <algorithm>

#include "acquire/exact_hull.h"
#include "base/error.h"

namespace srf {

AcquisitionMesh remeshed(const AcquisitionMesh& mesh, double edge, Reporter& reporter) {
  namespace PMP = CGAL::Polygon_mesh_processing;
  using Kernel = CGAL::Exact_predicates_inexact_constructions_kernel;
  using Mesh = CGAL::Surface_mesh<Kernel::Point_3>;
  if (!(edge > 0)) throw Error(ErrorKind::usage, "the edge length is not above 0", "remeshing");
  const auto origin = mesh.bounds().center();
  Mesh surface;
  for (const auto& p : mesh.positions) {
    const Vec3 q = (p - origin).raw();
    surface.add_vertex(Kernel::Point_3(q.x, q.y, q.z));
  }
  for (const Triangle& t : mesh.triangles)
    if (surface.add_face(Mesh::Vertex_index(t[0]), Mesh::Vertex_index(t[1]), Mesh::Vertex_index(t[2])) ==
        Mesh::null_face())
      throw badInput("remeshing", "the surface is not manifold; expected a closed surface");
  Reporter::Stage stage(reporter, "remesh", 3);
  PMP::remove_degenerate_faces(surface);
  // Remeshing goes around every vertex by its edges: vertices without any, or of two sheets, would lead it astray.
  PMP::remove_isolated_vertices(surface);
  PMP::duplicate_non_manifold_vertices(surface);
  surface.collect_garbage();
  stage.advance();
  // CGAL's own relaxation steps go around vertices that a collapse has left without edges, and crash; so they are taken
  // between its rounds, when those vertices are gone. All of it stays on the surface as it was.
  constexpr int kRounds = 5, kRelaxations = 2;
  const Mesh input = surface;
  using Primitive = CGAL::AABB_face_graph_triangle_primitive<Mesh>;
  CGAL::AABB_tree<CGAL::AABB_traits<Kernel, Primitive>> tree(faces(input).begin(), faces(input).end(), input);
  for (int round = 0; round < kRounds; ++round) {
    PMP::isotropic_remeshing(faces(surface), edge, surface,
                             CGAL::parameters::number_of_iterations(1).number_of_relaxation_steps(0).do_project(false));
    PMP::remove_isolated_vertices(surface);
    PMP::tangential_relaxation(vertices(surface), surface, CGAL::parameters::number_of_iterations(kRelaxations));
    for (const auto v : vertices(surface)) surface.point(v) = tree.closest_point(surface.point(v));
  }
  stage.advance();
  surface.collect_garbage();
  // Collapses and projection can fold the surface at thin parts; such places are cut out and filled again.
  if (PMP::does_self_intersect(surface)) PMP::experimental::remove_self_intersections(surface);
  surface.collect_garbage();
  std::vector<std::pair<Mesh::Face_index, Mesh::Face_index>> crossing;
  PMP::self_intersections(faces(surface), surface, std::back_inserter(crossing));
  reporter.figure("remesh.self_intersections", static_cast<double>(crossing.size()));

  AcquisitionMesh out;
  for (const auto v : surface.vertices()) {
    const auto& p = surface.point(v);
    out.positions.push_back(origin + Vector<AcquisitionSpace>(p.x(), p.y(), p.z()));
  }
  for (const auto f : surface.faces()) {
    Triangle t{};
    int k = 0;
    for (const auto v : CGAL::vertices_around_face(surface.halfedge(f), surface)) t[k++] = v.idx();
    out.triangles.push_back(t);
  }
  out.normals = vertexNormals(smoothed(out, 10));
  stage.advance();
  return out;
}

}  // namespace srf
