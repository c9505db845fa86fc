// How far points lie from a surface: what tests and benchmarks judge shapes by. surface_distance.cpp includes CGAL.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "base/mesh.h"

namespace srf {

/// The distance of each point to the nearest point of the mesh, units.
std::vector<double> distancesTo(const AcquisitionMesh& mesh, std::span<const Point<AcquisitionSpace>> points);

/// Points spread evenly over a surface, about `count` of them: for distances measured the other way round. `triangles`
/// takes the triangle of each, where given.
std::vector<Point<AcquisitionSpace>> pointsOn(const AcquisitionMesh& mesh, std::size_t count,
                                              std::vector<std::uint32_t>* triangles = nullptr);

}  // namespace srf
