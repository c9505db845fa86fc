#include "acquire/surface_distance.h"

#include <CGAL/AABB_traits.h>
#include <CGAL/AABB_tree.h>
#include <CGAL/AABB_triangle_primitive.h>
#include <CGAL/Simple_cartesian.h>

#include <algorithm>
#include <cmath>

#include "base/parallel.h"

namespace srf {

std::vector<double> distancesTo(const AcquisitionMesh& mesh, std::span<const Point<AcquisitionSpace>> points) {
  using Kernel = CGAL::Simple_cartesian<double>;
  using Triangles = std::vector<Kernel::Triangle_3>;
  using Tree =
      CGAL::AABB_tree<CGAL::AABB_traits<Kernel, CGAL::AABB_triangle_primitive<Kernel, Triangles::const_iterator>>>;
  const auto origin = mesh.bounds().center();
  const auto local = [&](const Point<AcquisitionSpace>& p) {
    const Vec3 q = (p - origin).raw();
    return Kernel::Point_3(q.x, q.y, q.z);
  };
  Triangles triangles;
  for (const Triangle& t : mesh.triangles) {
    const Kernel::Triangle_3 triangle(local(mesh.positions[t[0]]), local(mesh.positions[t[1]]),
                                      local(mesh.positions[t[2]]));
    if (!triangle.is_degenerate()) triangles.push_back(triangle);
  }
  Tree tree(triangles.cbegin(), triangles.cend());
  tree.build();
  tree.accelerate_distance_queries();
  std::vector<double> out(points.size());
  parallelFor(points.size(), 256, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) out[i] = std::sqrt(tree.squared_distance(local(points[i])));
  });
  return out;
}

std::vector<Point<AcquisitionSpace>> pointsOn(const AcquisitionMesh& mesh, std::size_t count,
                                              std::vector<std::uint32_t>* triangles) {
  std::vector<Point<AcquisitionSpace>> points;
  const double area = meshArea(mesh), each = area / static_cast<double>(std::max<std::size_t>(1, count));
  double left = 0.5 * each;  // until the next point
  double u = 0.5, v = 0.5;   // R2 sequence (Roberts 2018)
  for (const Triangle& t : mesh.triangles) {
    const auto &a = mesh.positions[t[0]], &b = mesh.positions[t[1]], &c = mesh.positions[t[2]];
    double here = 0.5 * length(cross(b - a, c - a));
    while (here > left) {
      here -= left;
      left = each;
      u = std::fmod(u + 0.7548776662466927, 1.0), v = std::fmod(v + 0.5698402909980532, 1.0);
      const double s = u + v > 1 ? 1 - u : u, w = u + v > 1 ? 1 - v : v;
      points.push_back(a + s * (b - a) + w * (c - a));
      if (triangles) triangles->push_back(static_cast<std::uint32_t>(&t - mesh.triangles.data()));
    }
    left -= here;
  }
  return points;
}

}  // namespace srf
