// Ray casting through Embree; ray_scene.cpp is the one file that includes it. Geometry is stored in float about the
// scene's own centre, so that an object far from the origin loses nothing; hits are given as barycentric or splat
// coordinates, from which the caller computes positions in double (never origin + t * direction).
#pragma once

#include <cstdint>
#include <limits>
#include <memory>
#include <span>
#include <vector>

#include "base/camera.h"
#include "base/mesh.h"
#include "base/space.h"

namespace srf {

inline constexpr std::uint32_t kNoHit = 0xffffffffu;

/// Closest triangle along a ray: weights (1 - b1 - b2, b1, b2) of its corners.
struct TriangleHit {
  std::uint32_t triangle = kNoHit;
  float b1 = 0, b2 = 0;
  float distance = 0;
  bool hit() const { return triangle != kNoHit; }
};

/// One splat met by a ray: x = center + a u + b v.
struct SplatHit {
  std::uint32_t splat = kNoHit;
  float a = 0, b = 0;
  float distance = 0;
};

namespace detail {
class EmbreeScene;
struct RawRay {
  float origin[3];
  float direction[3];
  float near_distance, far_distance;
};
struct RawSplat {
  float center[3], u[3], v[3];
};
class RayBackend {
 public:
  RayBackend();
  ~RayBackend();
  RayBackend(RayBackend&&) noexcept;
  RayBackend& operator=(RayBackend&&) noexcept;
  void setTriangles(std::span<const float> positions_xyz, std::span<const Triangle> triangles);
  void moveTriangles(std::span<const float> positions_xyz);
  void setSplats(std::span<const RawSplat> splats, float cutoff);
  void moveSplats(std::span<const RawSplat> splats);
  void intersect(std::span<const RawRay> rays, std::span<TriangleHit> hits) const;
  void occluded(std::span<const RawRay> rays, std::span<std::uint8_t> blocked) const;
  void gatherSplats(const RawRay& ray, float depth_window, std::vector<SplatHit>& hits) const;

 private:
  std::unique_ptr<EmbreeScene> scene_;
};
}  // namespace detail

/// Triangles or splats of one object in `Space`. Queries are thread-safe and use packets of 16 rays.
template <class Space>
class RayScene {
 public:
  /// Copies the triangles; watertight (Embree's robust mode). Vertices that are not finite make their triangles
  /// invisible.
  static RayScene ofTriangles(std::span<const Point<Space>> positions, std::span<const Triangle> triangles) {
    RayScene scene;
    scene.setCenter(positions);
    scene.backend_.setTriangles(scene.localPositions(positions), triangles);
    return scene;
  }
  /// Elliptical splats {center + a u + b v : a^2 + b^2 <= cutoff^2}; `tangents_u`, `tangents_v` need not be orthogonal.
  static RayScene ofSplats(std::span<const Point<Space>> centers, std::span<const Vector<Space>> tangents_u,
                           std::span<const Vector<Space>> tangents_v, double cutoff) {
    RayScene scene;
    scene.setCenter(centers);
    scene.backend_.setSplats(scene.localSplats(centers, tangents_u, tangents_v), static_cast<float>(cutoff));
    return scene;
  }
  /// New positions for the same triangles: the acceleration structure is refitted, or rebuilt when it has decayed.
  void moveTriangles(std::span<const Point<Space>> positions) {
    setCenter(positions);
    backend_.moveTriangles(localPositions(positions));
  }
  void moveSplats(std::span<const Point<Space>> centers, std::span<const Vector<Space>> tangents_u,
                  std::span<const Vector<Space>> tangents_v) {
    setCenter(centers);
    backend_.moveSplats(localSplats(centers, tangents_u, tangents_v));
  }

  /// Closest triangle of each ray (misses have kNoHit). Sizes must agree.
  void intersect(std::span<const Ray<Space>> rays, std::span<TriangleHit> hits, double near_distance = 0) const {
    std::vector<detail::RawRay> raw(rays.size());
    for (std::size_t i = 0; i < rays.size(); ++i) raw[i] = local(rays[i], near_distance, kFar);
    backend_.intersect(raw, hits);
  }
  TriangleHit intersect(const Ray<Space>& ray, double near_distance = 0) const {
    TriangleHit hit;
    const detail::RawRay raw = local(ray, near_distance, kFar);
    backend_.intersect({&raw, 1}, {&hit, 1});
    return hit;
  }
  /// blocked[i] = 1 where something lies on ray i between near_distance and far_distances[i].
  void occluded(std::span<const Ray<Space>> rays, std::span<const double> far_distances, double near_distance,
                std::span<std::uint8_t> blocked) const {
    std::vector<detail::RawRay> raw(rays.size());
    for (std::size_t i = 0; i < rays.size(); ++i) raw[i] = local(rays[i], near_distance, far_distances[i]);
    backend_.occluded(raw, blocked);
  }
  bool occluded(const Ray<Space>& ray, double near_distance, double far_distance) const {
    const detail::RawRay raw = local(ray, near_distance, far_distance);
    std::uint8_t blocked = 0;
    backend_.occluded({&raw, 1}, {&blocked, 1});
    return blocked != 0;
  }
  /// All splats from the first one met to `depth_window` (units) behind it, nearest first (ties: lowest index first).
  void gatherSplats(const Ray<Space>& ray, double depth_window, std::vector<SplatHit>& hits) const {
    backend_.gatherSplats(local(ray, 0, kFar), static_cast<float>(depth_window), hits);
  }

 private:
  static constexpr double kFar = std::numeric_limits<float>::infinity();

  void setCenter(std::span<const Point<Space>> positions) {
    Box<Space> box;
    for (const auto& p : positions)
      if (isFinite(p)) box.extend(p);
    center_ = box.empty() ? Point<Space>() : box.center();
  }
  std::vector<float> localPositions(std::span<const Point<Space>> positions) const {
    std::vector<float> xyz(positions.size() * 3);
    for (std::size_t i = 0; i < positions.size(); ++i) put((positions[i] - center_).raw(), &xyz[3 * i]);
    return xyz;
  }
  std::vector<detail::RawSplat> localSplats(std::span<const Point<Space>> centers, std::span<const Vector<Space>> u,
                                            std::span<const Vector<Space>> v) const {
    std::vector<detail::RawSplat> splats(centers.size());
    for (std::size_t i = 0; i < centers.size(); ++i) {
      put((centers[i] - center_).raw(), splats[i].center);
      put(u[i].raw(), splats[i].u);
      put(v[i].raw(), splats[i].v);
    }
    return splats;
  }
  detail::RawRay local(const Ray<Space>& ray, double near_distance, double far_distance) const {
    detail::RawRay raw;
    put((ray.origin - center_).raw(), raw.origin);
    put(ray.direction.raw(), raw.direction);
    raw.near_distance = static_cast<float>(near_distance);
    raw.far_distance = static_cast<float>(far_distance);
    return raw;
  }
  static void put(const Vec3& from, float* to) {
    for (int i = 0; i < 3; ++i) to[i] = static_cast<float>(from[i]);
  }

  detail::RayBackend backend_;
  Point<Space> center_;
};

}  // namespace srf
