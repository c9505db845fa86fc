// The field of (u0, v0): smooth, tangent, and turned the right number of times about the points where it cannot be.
#include "model/direction_field.h"

#include <gtest/gtest.h>

#include <cmath>

#include "base/numeric.h"
#include "tests/model/test_shapes.h"

namespace srf {
namespace {

// How far two neighbours' directions are turned against each other, with sign, about the first one's normal.
double turnBetween(const AcquisitionMesh& mesh, const std::vector<Direction<AcquisitionSpace>>& u, std::uint32_t a,
                   std::uint32_t b) {
  const Vec3 n = mesh.normals[a].raw(), other = carriedTangent(u[b].raw(), mesh.normals[b].raw(), n);
  return std::atan2(dot(cross(u[a].raw(), other), n), dot(u[a].raw(), other));
}

double largestTurn(const AcquisitionMesh& mesh, const std::vector<Direction<AcquisitionSpace>>& u) {
  double largest = 0;
  for (const auto& [a, b, c] : mesh.triangles)
    for (const auto& [from, to] : {std::pair{a, b}, {b, c}, {c, a}})
      largest = std::max(largest, std::fabs(degrees(turnBetween(mesh, u, from, to))));
  return largest;
}

// Triangles about which the field turns round once, by how often; the curvature of a triangle is far below a turn.
int turnsRound(const AcquisitionMesh& mesh, const std::vector<Direction<AcquisitionSpace>>& u, int& places) {
  int turns = 0;
  places = 0;
  for (const auto& [a, b, c] : mesh.triangles) {
    const double sum = turnBetween(mesh, u, a, b) + turnBetween(mesh, u, b, c) + turnBetween(mesh, u, c, a);
    const int here = static_cast<int>(std::lround(sum / (2 * kPi)));
    turns += here;
    places += here != 0;
  }
  return turns;
}

TEST(DirectionField, IsSmoothAllOverAThinTorus) {
  const AcquisitionMesh mesh = test::torus(120, 20, 1, 0.15);
  const auto u = smoothDirections(mesh);
  int places = 0;
  EXPECT_LT(largestTurn(mesh, u), 20);
  EXPECT_EQ(turnsRound(mesh, u, places), 0);
  EXPECT_EQ(places, 0);
  for (std::size_t i = 0; i < u.size(); ++i) {
    EXPECT_NEAR(dot(u[i], mesh.normals[i]), 0, 1e-12);
    EXPECT_NEAR(length(u[i].raw()), 1, 1e-12);
  }
  // The frame of the normal alone has a seam, which is what the field is for.
  std::vector<Direction<AcquisitionSpace>> seamed;
  for (const auto& n : mesh.normals) seamed.push_back(anyPerpendicular(n));
  EXPECT_GT(largestTurn(mesh, seamed), 60);
}

TEST(DirectionField, TurnsRoundTwiceOnASphereAsItMust) {
  const AcquisitionMesh mesh = test::sphere(16);
  const auto u = smoothDirections(mesh);
  int places = 0;
  EXPECT_EQ(std::abs(turnsRound(mesh, u, places)), 2);
  EXPECT_LE(places, 4);
}

TEST(DirectionField, CarriedTangentsKeepLengthAndPlane) {
  const Vec3 from{0, 0, 1}, to{0.6, 0, 0.8}, tangent{0.8, 0.6, 0};
  const Vec3 carried = carriedTangent(tangent, from, to);
  EXPECT_NEAR(length(carried), 1, 1e-15);
  EXPECT_NEAR(dot(carried, to), 0, 1e-15);
  EXPECT_NEAR(carried.y, 0.6, 1e-15);  // across the plane of the turn nothing changes
}

TEST(DirectionField, OpenSurfacesLonelyVerticesAndSharpEdgesHaveDirections) {
  AcquisitionMesh mesh;
  mesh.positions = {Point<AcquisitionSpace>(0, 0, 0), Point<AcquisitionSpace>(1, 0, 0),
                    Point<AcquisitionSpace>(0, 1, 0), Point<AcquisitionSpace>(9, 9, 9)};
  mesh.triangles = {{0, 1, 2}, {0, 2, 1}};
  for (const double z : {1, -1, 1, -1}) mesh.normals.push_back(Direction<AcquisitionSpace>::fromUnit({0, 0, z}));
  for (const auto& u : smoothDirections(mesh)) EXPECT_NEAR(length(u.raw()), 1, 1e-12);
}

}  // namespace
}  // namespace srf
