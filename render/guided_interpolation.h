// Interpolation guided by the fitted reflectance model (model/reflectance_fit.h): the patent's interpolation, applied
// to what the model leaves over.
//
//   f(p, l, v) = V(l) M(p, l, v) + V(l) sum_j w_j sum_i c_i [ S_ij - M(p, l_i, v_j) ]        lit residual
//   f(p, l, v) = V(l) M(p, l, v) + V(l) sum_j w_j sum_i d_i [ S_ij - V_i M(p, l_i, v_j) ]    indirect residual
//
// and, of a light that does not reach p, nothing or (1 - V(l)) sum_j w_j sum_i e_i S_ij. S_ij: what view j holds of p
// under light i. w_j: the view weights of M12. d_i: the light weights of M13. c_i: the same restricted to captured
// lights that light p, times a ratio of cosines; e_i: to those that do not. V: whether light reaches p. All are linear
// in S: the light weights of a hit are merged over all lights of the frame as ever, the same blocks are read, and what
// the model adds and takes away is a colour known before any block is. Near a captured light the second form takes over
// whether the light reaches p or not, so that the photograph returns there with its own shadows. Everything is
// evaluated in acquisition space, after L. A pixel's normals spread, and its lobe is wider for it
// (model/normal_spread.h): M(p, l_i, v_j) is the model as the photograph shows it, M(p, l, v) as the picture will. At a
// captured view under a captured light both are the same, and the photograph returns.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "model/deformed_model.h"
#include "model/reflectance_fit.h"
#include "render/guided_kernels.h"
#include "render/light_clusters.h"
#include "render/light_weights.h"
#include "render/look_up.h"
#include "render/scene.h"
#include "render/shadow_sharing.h"
#include "render/shared_stand_ins.h"
#include "render/view_selection.h"

namespace srf {

/// What is rare among a fit's points, so that hits need not look for it: the photographs overrule the rays' bits about
/// some light; guidance does worse about some.
enum FitMark : std::uint8_t { kOverruled = 1, kWorseSomewhere = 2 };
/// FitMarks of each point.
std::vector<std::uint8_t> fitMarks(const ReflectanceFit& fit);

/// What guided interpolation needs of a hit.
struct GuidedQuery {
  const SurfaceHit* hit = nullptr;
  const LookUp* look_up = nullptr;
  Direction<AcquisitionSpace> view;    ///< v
  std::span<const ChosenView> chosen;  ///< weights sum 1
  ShadowCell cell;                     ///< hits of a cell follow one another
  double variance = 0;                 ///< of what the picture's sample stands for (normalSpread)
};

/// The hits of one block of pixels on their way, and memory for it. Arrays hold whole kernel widths (paddedLanes).
struct GuidedBlock {
  struct Hit {
    GuidedQuery query;
    PointReflectance reflectance;
    SymmetricMatrix turn{};  ///< normalTurns
    PointReflectance seen;   ///< through the picture's pixel
    ModelOfPoint model;      ///< of `seen`, along v, object space
    ModelView model_view;
    float gate = 0, indirect = 0, indirect_shadow = 0;
  };
  std::vector<Hit> hits;
  /// Of each hit, where hits share weights: FrameLighting::sharedCorners.
  std::vector<OrientationGrid::Blend> corners;
  std::vector<std::int8_t> sight;  ///< LightSight of each hit and light of the frame (distant, then near)
  /// Of each near light and list the captured lights nearest to it as the hits see it (FrameLighting::Options::sharing
  /// allowing): weight and position of number j at [(light * k + j) * lanes + hit].
  struct Nearest {
    std::vector<float> weight;
    std::vector<std::uint32_t> light;
  };
  std::vector<Nearest> near_weights;  ///< of each list; empty: not found yet, or each for itself
  std::vector<std::int32_t> near_cells;
  std::array<std::vector<float>, 3> near_axis;
  /// Of each hit and near light: direction in object space; irradiance on a plane facing it.
  std::array<std::vector<float>, 3> near_direction, near_irradiance;
  /// Of each hit and light of the frame, as `sight`: what it adds to the picture where nothing hides it (modelAnswers).
  std::array<std::vector<float>, 3> answer;
  std::uint64_t shadow_rays = 0, model_values = 0;  ///< cast, and evaluated (one for each light and view), so far

  /// A list of captured lights as one hit sees it, where they are not at infinity.
  struct Captured {
    std::array<std::vector<float>, 3> direction, irradiance, inverse;
    std::vector<float> known;
    void resize(std::size_t lanes);
    CapturedLanes lanes() const;
  };
  // Memory of one hit. Of each captured light: the share of the hit's points that it lights; 0 where it stands too low
  // over the surface to tell anything, 1 where it does not; whether it may stand for a light that lights the point
  // (lit, also around, and facing); how far photographs and rays differ on `lit`; how far guidance about it is trusted,
  // and whether it is the same for all.
  Captured captured;
  std::vector<float> lit, facing, usable, disagree, gate;
  bool disagrees = false, same_gate = true;
  /// Lights of the frame that are spread by themselves: what a captured light's photograph, and the model of it, count.
  struct Single {
    std::uint32_t light;
    std::array<float, 3> photograph, model;
  };
  std::vector<Single> singles;
  std::array<std::vector<float>, 3> photograph, model;  ///< their sums, where there are many
  std::vector<float> reach;                             ///< of distant lights: how much of each counts
  std::vector<float> shown, energy;                     ///< CapturedShadow, and of distantSums
  std::vector<float> shared, keys;
  std::vector<ModelView> model_views;
  struct Sight {
    std::array<float, 3> view;
    float weight;
  };
  std::vector<Sight> sights;          ///< of the views of a list that a hit is made of
  std::array<SharedKey, 4> last_key;  ///< the corners that the hit before asked for
  std::array<const SharedStandIns::Corner*, 4> last_corner{};
  std::vector<Penalised> order;
  std::vector<Weighted> weights;
  /// Captured lights that the residual of a hit uses, whose model its views of a list take away: places of `used`.
  struct Taken {
    std::uint32_t hit, list;
    std::size_t first, count;
  };
  std::vector<Taken> taken;
  std::array<std::vector<float>, 3> used_direction, used_amount;
  std::size_t used = 0;
  // Memory of the shadow rays.
  struct ShadowRay {
    std::uint32_t light, hit, told;  ///< cluster or, behind these, near light; told: row of `told`
  };
  std::vector<ShadowRay> rays_wanted;
  std::vector<std::uint32_t> ray_order, first_ray;
  std::vector<std::int8_t> told;  ///< LightSight of each hit, then of each group, and cluster of distant lights
  std::vector<float> cluster_keys;
  SharedShadowRays asked;
  std::vector<std::pair<std::uint32_t, std::uint32_t>> groups;  ///< first hit and end of those that tell each other
  std::vector<SharedShadowRays::Alike> alike;                   ///< those of a group after those of the one before
  std::vector<std::size_t> alike_end;                           ///< of each group
  struct Rays {
    std::vector<Ray<ObjectSpace>> ray;
    std::vector<double> far_distance;
    std::vector<std::uint8_t> blocked;
  } rays;
};

/// The lights of one frame, guided by the fit.
class GuidedLighting {
 public:
  struct Options {
    Shadows shadows = Shadows::captured;
    /// For distant lights, of a hit in the mean of those side by side with it, which share what these find
    /// (shadow_sharing.h); of lights that none of them asks after the captured lights' bits tell.
    int shadow_rays = 32;
    double min_distance = 0;   ///< units: least distance of a point light in A(d)
    bool model_alone = false;  ///< no residual: what the model would show without the photographs
  };
  /// Everything must outlive it. The distant lights of `lighting`: ordered by direction (light_clusters.h). `marks`:
  /// fitMarks. `stand_ins`: prepared for the frame. `occluders`: the model whose shadows fall, deformed or at rest.
  GuidedLighting(const ReflectanceFit& fit, std::span<const std::uint8_t> marks, const FrameLighting& lighting,
                 SharedStandIns& stand_ins, const DeformedModel& occluders, std::span<const SourceView> views,
                 std::span<const std::uint32_t> list_of_view, const Options& options);

  /// Turns the weights of a hit's views into guidance's, as far as the gate is open: they fall with n0 . v_i or its
  /// square instead of its root, as FittedPoint::slant says. Where the model knows how views differ, the length of a
  /// view's pixel on the surface, which the difference from the model suffers from, counts for more than how near the
  /// view is.
  void weigh(const SurfaceHit& hit, std::span<ChosenView> chosen) const;
  // A block of hits goes through these four one after the other.
  /// Most hits of a block: what is kept of each and each light stays near.
  std::size_t hitsAtOnce() const;
  /// Blends the fit at the hits, and what it answers to each light of the frame.
  void evaluate(std::span<const GuidedQuery> queries, GuidedBlock& block) const;
  /// Casts the shadow rays of the block.
  void castShadows(GuidedBlock& block) const;
  /// Appends the weights of a list at hit `index` of the block, whose gate must be above 0, returns their handle, and
  /// adds to `color` what the model gives for the views of that list.
  std::uint32_t gather(GuidedBlock& block, std::size_t index, std::uint32_t list, LightGather& out,
                       std::array<double, 3>& color) const;
  /// Takes from the colours of the block's hits what the model gives in place of the photographs that were gathered.
  void takeAway(GuidedBlock& block, std::span<std::array<double, 3>> colors) const;

 private:
  /// What is the same for all hits of a list of distant captured lights; empty for another list.
  struct List {
    GuidedBlock::Captured captured;
    bool in_order = false;  ///< light i of the list is column i of the bits
  };
  std::size_t row() const { return distant_lanes_ + near_lanes_; }
  void blend(const GuidedQuery& query, GuidedBlock::Hit& hit) const;
  /// Finds block.groups, and adds to block.rays_wanted those to distant lights.
  void askTogether(GuidedBlock& block) const;
  /// Fills `sight` where a hit did not ask.
  void tellEachOther(GuidedBlock& block) const;
  /// Fills what the captured lights of a list say of a hit, and returns where they stand.
  CapturedLanes readCaptured(std::uint32_t list, GuidedBlock& block, const GuidedBlock::Hit& hit) const;
  void share(const VisibilityBits& bits, std::uint32_t list, const SurfaceHit& hit, std::vector<float>& shares) const;
  /// Finds block.near_weights of a list, where the kernels can.
  void findNear(GuidedBlock& block, std::uint32_t list) const;
  /// Spreads one light over the captured ones of block.weights, by itself: adds to block.singles, and
  /// returns how much of it the model's part shows, the gate in it.
  float spread(GuidedBlock& block, const GuidedBlock::Hit& hit, const CapturedLanes& captured,
               const Direction<AcquisitionSpace>& direction, float cosine, LightSight sight,
               const std::array<float, 3>& irradiance) const;
  /// How all distant lights at once are spread, by weights that hits of like orientation share.
  ResidualShares spreadShared(GuidedBlock& block, std::size_t index, std::uint32_t list,
                              std::array<float, 3>& sum) const;
  const SharedStandIns::Corner& corner(GuidedBlock& block, int slot, const SharedKey& key) const;

  const ReflectanceFit& fit_;
  std::span<const std::uint8_t> marks_;
  const FrameLighting& lighting_;
  SharedStandIns& stand_ins_;
  const DeformedModel& occluders_;
  std::span<const SourceView> views_;
  std::span<const std::uint32_t> list_of_view_;
  Options options_;
  std::vector<List> lists_;
  std::array<std::vector<float>, 3> irradiance_, direction_;  ///< of each distant light, object space
  std::vector<float> energy_;                                 ///< of each distant light
  LightClusters clusters_;                                    ///< of the distant lights, for shadow rays
  NearClusters near_clusters_;                                ///< that throw one shadow; none where all have rays
  std::size_t distant_lanes_, cluster_lanes_, near_lanes_;    ///< lights of the frame, padded for the kernels
  double offset_;                                             ///< of shadow rays along the normal, units
};

}  // namespace srf
