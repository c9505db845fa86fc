// What interpolation would make of the samples of a point were the photographs they come from not there: plainly, and
// guided by the fitted model. Left out are the light, the view, or both, since a picture may be asked for under a light
// or from a view that no camera took, and a model that is right about the one may be wrong about the other: at a point
// of a hull that no surface is at, each view's photographs are explained well and disagree with those of the others.
#pragma once

#include <array>

#include "field/lumigraph_weights.h"
#include "model/point_samples.h"

namespace srf {

/// Sums over the samples of a point, weighted by n.v.
struct HoldoutError {
  /// As much of the light as lights the point, or does not.
  struct Part {
    double lit = 0;  ///< squared error of the model with the residual of the lights that light the point
    /// Of the model with the residual of all lights; in shadow, of those lights that do not light the point either.
    double indirect = 0;
  };
  struct Case {
    double plain = 0;  ///< squared error of the weights of M12 and M13
    Part in_light, in_shadow;
    Case& operator+=(const Case& other) {
      plain += other.plain;
      in_light.lit += other.in_light.lit, in_light.indirect += other.in_light.indirect;
      in_shadow.lit += other.in_shadow.lit, in_shadow.indirect += other.in_shadow.indirect;
      return *this;
    }
  };
  struct Cases {
    Case light;  ///< the light is left out, the view is there
    Case both;   ///< light and view
    Case view;   ///< the view: the light is a captured one; all in in_light.lit
    /// Close to the captured light, whose lit bit then decides: what is lost where it says dark and photographs do not,
    /// or where a shadow's outline is near, so that the residuals of lights farther away stand for its own.
    Case beside;
    Cases& operator+=(const Cases& other) {
      light += other.light, both += other.both, view += other.view, beside += other.beside;
      return *this;
    }
  };
  Cases all;
  std::vector<std::pair<LightId, Cases>> by_light;
  /// all.view.in_light.lit, were the weights of views to fall with n.v, or with its square, instead of its root.
  std::array<double, 2> view_slanted{};
  double square = 0;  ///< of the samples
  /// Lights left out that do not light the point, and those of them that the residual of all lights foretells much
  /// better.
  struct Count {
    int lights = 0, for_indirect = 0;
  };
  Count hidden;   ///< lights that the surface faces
  Count averted;  ///< lights well behind it: a bowl may hide indirect light from these alone
  /// Of one channel of one view, over all lights left out one at a time: signed sums, since a sky's lights add up.
  /// Errors of one sign, each too small to tell, grow so, while those along a shadow's blurred outline are few.
  struct Sum {
    double weight = 0;  ///< n.v
    double value = 0;   ///< of the samples
    Case light, both;   ///< errors, not squared; `both` is 0 where no other view foretells this one
  };
  std::vector<Sum> sums;
};

class SampleHoldout {
 public:
  /// For the samples and their `model` values (PointSamples::evaluate).
  HoldoutError operator()(const FitInput& input, const PointSamples& samples,
                          const std::array<std::vector<float>, 3>& model);

 private:
  void transpose(const PointSamples& samples, const std::array<std::vector<float>, 3>& model, std::size_t lights);
  /// Fills the half of the rows that foretells each view from the others of its list.
  void foretell(int lights);
  /// Weights of the lights nearest to light i.
  void nearest(const LightLists::List& list, const PointSamples::Lights& lights, int i, std::vector<Weighted>& weights);

  std::vector<const PointSamples::View*> views_;
  // Of the lights of one list, a row for each: channels of its views; then the same as the other views foretell them.
  int half_ = 0, width_ = 0;
  std::vector<float> value_, model_, residual_, weight_;
  std::array<std::vector<float>, 2> slanted_;  ///< the residual as other views foretell it, by Source::slanted
  struct Source {
    int to, from;  ///< views
    float weight;
    std::array<float, 2> slanted;  ///< times the root of n.v, and its cube
  };
  std::vector<Source> sources_;
  std::vector<Penalised> candidates_;
  std::vector<Weighted> plain_, weights_;
  std::vector<float> usable_, plain_row_, lit_row_, indirect_row_, dark_row_;
  std::vector<float> value_sum_, plain_sum_, lit_sum_, indirect_sum_, hidden_sum_, dark_sum_;  ///< of Sum, times n.v
};

}  // namespace srf
