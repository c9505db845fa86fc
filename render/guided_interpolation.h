// Interpolation guided by the fitted reflectance model (model/reflectance_fit.h): the patent's interpolation, applied
// to what the model leaves over.
//
//   f(p, l, v) = V(l) M(p, l, v) + V(l) sum_j w_j sum_i c_i [ S_ij - M(p, l_i, v_j) ]        lit residual
//   f(p, l, v) = V(l) M(p, l, v) +      sum_j w_j sum_i d_i [ S_ij - V_i M(p, l_i, v_j) ]    indirect residual
//
// S_ij: what view j holds of p under light i. w_j: the view weights of M12. d_i: the light weights of M13. c_i: the
// same restricted to captured lights that light p, times a ratio of cosines. V: whether light reaches p. Both are
// linear in S: the light weights of a hit are merged over all lights of the frame as ever, the same blocks are read,
// and what the model adds and takes away is a colour known before any block is. Near a captured light the second form
// takes over, so that the photograph returns there with its own shadows. Everything is evaluated in acquisition space,
// after L.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "model/deformed_model.h"
#include "model/reflectance_fit.h"
#include "render/light_weights.h"
#include "render/look_up.h"
#include "render/scene.h"
#include "render/shared_stand_ins.h"
#include "render/view_selection.h"

namespace srf {

/// What guided interpolation needs of a hit.
struct GuidedQuery {
  const SurfaceHit* hit = nullptr;
  const LookUp* look_up = nullptr;
  Direction<AcquisitionSpace> view;    ///< v
  std::span<const ChosenView> chosen;  ///< weights sum 1
};

/// The hits of one block of pixels on their way, and memory for it.
struct GuidedBlock {
  struct Hit {
    GuidedQuery query;
    PointReflectance reflectance;
    float gate = 0, indirect = 0, indirect_shadow = 0;
    std::array<float, 3> view{};  ///< v
    /// FittedPoint::indirect for a light of which so much reaches the point.
    float indirectUnder(float visible) const { return indirect_shadow + visible * (indirect - indirect_shadow); }
  };
  std::vector<Hit> hits;
  /// Of each hit and light of the frame (distant, then near; a row of GuidedLighting): direction in
  /// acquisition space; irradiance on a plane facing it; how much of it reaches the point, below 0: not asked by a ray.
  std::vector<float> x, y, z, visible;
  std::vector<Vec3> near_irradiance;                ///< of each hit and near light
  std::uint64_t shadow_rays = 0, model_values = 0;  ///< cast, and evaluated (one for each light and view), so far

  /// A captured light as one hit sees it.
  struct Captured {
    float x = 0, y = 0, z = 0;  ///< direction to it
    float lit = 0;              ///< share of the hit's points that it lights
    float facing = 0;           ///< 0 where it stands too low over the surface to tell anything, 1 where it does not
    float usable = 0;  ///< whether it may stand for a light that lights the point: lit, also around, and facing
    float inverse_cosine = 0;
    float disagree = 0;  ///< how far photographs and rays differ on `lit`
    float worse = 0;     ///< share of the hit's points where guidance about this light is worse than plain
  };
  /// What a captured light is multiplied by: [r g b -] of the photographs, [r g b -] of the model's value of them.
  struct Amount {
    float of[8] = {};
  };
  // Memory of one hit.
  std::vector<Captured> captured;
  std::vector<Amount> amounts;              ///< of each captured light
  std::array<std::vector<float>, 3> reach;  ///< of each light of the frame: irradiance that counts
  std::array<std::vector<float>, kModelTerms> terms;
  std::array<std::vector<float>, 3> used_direction, used_amount;  ///< of the captured lights that the residual uses
  std::vector<Penalised> order;
  std::vector<Weighted> weights;
  std::vector<float> shared, toward, amount_lit, as_is;  ///< a blend of shared vectors; sums by captured light
  std::vector<std::pair<float, std::uint32_t>> brightest;
};

/// The lights of one frame, guided by the fit.
class GuidedLighting {
 public:
  struct Options {
    Shadows shadows = Shadows::captured;
    int shadow_rays = 32;      ///< most a hit for distant lights; of the others the captured lights' bits tell
    double min_distance = 0;   ///< units: least distance of a point light in A(d)
    bool model_alone = false;  ///< no residual: what the model would show without the photographs
  };
  /// Everything must outlive it. `stand_ins`: prepared for the frame. `occluders`: the model whose shadows fall,
  /// deformed or at rest.
  GuidedLighting(const ReflectanceFit& fit, const FrameLighting& lighting, SharedStandIns& stand_ins,
                 const DeformedModel& occluders, std::span<const SourceView> views,
                 std::span<const std::uint32_t> list_of_view, const Options& options);

  /// Blends the fit at the hits and casts their shadow rays.
  void prepare(std::span<const GuidedQuery> queries, GuidedBlock& block) const;
  /// Appends the weights of a list at hit `index` of the block, whose gate must be above 0, returns their handle, and
  /// adds to `color` what the model gives and takes for the views of that list.
  std::uint32_t gather(GuidedBlock& block, std::size_t index, std::uint32_t list, LightGather& out,
                       std::array<double, 3>& color) const;

 private:
  void blend(const GuidedQuery& query, GuidedBlock::Hit& hit) const;
  void castShadows(GuidedBlock& block) const;
  void readCaptured(const AcquiredLights& list, GuidedBlock& block, const GuidedBlock::Hit& hit) const;
  /// Spreads lights of the frame, from `first` on, over captured ones, each by itself: adds to block.amounts, fills
  /// block.reach.
  void spread(GuidedBlock& block, std::size_t index, std::uint32_t list, std::size_t first) const;
  /// The same for all distant lights at once, by weights that hits of like orientation share.
  void spreadShared(GuidedBlock& block, std::size_t index, std::uint32_t list) const;

  const ReflectanceFit& fit_;
  const FrameLighting& lighting_;
  SharedStandIns& stand_ins_;
  const DeformedModel& occluders_;
  std::span<const SourceView> views_;
  std::span<const std::uint32_t> list_of_view_;
  Options options_;
  std::array<std::vector<float>, 3> irradiance_, direction_;  ///< of each distant light, object space
  std::size_t row_;                                           ///< lights of the frame, padded for the kernel
  double offset_;                                             ///< of shadow rays along the normal, units
  bool corrected_;                                            ///< photographs overruled the rays' bits somewhere
};

}  // namespace srf
