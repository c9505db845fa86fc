// Surfels: points spread evenly over a mesh, each with the radius at which its disc joins its neighbours' (M9).
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "base/mesh.h"
#include "base/reporter.h"

namespace srf {

struct SurfaceSamples {
  std::vector<Point<AcquisitionSpace>> points;
  std::vector<Direction<AcquisitionSpace>> normals;
  std::vector<std::uint32_t> triangle;        ///< that each point lies on
  std::vector<std::array<float, 2>> weights;  ///< b1, b2 there; the point is at (1 - b1 - b2, b1, b2) to rounding
  double radius = 0;                          ///< units; discs of this radius leave no hole at rest
};

/// About `count` points spread evenly, darts no two of which on one side of an edge are nearer than a common distance
/// (Poisson discs), and points in the gaps between: the line through any place of the surface along the normal of its
/// triangle meets a disc whose normal is within 60 degrees of it. More points than asked for where much of the surface
/// is edge. The mesh must have normals and area. Same input, same points.
SurfaceSamples sampleSurface(const AcquisitionMesh& mesh, std::size_t count, Reporter& reporter);

}  // namespace srf
