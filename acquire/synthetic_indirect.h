// Light that reaches a point of a synthetic object by way of the object itself: reflected from matt surface to matt
// surface, or scattered below the surface of wax. Both are linear in the direct irradiance and smooth over the surface,
// so they are found at the vertices of a coarse mesh, for all lights at once, and interpolated.
#pragma once

#include <array>
#include <functional>
#include <optional>
#include <span>
#include <vector>

#include "acquire/synthetic_object.h"
#include "base/ray_scene.h"

namespace srf {

/// Interreflection: I(p) = integral over the hemisphere of albedo / pi (E + I)(q) cos, q the surface point seen in that
/// direction, E the direct irradiance.
/// Wax: I(p) = integral of R(|p - q|) E(q) dA(q) / integral of R(|p - q|) dA(q), with the profile of Christensen and
/// Burley 2015, R(r) = (exp(-r/d) + exp(-r/3d)) / r, d = 0.12, 0.06, 0.04 units for red, green, blue.
/// The radiance of p is albedo(p) / pi I(p), to which a matt surface adds what it reflects of E(p).
class IndirectLight {
 public:
  using Points = std::vector<Point<AcquisitionSpace>>;
  /// Where reflected light travels: the object at rest or in another pose.
  struct TravelSpace;
  using Pose = std::function<Point<TravelSpace>(const Point<AcquisitionSpace>&)>;
  /// Irradiance of light `light` at every probe, cosine and cast shadows included. Called by several threads.
  using DirectAt = std::function<std::vector<Vec3>(std::size_t light)>;

  /// For an object whose transport() is not direct. `pose` takes rest points to where reflected light travels; without
  /// it they stay. Below the surface light travels as at rest, whatever the pose.
  explicit IndirectLight(const SyntheticObject& object, const Pose& pose = {});

  /// Points of the surface at rest where the direct irradiance has to be known.
  const Points& probes() const { return probes_; }
  /// I at every vertex under each of `lights` lights.
  void solve(std::size_t lights, const DirectAt& direct_at);

  /// Where a point of the surface lies on the coarse mesh.
  struct Place {
    std::array<std::uint32_t, 3> vertex{};
    std::array<float, 3> weight{};
  };
  Place place(const Point<AcquisitionSpace>& p, const Direction<AcquisitionSpace>& normal) const;
  /// I after solve().
  Vec3 at(const Place& place, std::size_t light) const;

 private:
  void prepareBounces(const Pose& pose);
  void solveBatch(std::size_t first, std::size_t count, const DirectAt& direct_at);
  void bounce(const std::vector<float>& of_triangles, std::size_t columns, std::vector<float>& of_vertices) const;
  void scatter(const std::vector<float>& of_triangles, std::size_t columns, std::vector<float>& of_vertices) const;

  SyntheticTransport transport_;
  AcquisitionMesh mesh_;
  std::vector<Vec3> albedo_;  // of its triangles
  Points probes_;             // kProbes a triangle
  std::optional<RayScene<AcquisitionSpace>> rest_;
  std::vector<std::uint32_t> seen_;  // interreflection: by vertex, the triangle that each of its rays meets, or kNoHit
  std::vector<float> values_;        // [light][vertex][channel]
};

}  // namespace srf
