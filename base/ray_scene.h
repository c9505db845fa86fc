// Ray casting through Embree; ray_scene.cpp is the one file that includes it. Geometry is stored in float about the
// scene's own centre, so that an object far from the origin loses nothing; hits are given as barycentric or splat
// coordinates, from which the caller computes positions in double (never origin + t * direction).
#pragma once

#include <algorithm>
#include <cstdint>
#include <limits>
#include <memory>
#include <span>
#include <type_traits>
#include <vector>

#include "base/camera.h"
#include "base/mesh.h"
#include "base/parallel.h"
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

/// The splats that each of many rays met, nearest first (ties: lowest index first).
struct SplatLists {
  std::vector<SplatHit> hits;
  std::vector<std::uint32_t> first;  ///< of each ray, and behind the last one the end
  std::span<const SplatHit> of(std::size_t ray) const {
    return std::span(hits).subspan(first[ray], first[ray + 1] - first[ray]);
  }
};

namespace detail {
class EmbreeScene;
/// About the scene's centre, in double: what is traced in float is the part of the ray near the scene.
struct RawRay {
  Vec3 origin, direction;
  double near_distance, far_distance;
};
/// Rays as they come, six numbers each: origin and direction. From each origin the scene's centre is still to be taken.
struct RaysInSpace {
  const double* numbers;
  std::size_t count;
  Vec3 center;
  double near_distance, far_distance;

  RawRay operator[](std::size_t i) const {
    const double* const n = numbers + 6 * i;
    return {Vec3{n[0], n[1], n[2]} - center, {n[3], n[4], n[5]}, near_distance, far_distance};
  }
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
  /// Room for the vertices, x y z each; setTriangles or moveTriangles takes them from there.
  float* positions(std::size_t vertices);
  void setTriangles(std::span<const Triangle> triangles, bool all_finite);
  void moveTriangles(bool all_finite);
  RawSplat* splats(std::size_t count);
  void setSplats(float cutoff);
  void moveSplats();
  void intersect(const RaysInSpace& rays, std::span<TriangleHit> hits) const;
  void occluded(std::span<const RawRay> rays, bool side_by_side, std::span<std::uint8_t> blocked) const;
  void gatherSplats(std::span<const RawRay> rays, float depth_window, SplatLists& lists) const;

 private:
  std::unique_ptr<EmbreeScene> scene_;
};
}  // namespace detail

/// Triangles or splats of one object in `Space`. Queries are thread-safe and use packets of 16 rays.
template <class Space>
class RayScene {
 public:
  /// Copies the triangles. Vertices that are not finite make their triangles invisible.
  static RayScene ofTriangles(std::span<const Point<Space>> positions, std::span<const Triangle> triangles) {
    RayScene scene;
    const bool all_finite = scene.putPositions(positions);
    scene.backend_.setTriangles(triangles, all_finite);
    return scene;
  }
  /// Elliptical splats {center + a u + b v : a^2 + b^2 <= cutoff^2}; `tangents_u`, `tangents_v` need not be orthogonal.
  static RayScene ofSplats(std::span<const Point<Space>> centers, std::span<const Vector<Space>> tangents_u,
                           std::span<const Vector<Space>> tangents_v, double cutoff) {
    RayScene scene;
    scene.putSplats(centers, tangents_u, tangents_v);
    scene.backend_.setSplats(static_cast<float>(cutoff));
    return scene;
  }
  /// New positions for the same triangles: the acceleration structure is refitted, or rebuilt when it has decayed.
  void moveTriangles(std::span<const Point<Space>> positions) {
    const bool all_finite = putPositions(positions);
    backend_.moveTriangles(all_finite);
  }
  /// New places for the same number of splats, likewise.
  void moveSplats(std::span<const Point<Space>> centers, std::span<const Vector<Space>> tangents_u,
                  std::span<const Vector<Space>> tangents_v) {
    putSplats(centers, tangents_u, tangents_v);
    backend_.moveSplats();
  }

  /// Closest triangle of each ray (misses have kNoHit). Sizes must agree. Watertight: no ray slips through an edge or a
  /// vertex of a closed part that it comes upon from outside, nor out of one part that it starts in.
  void intersect(std::span<const Ray<Space>> rays, std::span<TriangleHit> hits, double near_distance = 0) const {
    backend_.intersect(inSpace(rays, near_distance), hits);
  }
  TriangleHit intersect(const Ray<Space>& ray, double near_distance = 0) const {
    TriangleHit hit;
    backend_.intersect(inSpace({&ray, 1}, near_distance), {&hit, 1});
    return hit;
  }
  /// blocked[i] = 1 where something lies on ray i between near_distance and far_distances[i]. `side_by_side`: rays one
  /// after the other mostly run alike, which makes it faster.
  void occluded(std::span<const Ray<Space>> rays, std::span<const double> far_distances, double near_distance,
                std::span<std::uint8_t> blocked, bool side_by_side = false) const {
    constexpr std::size_t kAtOnce = 256;  // of them in the processor's nearest cache
    thread_local std::vector<detail::RawRay> raw(kAtOnce);
    for (std::size_t begin = 0; begin < rays.size(); begin += kAtOnce) {
      const std::size_t count = std::min(kAtOnce, rays.size() - begin);
      for (std::size_t i = 0; i < count; ++i) raw[i] = local(rays[begin + i], near_distance, far_distances[begin + i]);
      backend_.occluded({raw.data(), count}, side_by_side, blocked.subspan(begin, count));
    }
  }
  bool occluded(const Ray<Space>& ray, double near_distance, double far_distance) const {
    const detail::RawRay raw = local(ray, near_distance, far_distance);
    std::uint8_t blocked = 0;
    backend_.occluded({&raw, 1}, false, {&blocked, 1});
    return blocked != 0;
  }
  /// The splats of each ray from the first one to the least, over all it meets, of its distance plus `depth_window`
  /// times the longer of its half axes |u| and |v|. The set does not depend on the order in which they are found.
  void gatherSplats(std::span<const Ray<Space>> rays, double depth_window, SplatLists& lists) const {
    std::vector<detail::RawRay> raw(rays.size());
    for (std::size_t i = 0; i < rays.size(); ++i) raw[i] = local(rays[i], 0, kFar);
    backend_.gatherSplats(raw, static_cast<float>(depth_window), lists);
  }

 private:
  static constexpr double kFar = std::numeric_limits<float>::infinity();
  static constexpr std::size_t kGrain = 1 << 14;

  bool putPositions(std::span<const Point<Space>> positions) {
    const bool all_finite = setCenter(positions);
    float* xyz = backend_.positions(positions.size());
    parallelFor(positions.size(), kGrain, [&](std::size_t begin, std::size_t end) {
      for (std::size_t i = begin; i < end; ++i) put((positions[i] - center_).raw(), xyz + 3 * i);
    });
    return all_finite;
  }
  void putSplats(std::span<const Point<Space>> centers, std::span<const Vector<Space>> u,
                 std::span<const Vector<Space>> v) {
    setCenter(centers);
    detail::RawSplat* splats = backend_.splats(centers.size());
    parallelFor(centers.size(), kGrain, [&](std::size_t begin, std::size_t end) {
      for (std::size_t i = begin; i < end; ++i) {
        put((centers[i] - center_).raw(), splats[i].center);
        put(u[i].raw(), splats[i].u);
        put(v[i].raw(), splats[i].v);
      }
    });
  }
  /// About which the floats count; false: some positions are not finite.
  bool setCenter(std::span<const Point<Space>> positions) {
    struct Part {
      Box<Space> box;
      bool finite = true;
    };
    std::vector<Part> parts((positions.size() + kGrain - 1) / kGrain);
    parallelFor(positions.size(), kGrain, [&](std::size_t begin, std::size_t end) {
      Part part;
      for (std::size_t i = begin; i < end; ++i)
        if (isFinite(positions[i])) {
          const Vec3& p = positions[i].raw();
          for (int k = 0; k < 3; ++k) {
            part.box.min[k] = p[k] < part.box.min[k] ? p[k] : part.box.min[k];
            part.box.max[k] = p[k] > part.box.max[k] ? p[k] : part.box.max[k];
          }
        } else {
          part.finite = false;
        }
      parts[begin / kGrain] = part;
    });
    Part all;
    for (const Part& part : parts) {
      all.finite &= part.finite;
      if (!part.box.empty()) all.box.extend(Point<Space>(part.box.min)), all.box.extend(Point<Space>(part.box.max));
    }
    center_ = all.box.empty() ? Point<Space>() : all.box.center();
    return all.finite;
  }
  detail::RaysInSpace inSpace(std::span<const Ray<Space>> rays, double near_distance) const {
    static_assert(std::is_standard_layout_v<Ray<Space>> && sizeof(Ray<Space>) == 6 * sizeof(double));
    return {reinterpret_cast<const double*>(rays.data()), rays.size(), center_.raw(), near_distance, kFar};
  }
  detail::RawRay local(const Ray<Space>& ray, double near_distance, double far_distance) const {
    return {(ray.origin - center_).raw(), ray.direction.raw(), near_distance, far_distance};
  }
  static void put(const Vec3& from, float* to) {
    for (int i = 0; i < 3; ++i) to[i] = static_cast<float>(from[i]);
  }

  detail::RayBackend backend_;
  Point<Space> center_;
};

}  // namespace srf
