// What interpolation would make of each captured image at a point were its light not there: plainly, and guided by the
// fitted model. The difference decides where guidance is used.
#pragma once

#include "field/lumigraph_weights.h"
#include "model/point_samples.h"

namespace srf {

/// Sums over the samples of a point, weighted by n.v.
struct HoldoutError {
  /// Under the lights that light the point, or those that do not.
  struct Part {
    double lit = 0;        ///< squared error of the model with the residual of the lights that light the point
    double indirect = 0;   ///< of the model with the residual of all lights
    int lights = 0;        ///< that are asked
    int for_indirect = 0;  ///< of those, that the residual of all lights foretells much better
  };
  double plain = 0;  ///< squared error of the weights of M13
  Part in_light, in_shadow;
  double square = 0;  ///< of the samples
};

class LightHoldout {
 public:
  /// For the samples and their `model` values (PointSamples::evaluate).
  HoldoutError operator()(const FitInput& input, const PointSamples& samples,
                          const std::array<std::vector<float>, 3>& model);

 private:
  void transpose(const PointSamples& samples, const std::array<std::vector<float>, 3>& model, std::size_t lights);
  /// Weights of the k lights nearest to light i of those that `accept` takes; returns the angle to the first, radians.
  template <class Accept>
  double nearest(const LightLists::List& list, const PointSamples::Lights& lights, int i, int k, const Accept& accept,
                 std::vector<Weighted>& weights);

  std::vector<const PointSamples::View*> views_;
  // Of the lights of one list, a row for each: channels of all its views, times sqrt(n.v).
  int width_ = 0;
  std::vector<float> value_, model_, residual_, weight_;
  std::vector<Penalised> candidates_;
  std::vector<Weighted> plain_, lit_;
  std::vector<float> plain_row_, lit_row_, indirect_row_;
};

}  // namespace srf
