// The samples of one model point as rows of floats, and the least-squares fit of the model's coefficients to them.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "field/srf_folder.h"
#include "model/captured_visibility.h"
#include "model/deformable_model.h"
#include "model/fit_samples.h"
#include "model/nonnegative_least_squares.h"
#include "model/normal_spread.h"
#include "model/reflectance_model.h"

namespace srf {

/// The lists of lights that views were photographed under, each once.
struct LightLists {
  explicit LightLists(const SrfManifest& field);
  struct List {
    std::vector<LightId> ids;
    bool distant = true;  ///< no light at a finite distance: the order below holds everywhere
    /// Of each light of known direction the others by rising angle, at most kOthers: positions in ids.
    static constexpr std::size_t kOthers = 64;
    std::vector<std::vector<std::uint32_t>> others;
  };
  std::vector<List> lists;
  std::vector<std::uint32_t> of_view;
};
/// Normal and tangent of a model: the tangent at `angle` from anyPerpendicular(normal), about the normal.
void setFrame(PointReflectance& point, const Direction<AcquisitionSpace>& normal, double angle);

/// What all points share; must outlive PointSamples.
struct FitInput {
  const SrfManifest& field;
  const DeformableModel& model;
  const LightLists& lists;
  const FitSamples& samples;
  const CapturedVisibility& visibility;
  const std::vector<SymmetricMatrix>& turns;  ///< normalTurns of the points
};

class PointSamples {
 public:
  /// One list of lights as the point sees it; rows padded to 8.
  struct Lights {
    std::uint32_t list = 0;
    int count = 0, pad = 0;
    std::vector<float> x, y, z;                 ///< directions
    std::vector<float> cosine;                  ///< n.l
    std::vector<float> lit, by_ray, around;     ///< 0 or 1: CapturedVisibility
    std::array<std::vector<float>, 3> inverse;  ///< 1 / irradiance; 0 in a dark channel
  };
  struct View {
    std::uint32_t view = 0;
    std::array<float, 3> direction{};
    float cosine = 0;          ///< n.v
    SymmetricMatrix spread{};  ///< normalSpread of what its samples show
    std::uint32_t lights = 0;  ///< position in lights()
    int first = 0;             ///< of its samples in the rows
    bool around = false;       ///< CapturedVisibility::seen_around
  };

  void load(const FitInput& input, std::size_t point, const Direction<AcquisitionSpace>& normal);
  bool empty() const { return views_.empty(); }
  const std::vector<View>& views() const { return views_; }
  const std::vector<Lights>& lights() const { return lights_; }
  /// Reflectance times cosine, as the photographs hold it: [channel][sample].
  const std::array<std::vector<float>, 3>& values() const { return values_; }
  /// 0 where a value was cut off by the camera.
  const std::vector<float>& usable() const { return usable_; }
  int litSamples() const { return lit_samples_; }

  /// The best coefficients for normal, tangent and roughness of `point`, which receives them. `rounds`: 1 plain least
  /// squares, more: with outliers (shadow outlines, indirect light, registration) weighed down.
  /// Returns the weighted squared error over the weighted square of the samples, both of the plain weights.
  /// With more than one round a lobe stays only where it pays; without `lobe` there is none.
  double fit(PointReflectance& point, int rounds, bool lobe = true);
  /// The model at every sample: [channel][sample], for the `point` that fit() was last called with.
  void evaluate(const PointReflectance& point, std::array<std::vector<float>, 3>& model) const;

 private:
  void setWeights();
  void terms(const PointReflectance& point);

  std::vector<View> views_;
  std::vector<Lights> lights_;
  std::array<std::vector<float>, 3> values_;
  std::vector<float> usable_, weights_, robust_, error_;
  std::array<std::vector<float>, kModelTerms> terms_;
  int samples_ = 0;  ///< length of the rows
  int lit_samples_ = 0;
};

}  // namespace srf
