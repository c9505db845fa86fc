// Closed meshes with exact normals, and a field of cameras around them.
#pragma once

#include <cmath>
#include <string>

#include "base/mesh.h"
#include "base/numeric.h"
#include "field/srf_folder.h"

namespace srf::test {

/// Torus about z of radii `major` and `minor`; `around` x `across` quads.
inline AcquisitionMesh torus(int around, int across, double major = 1, double minor = 0.4) {
  AcquisitionMesh mesh;
  for (int i = 0; i < around; ++i)
    for (int j = 0; j < across; ++j) {
      const double a = 2 * kPi * i / around, b = 2 * kPi * j / across;
      const Vec3 out{std::cos(a), std::sin(a), 0}, n = std::cos(b) * out + std::sin(b) * Vec3{0, 0, 1};
      mesh.positions.emplace_back(major * out + minor * n);
      mesh.normals.push_back(Direction<AcquisitionSpace>::fromUnit(n));
      const auto at = [&](int p, int q) { return static_cast<std::uint32_t>((p % around) * across + q % across); };
      mesh.triangles.push_back({at(i, j), at(i + 1, j), at(i + 1, j + 1)});
      mesh.triangles.push_back({at(i, j), at(i + 1, j + 1), at(i, j + 1)});
    }
  return mesh;
}

/// Unit sphere: a cube of n x n x 6 quads blown up, with vertices on edges shared.
inline AcquisitionMesh sphere(int n) {
  AcquisitionMesh mesh;
  std::vector<std::vector<std::uint32_t>> ids;
  const auto add = [&](const Vec3& cube) {
    const Vec3 p = cube / length(cube);
    for (std::uint32_t i = 0; i < mesh.positions.size(); ++i)
      if (length(mesh.positions[i].raw() - p) < 1e-9) return i;
    mesh.positions.emplace_back(p);
    mesh.normals.push_back(Direction<AcquisitionSpace>::fromUnit(p));
    return static_cast<std::uint32_t>(mesh.positions.size() - 1);
  };
  for (int axis = 0; axis < 3; ++axis)
    for (const double side : {-1.0, 1.0}) {
      ids.assign(n + 1, std::vector<std::uint32_t>(n + 1));
      for (int i = 0; i <= n; ++i)
        for (int j = 0; j <= n; ++j) {
          Vec3 p;
          p[axis] = side, p[(axis + 1) % 3] = side * (-1 + 2.0 * i / n), p[(axis + 2) % 3] = -1 + 2.0 * j / n;
          ids[i][j] = add(p);
        }
      for (int i = 0; i < n; ++i)
        for (int j = 0; j < n; ++j) {
          mesh.triangles.push_back({ids[i][j], ids[i + 1][j], ids[i + 1][j + 1]});
          mesh.triangles.push_back({ids[i][j], ids[i + 1][j + 1], ids[i][j + 1]});
        }
    }
  return mesh;
}

/// `count` cameras on a sphere of radius `far` about the origin (Fibonacci), with the field of view that holds a ball
/// of radius 1.5.
inline SrfManifest fieldAround(int count, double far = 6) {
  SrfManifest field;
  for (int i = 0; i < count; ++i) {
    const double z = 1 - (2 * i + 1.0) / count, r = std::sqrt(1 - z * z), a = i * kPi * (3 - std::sqrt(5.0));
    StoredView view;
    view.name = "v" + std::to_string(i);
    view.camera.lens = pinholeFromFov(256, 256, degrees(2 * std::asin(1.6 / far)));
    view.camera.pose = *lookAt(Point<AcquisitionSpace>(far * r * std::cos(a), far * r * std::sin(a), far * z),
                               Point<AcquisitionSpace>(), Vector<AcquisitionSpace>(0.1, 0.2, 1));
    field.views.push_back(view);
  }
  CaptureLight light;
  light.name = "L0";
  field.lights = {light};
  return field;
}

}  // namespace srf::test
