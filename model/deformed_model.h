// A model at one frame: p* = Psi(p0) and the carried tangents of every point, and the ray scene over them (M8, M10,
// M16).
#pragma once

#include <optional>
#include <span>
#include <vector>

#include "base/ray_scene.h"
#include "model/deformable_model.h"
#include "model/deformation.h"
#include "model/mesh_motion.h"

namespace srf {

/// What a ray met: a blend of model points (3 corners of a triangle, or overlapping splats), weights summing to 1.
struct SurfaceHit {
  static constexpr int kMostPoints = 16;
  int count = 0;
  std::uint32_t point[kMostPoints];  ///< model points, by falling weight
  float weight[kMostPoints];
  Point<ObjectSpace> p_star;
  Point<AcquisitionSpace> p0;
  Orthogonal<AcquisitionSpace, TangentSpace>
      acquisition_from_tangent;    ///< R0 of the blended, orthonormalised rest tangents
  Tangents<ObjectSpace> tangents;  ///< blended u, v of the same phase as R0, and the sign
  double distance = 0;             ///< along the ray
};

struct DeformedStatistics {
  std::size_t not_finite = 0;  ///< points that Psi sent nowhere: dropped
  std::size_t mirrored = 0;    ///< points of negative handedness
  std::size_t collapsed = 0;   ///< points whose tangents gave no frame
  /// Points on open parts that a mesh sequence moves: nothing tells whether they are mirrored, they are taken not to
  /// be. Worth a warning.
  std::size_t unsure_handedness = 0;
  std::size_t split = 0;  ///< surfels that the deformation bends too much for one ellipse: smaller ones stand for them
};

/// What rays met of a model, before it is blended.
struct RaysMet {
  std::vector<TriangleHit> triangles;  ///< of each ray; kind mesh
  SplatLists splats;                   ///< kind surfels
};

class DeformedModel {
 public:
  explicit DeformedModel(const DeformableModel& model);  ///< at rest; the model must outlive it
  /// Moves to a frame: always from p0 and R0, so nothing drifts. `moved`: the rest mesh's vertices before the maps of
  /// space, where the animation has a skin or a mesh sequence.
  void deform(const Deformation& psi, const MovedVertices* moved = nullptr);

  const DeformableModel& model() const { return model_; }
  const std::vector<Point<ObjectSpace>>& positions() const { return p_star_; }
  const std::vector<Tangents<ObjectSpace>>& tangents() const { return tangents_; }
  const DeformedStatistics& statistics() const { return statistics_; }
  /// Closest hits of the rays, in packets; misses have count 0. Thread-safe.
  void intersect(std::span<const Ray<ObjectSpace>> rays, std::span<SurfaceHit> hits) const;
  /// Its two halves: the rays through the scene, and the blend of the points that each met.
  void trace(std::span<const Ray<ObjectSpace>> rays, RaysMet& met) const;
  void blend(std::span<const Ray<ObjectSpace>> rays, const RaysMet& met, std::span<SurfaceHit> hits) const;
  /// Ray scene of the deformed triangles or splats (for shadow rays).
  const RayScene<ObjectSpace>& rays() const { return *scene_; }
  Box<ObjectSpace> bounds() const;
  /// How far off the surface, along its normal, shadow rays start, units: above rounding, the facets of a mesh, what
  /// the surface may be off, and the rims of discs that stand out of the triangles that they lie on.
  double shadowOffset() const;
  /// How many rays side by side in a pixel of the camera are as close together as neighbouring surfels, in the middle
  /// of those that face it; 1 where these are as large as a pixel, and for triangles.
  int raysAcross(const Camera<ObjectSpace>& camera) const;

 private:
  void carry(const Deformation& psi, const MovedVertices* moved);
  void updateScene();
  void blendTriangles(std::span<const Ray<ObjectSpace>> rays, std::span<const TriangleHit> met,
                      std::span<SurfaceHit> hits) const;
  void blendSplats(std::span<const Ray<ObjectSpace>> rays, const SplatLists& gathered,
                   std::span<SurfaceHit> hits) const;
  /// Fills the frames of a hit from its points, their carried tangents and weights; phases follow those of `reference`.
  void blendFrames(SurfaceHit& hit, const Tangents<ObjectSpace>* const* carried, std::uint32_t reference,
                   const Tangents<ObjectSpace>& reference_carried) const;
  /// A splat of this frame: a surfel, or a part of one that was split.
  struct Splat {
    std::uint32_t point;  ///< the surfel
    double radius;        ///< at rest
    Point<AcquisitionSpace> p0;
    Point<ObjectSpace> p_star;
    Tangents<ObjectSpace> tangents;
    Vec3 outward;  ///< unit normal, zero where the tangents have none
  };

  const DeformableModel& model_;
  double rest_offset_ = 0;                                              ///< shadowOffset at rest
  std::vector<Orthogonal<AcquisitionSpace, TangentSpace>> rest_frame_;  ///< R0 of each point
  std::vector<Point<ObjectSpace>> p_star_;                              ///< NaN where Psi sends the point nowhere
  std::vector<Tangents<ObjectSpace>> tangents_;
  std::vector<Splat> splats_;       ///< kind surfels
  std::optional<MeshParts> parts_;  ///< of the rest mesh, once its vertices were moved
  std::optional<RayScene<ObjectSpace>> scene_;
  DeformedStatistics statistics_;
};

}  // namespace srf
