// The lights of a frame as one weight for each acquired light (M13 to M15): what a point needs of its lighting, merged
// over all the scene's lights before any reflectance is touched. The product with the reflectance is a separate step
// (deferred_shading.h).
#pragma once

#include <algorithm>
#include <array>
#include <cstdint>
#include <functional>
#include <memory>
#include <mutex>
#include <optional>
#include <span>
#include <vector>

#include "base/transform.h"
#include "base/uninitialised.h"
#include "render/acquired_lights.h"
#include "render/light_set.h"
#include "render/orientation_grid.h"
#include "render/reflectance_dot.h"
#include "render/shared_keys.h"

namespace srf {

/// A vector of light weights as reflectanceDot takes it: float[3][pad] for a list of `count` lights.
constexpr int lightPad(int count) {
  return (count + 15) / 16 * 16;
}

/// The weights of one list of lights at one hit: a blend of shared vectors, plus a vector of its own or a few entries.
struct LightWeights {
  static constexpr std::uint32_t kNone = 0xffffffffu;
  std::array<std::uint32_t, 4> shared{};  ///< positions in LightGather::wanted
  std::array<float, 4> share{};           ///< 0: unused
  std::uint32_t own = kNone;              ///< start in LightGather::own
  std::uint32_t first_entry = 0, entries = 0;
};

/// Light weights gathered for one block of pixels.
struct LightGather {
  std::vector<LightWeights> weights;
  std::vector<LightEntry> entries;
  UninitialisedVector<float> own;
  SharedKeys wanted;
  std::vector<const float*> vectors;  ///< of `wanted`: SharedLightVectors
  std::vector<Penalised> scratch;
  std::vector<Weighted> nearest;

  /// The weights as one vector of 3 * pad floats: a shared or own one, or `scratch_vector` where they had to be added
  /// up.
  const float* vector(const LightWeights& weights, int pad, float* scratch_vector) const;
  /// An entry costs an operation some ten times what a light of a vector does, and a vector is smaller: for a list of
  /// `lights` lights more entries than this become one.
  static std::size_t fewEntries(int lights) { return static_cast<std::size_t>(std::max(lights / 4, 16)); }
  /// Ends a hit's weights for a list of `lights` lights, whose entries are all those from weights.first_entry on.
  void settle(LightWeights& weights, int lights);
  /// The same; appends them and returns their handle.
  std::uint32_t append(LightWeights weights, int lights);
  void clear();
  std::size_t bytes() const;
};

/// What the lights need to know of a hit.
struct LitPoint {
  Point<AcquisitionSpace> p;
  Point<ObjectSpace> p_star;
  Orthogonal<AcquisitionSpace, ObjectSpace> acquisition_from_object;  ///< L
  Direction<AcquisitionSpace> n0;

  Direction<ObjectSpace> normal() const { return acquisition_from_object.inverse() * n0; }
};

/// The lights of one frame against the lists of acquired lights.
class FrameLighting {
 public:
  /// With fewer distant lights than this the exact weights of a hit cost less than shared ones.
  static constexpr std::size_t kFewestShared = 9;
  struct Options {
    double sharing = 0;       ///< degrees (Accuracy::light_sharing)
    double min_distance = 0;  ///< units: least distance of a point light in A(d)
    /// L of every hit where the frame has one L alone: then one exact vector serves all, whatever `sharing` says.
    std::optional<Orthogonal<AcquisitionSpace, ObjectSpace>> only_orientation;
  };
  /// Lights and lists must outlive it.
  FrameLighting(const FrameLights& lights, std::span<const AcquiredLights> lists, const Options& options);

  /// Whether views of the list can show the frame's lights: they hold every captured light asked for, and lights of
  /// known direction where there are others.
  bool serves(std::size_t list) const { return serves_[list]; }
  /// Appends the weights of a list at a hit and returns their handle. What depends on the hit alone is computed here;
  /// of the shared vectors only the keys are noted.
  std::uint32_t gather(std::uint32_t list, const LitPoint& point, LightGather& out) const;
  /// A hit and the list whose weights are asked for.
  struct Wanted {
    std::uint32_t point, list;
  };
  /// The same for many hits at once, in their order. Of shared vectors and point lights the kernels of light_kernels.h
  /// answer, in float: shares are off by at most 4e-7 of the grid's half cells, a point light's weights by what
  /// nearestWeights states. Where hits share nothing (options().sharing is 0), all is gather()'s in double.
  void gather(std::span<const LitPoint> points, std::span<const Wanted> wanted, LightGather& out) const;
  /// Whether hits share the vectors of the list's distant lights.
  bool shares(std::uint32_t list) const;
  /// The corners of orientation whose shared vectors, blended, hold for an L. Where shares() is true.
  OrientationGrid::Blend sharedCorners(const Orthogonal<AcquisitionSpace, ObjectSpace>& acquisition_from_object) const;
  /// The same of many at once, of L number i, whose shares are off by at most 4e-7 of the grid's half cells.
  void sharedCorners(const std::function<const Orthogonal<AcquisitionSpace, ObjectSpace>&(std::size_t)>& l,
                     std::span<OrientationGrid::Blend> blends) const;
  /// Computes a shared vector: 3 * pad floats, exact for the corner's orientation. `nearest`: where not null, of each
  /// distant light the captured one that counts most.
  void computeShared(const SharedKey& key, float* vector, std::uint32_t* nearest = nullptr) const;
  /// Whether shared vectors of `other` hold for this frame too.
  bool sharesLike(const std::vector<DistantLight>& distant,
                  const std::optional<Orthogonal<AcquisitionSpace, ObjectSpace>>& only_orientation) const;

  const FrameLights& lights() const { return lights_; }
  const Options& options() const { return options_; }
  std::span<const AcquiredLights> lists() const { return lists_; }

 private:
  /// Calls add(light, weight) for the lights of the list that stand for light of `irradiance` from `direction` at p.
  template <class Add>
  void standIn(const AcquiredLights& list, const Direction<AcquisitionSpace>& direction, const Vec3& irradiance,
               const Point<AcquisitionSpace>& p, std::vector<Penalised>& scratch, std::vector<Weighted>& nearest,
               const Add& add) const;
  /// Appends them as entries, in float.
  void standIn(const AcquiredLights& list, const Direction<AcquisitionSpace>& direction, const Vec3& irradiance,
               const Point<AcquisitionSpace>& p, LightGather& out) const;
  void addDistant(const AcquiredLights& list, const LitPoint& point, LightGather& out) const;
  void addNear(const AcquiredLights& list, const NearLight& light, const LitPoint& point, LightGather& out) const;
  void addRest(const AcquiredLights& list, LightGather& out) const;
  void noteShared(std::uint32_t list, const LitPoint& point, LightGather& out, LightWeights& weights) const;
  /// The direction of a point light at a hit, and what it sends there.
  std::pair<Direction<AcquisitionSpace>, Vec3> nearLightAt(const NearLight& light, const LitPoint& point) const;
  void gatherMany(std::uint32_t list, std::span<const LitPoint> points, std::span<const Wanted> wanted,
                  LightGather& out) const;

  const FrameLights& lights_;
  std::span<const AcquiredLights> lists_;
  Options options_;
  std::optional<OrientationGrid> grid_;
  std::vector<bool> serves_;
};

/// Shared vectors, kept from batch to batch and from frame to frame while the distant lights stay the same.
class SharedLightVectors {
 public:
  /// Forgets vectors that do not hold for the frame.
  void prepare(const FrameLighting& lighting);
  void clear();
  /// Tells where the vectors lie that are wanted, and notes those that are not held yet: they are filled by compute().
  /// Threads may ask at once.
  void want(LightGather& gather, const FrameLighting& lighting);
  /// Computes what is noted, in parallel.
  void compute(const FrameLighting& lighting);
  std::size_t bytes() const { return bytes_ + keys_.bytes() + vectors_.capacity() * sizeof(float*); }
  std::uint64_t computed() const { return computed_; }

 private:
  struct alignas(64) Line {
    float value[16];
  };
  struct Chunk {
    std::size_t lines;
    std::unique_ptr<Line[]> memory;
  };
  /// Room for so many floats, whole cache lines.
  float* room(std::size_t floats);

  std::mutex wanting_;
  SharedKeys keys_;
  std::vector<float*> vectors_;  ///< of each key
  std::size_t filled_ = 0;       ///< of them
  std::vector<Chunk> chunks_;
  std::size_t chunk_ = 0, used_ = 0;  ///< where there is room: lines of that chunk in use
  std::vector<DistantLight> distant_;
  std::optional<Orthogonal<AcquisitionSpace, ObjectSpace>> only_orientation_;
  std::size_t bytes_ = 0;  ///< of the chunks
  std::uint64_t computed_ = 0;
};

}  // namespace srf
