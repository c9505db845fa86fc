// Sums of the fitted model over many lights of a hit, and what captured lights say of it: kernels of
// guided_interpolation over plain arrays, one array an axis or channel. Arrays hold a multiple of kVectorLanes; what
// lies beyond their count is finite and has amount 0. The same bits in every instruction set: sums run in 16 lanes,
// folded in halves.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>

#include "base/vec.h"
#include "model/reflectance_model.h"
#include "render/vector_lanes.h"

namespace srf {

/// Unit directions to lights.
struct DirectionLanes {
  const float *x, *y, *z;
};

/// The fitted model of one point, and views of it, each with the share that it counts. In the space of the lights.
struct ModelOfPoint {
  std::array<float, 3> n, t, b;
  float ax2, ay2, inverse_ax2, inverse_ay2;
  std::array<float, 3> specular, fresnel;     ///< ks and kf
  std::array<float, 3> lambert, transmitted;  ///< kd and kt, with what depends on the views alone
  float lobe;                                 ///< of all views
};
struct ModelView : ModelSight {
  float share;  ///< with what else depends on the view alone
};
/// A point whose normal and tangent lie in acquisition space, without views.
ModelOfPoint modelOfPoint(const PointReflectance& point);
/// Adds a view in acquisition space. Where it counts by `share`.
ModelView addView(ModelOfPoint& model, const PointReflectance& point, const std::array<float, 3>& view, float share);
/// Turns both to another space. `to_lights`: orthogonal.
void turn(ModelOfPoint& model, ModelView& view, const Mat3& to_lights);

/// sum over views v and lights i of share_v amount[c][i] M_c(l_i, v), for each channel c. Error: at most 1e-4 of
/// sum |share_v amount[c][i]| * (the sum of the largest values of each term over these lights).
std::array<float, 3> modelSums(const ModelOfPoint& model, const ModelView* views, std::size_t view_count,
                               const DirectionLanes& lights, const std::array<const float*, 3>& amount,
                               std::size_t count);
/// The same of one view in double, one light after the other by modelTermsReference: the oracle.
std::array<double, 3> modelSumsReference(const PointReflectance& point, const std::array<float, 3>& view,
                                         const DirectionLanes& lights, const std::array<const float*, 3>& amount,
                                         std::size_t count);

/// sum[i] = share[0] * vector[0][i] + .. + share[3] * vector[3][i], terms in this order.
void blendVectors(const std::array<const float*, 4>& vector, const std::array<float, 4>& share, std::size_t count,
                  float* sum);

/// answer[c][i] = irradiance[c][i] M_c(l_i, v): what a light that is not hidden adds to the picture; 0 below the
/// horizon. Returns how many lights that are not black stand above it.
std::size_t modelAnswers(const ModelOfPoint& model, const ModelView& view, const DirectionLanes& lights,
                         const std::array<const float*, 3>& irradiance, std::size_t count,
                         const std::array<float*, 3>& answer);
/// Adds to key[i] the sum of the channels of answer i, where that is above 0.
void addBrightness(const std::array<const float*, 3>& answer, std::size_t count, float* key);
/// sum over lights i of shown[i] answer[c][i], for each channel c.
std::array<float, 3> shownSums(const std::array<const float*, 3>& answer, const float* shown, std::size_t count);
/// The positions of the `most` largest keys above 0, or of all there are, rising; of equal ones the first. Returns how
/// many; `position` holds `count` rounded up. `about`: where the search for the least of them begins, and then its
/// bits; the answer does not depend on it, only the time.
std::size_t largestKeys(const float* key, std::size_t count, std::size_t most, std::uint32_t* position,
                        std::int32_t& about);

/// What a ray found of a light that a hit faces.
enum LightSight : std::int8_t { kNotAsked = -1, kHidden = 0, kInSight = 1 };

/// The distant lights of a frame.
struct DistantLanes {
  DirectionLanes direction;
  const float* energy;  ///< sum of the channels of irradiance on a plane facing the light
};
/// What the captured lights say of how much of a light about captured light i reaches a hit:
/// shown[(sight + 1) * stride + i]; and how far the model is trusted about them (null: wholly).
struct CapturedShadow {
  const float* shown;
  std::size_t stride;
  const float* trusted;
};
/// Fills shown[3][count] of a CapturedShadow. Where no ray was sent: lit[i] where the light tells of the surface, else
/// 1. Where photographs and rays disagree (null: nowhere), all is drawn towards lit[i] by so much.
void shownBySight(const float* lit, const float* facing, const float* disagree, std::size_t count, float* shown);

/// The model's answer to all distant lights: sum over lights that the hit faces of shown answer[c] (modelAnswers),
/// where `shown` is how much of the light reaches the hit by `sight` and by the captured light `about` it. Adds to
/// energy[4 i] + energy[4 i + 2] what is shown of the energy about captured light i, and to energy[4 i + 1] +
/// energy[4 i + 3] all of it. Only the sum counts less where the model is trusted less.
std::array<float, 3> distantSums(const std::array<float, 3>& n, const DistantLanes& lights,
                                 const std::array<const float*, 3>& answer, const std::int8_t* sight,
                                 const std::uint32_t* about, const CapturedShadow& shadow, std::size_t count,
                                 float* energy);

/// The captured lights of one list as hits see them.
struct CapturedLanes {
  DirectionLanes direction;
  const float* known;                               ///< 1: of known direction, 0: not
  std::array<const float*, 3> irradiance, inverse;  ///< on a plane facing the light, and 1 / it; 0 where it is dark
};
/// facing[i]: 0 where light i stands too low over the surface to tell anything of it, 1 where it does not; usable[i]
/// *= facing[i], or, where no light is usable, = lit[i] facing[i]. Unknown lights get 0 in all three.
void facingCaptured(const std::array<float, 3>& n, const CapturedLanes& lights, std::size_t count, float* lit,
                    float* usable, float* facing);

/// How the residual of a hit is taken from captured lights that stand for all distant ones together. The lit lights are
/// scaled to sum to what is shown, the others to what is hidden, by at most `most_ratio`.
struct ResidualShares {
  float indirect, indirect_shadow, most_ratio;
  const float* energy;                     ///< about each captured light: what is shown, and all (distantSums)
  const float *gate, *lit, *usable;        ///< of each captured light
  std::array<const float*, 3> irradiance;  ///< for which each captured light stands
};
/// Irradiance by which each captured light counts in what photographs give and in what the model takes away.
struct ResidualAmounts {
  std::array<const float*, 3> photograph, model;
};
/// What the amounts of a hit come to: those of `distant` (null: none) and `single` (null: none) together. out[c] =
/// photograph[c] * inverse[c]; model[c] = 0 where inverse[c] is. Copies direction and model of the lights whose model
/// is not 0 to `used`, one after the other and then amounts of 0 up to paddedLanes. Returns how many of these there
/// are, and in `photographs` how many lights have a photograph.
struct UsedLanes {
  std::array<float*, 3> direction, model;
};
std::size_t usedLights(const CapturedLanes& lights, std::size_t count, const ResidualShares* distant,
                       const ResidualAmounts* single, const std::array<float*, 3>& out, const UsedLanes& used,
                       std::size_t& photographs);

/// shares[i] = min(1, sum over p of weight[p] * (bit i of rows[p])), points one after the other.
void shareBits(const std::uint64_t* const* rows, const float* weight, int points, std::size_t count, float* shares);

}  // namespace srf
