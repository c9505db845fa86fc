// Where (u0, v0) lie in each tangent plane: a direction field as smooth as the surface allows, so that neighbours
// agree.
#pragma once

#include <vector>

#include "base/mesh.h"

namespace srf {

/// A unit tangent u0 of each vertex of `mesh`, which must have normals. Neighbours' agree but for the turn of their
/// normals, except about the few points where no field on a closed surface can (two on a sphere, none on a torus).
/// Each direction is averaged with what neighbours carry over along the shortest turn of the normal, from groups of
/// many vertices down to single ones (the hierarchy of Jakob et al., Instant Field-Aligned Meshes, 2015). Same input,
/// same bits.
std::vector<Direction<AcquisitionSpace>> smoothDirections(const AcquisitionMesh& mesh);

/// What the shortest turn that takes normal `from` to normal `to` makes of `tangent`, a vector in the plane of `from`.
/// Of opposite normals: as it is.
Vec3 carriedTangent(const Vec3& tangent, const Vec3& from, const Vec3& to);

}  // namespace srf
