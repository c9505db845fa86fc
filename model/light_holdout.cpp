#include "model/light_holdout.h"

#include <algorithm>
#include <cmath>

#include "base/numeric.h"

namespace srf {
namespace {

// As rendering has them by default (render/guided_interpolation.cpp).
constexpr int kPlainLights = 4, kLitLights = 3;
constexpr float kLowest = 0.08f;  // n.l of a light whose residual is used
constexpr float kCosine = 0.1f, kMostRatio = 2;
constexpr float kSurelyAverted = -0.1f;  // n.l of a light whose picture is no outline's
constexpr float kMuchBetter = 0.7f;      // of the squared error
const double kFadeFrom = radians(34), kFadeTo = radians(52);

}  // namespace

void LightHoldout::transpose(const PointSamples& samples, const std::array<std::vector<float>, 3>& model,
                             std::size_t lights) {
  views_.clear();
  for (const PointSamples::View& view : samples.views())
    if (view.lights == lights) views_.push_back(&view);
  const int count = samples.lights()[lights].count;
  width_ = (static_cast<int>(views_.size()) * 3 + 7) / 8 * 8;
  for (std::vector<float>* rows : {&value_, &model_, &residual_, &weight_})
    rows->assign(static_cast<std::size_t>(width_) * count, 0.f);
  const auto& inverse = samples.lights()[lights].inverse;
  for (std::size_t v = 0; v < views_.size(); ++v) {
    const float scale = std::sqrt(std::max(views_[v]->cosine, 0.f));
    for (int c = 0; c < 3; ++c)
      for (int k = 0; k < count; ++k) {
        const int s = views_[v]->first + k;
        const std::size_t to = static_cast<std::size_t>(k) * width_ + 3 * v + c;
        const float usable = inverse[c][k] > 0 ? samples.usable()[s] : 0.f;
        value_[to] = scale * samples.values()[c][s];
        model_[to] = scale * model[c][s];
        residual_[to] = usable * (value_[to] - model_[to]);
        weight_[to] = usable;
      }
  }
}

template <class Accept>
double LightHoldout::nearest(const LightLists::List& list, const PointSamples::Lights& lights, int i, int k,
                             const Accept& accept, std::vector<Weighted>& weights) {
  const std::size_t wanted = static_cast<std::size_t>(k) + 1;
  candidates_.clear();
  const auto chord2 = [&](std::uint32_t other) {
    return square(double{lights.x[i]} - lights.x[other]) + square(double{lights.y[i]} - lights.y[other]) +
           square(double{lights.z[i]} - lights.z[other]);
  };
  if (list.distant) {  // by rising angle
    for (const std::uint32_t other : list.others[i]) {
      if (accept(other)) candidates_.push_back({chord2(other), other});
      if (candidates_.size() == wanted) break;
    }
  } else {
    for (std::uint32_t other = 0; other < static_cast<std::uint32_t>(lights.count); ++other) {
      if (other == static_cast<std::uint32_t>(i) || !accept(other)) continue;
      const Penalised found{chord2(other), other};
      if (candidates_.size() < wanted)
        candidates_.push_back(found);
      else if (found < candidates_.back())
        candidates_.back() = found;
      else
        continue;
      for (std::size_t at = candidates_.size() - 1; at > 0 && candidates_[at] < candidates_[at - 1]; --at)
        std::swap(candidates_[at], candidates_[at - 1]);
    }
  }
  for (Penalised& c : candidates_) c.penalty = 2 * std::asin(std::min(1.0, 0.5 * std::sqrt(c.penalty)));
  const double first = candidates_.empty() ? kPi : candidates_.front().penalty;
  lumigraphWeights(candidates_, k, weights);
  return first;
}

HoldoutError LightHoldout::operator()(const FitInput& input, const PointSamples& samples,
                                      const std::array<std::vector<float>, 3>& model) {
  HoldoutError error;
  for (std::size_t l = 0; l < samples.lights().size(); ++l) {
    const PointSamples::Lights& lights = samples.lights()[l];
    const LightLists::List& list = input.lists.lists[lights.list];
    transpose(samples, model, l);
    for (int i = 0; i < lights.count; ++i) {
      const bool known = lights.x[i] != 0 || lights.y[i] != 0 || lights.z[i] != 0;
      if (!known) continue;
      const auto all = [&](int k) { return lights.x[k] != 0 || lights.y[k] != 0 || lights.z[k] != 0; };
      nearest(list, lights, i, kPlainLights, all, plain_);
      if (plain_.empty()) continue;  // a lone light: nothing could stand in for it
      const bool is_lit = lights.lit[i] > 0;
      lit_.clear();
      if (is_lit) {
        const auto usable = [&](int k) { return lights.around[k] > 0 && lights.cosine[k] > kLowest; };
        const double angle = nearest(list, lights, i, kLitLights, usable, lit_);
        const double fade = 1 - smoothstep(kFadeFrom, kFadeTo, angle);
        for (Weighted& w : lit_)
          w.weight *= fade * std::min(kMostRatio, lights.cosine[i] / std::max(lights.cosine[w.source], kCosine));
      }

      plain_row_.assign(width_, 0.f), lit_row_.assign(width_, 0.f), indirect_row_.assign(width_, 0.f);
      const auto add = [&](std::vector<float>& row, const std::vector<float>& from, std::size_t light, double weight) {
        const float w = static_cast<float>(weight);
        const float* values = &from[light * width_];
        for (int x = 0; x < width_; ++x) row[x] += w * values[x];
      };
      for (const Weighted& w : plain_) {
        add(plain_row_, value_, w.source, w.weight);
        add(indirect_row_, lights.lit[w.source] > 0 ? residual_ : value_, w.source, w.weight);
      }
      for (const Weighted& w : lit_) add(lit_row_, residual_, w.source, w.weight);
      if (is_lit) {
        add(lit_row_, model_, i, 1);
        add(indirect_row_, model_, i, 1);
      }
      const float* value = &value_[static_cast<std::size_t>(i) * width_];
      const float* weight = &weight_[static_cast<std::size_t>(i) * width_];
      float plain = 0, lit = 0, indirect = 0, square = 0;
      for (int x = 0; x < width_; ++x) {
        const float w = weight[x];
        plain += w * (plain_row_[x] - value[x]) * (plain_row_[x] - value[x]);
        lit += w * (lit_row_[x] - value[x]) * (lit_row_[x] - value[x]);
        indirect += w * (indirect_row_[x] - value[x]) * (indirect_row_[x] - value[x]);
        square += w * value[x] * value[x];
      }
      error.plain += plain, error.square += square;
      HoldoutError::Part& part = is_lit ? error.in_light : error.in_shadow;
      part.lit += lit, part.indirect += indirect;
      if (is_lit || lights.cosine[i] < kSurelyAverted || lights.cosine[i] > 0) {
        ++part.lights;
        part.for_indirect += indirect < kMuchBetter * lit;
      }
    }
  }
  return error;
}

}  // namespace srf
