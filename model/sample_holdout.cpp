#include "model/sample_holdout.h"

#include <algorithm>
#include <cmath>
#include <cstring>

#include "base/numeric.h"

namespace srf {
namespace {

// As rendering has them by default (render/guided_interpolation.cpp, render/view_selection.cpp).
constexpr int kLights = 4, kGuidedLights = 3, kViews = 4;
constexpr float kLowest = 0.05f, kLowEnough = 0.12f;  // n.l of a light whose residual is used
constexpr float kCosine = 0.1f, kMostRatio = 2;
constexpr float kFade = 0.25f;
constexpr float kLeastForeshortening = 0.05f;
constexpr float kSurelyAverted = -0.1f;  // n.l of a light whose picture is no outline's
constexpr float kMuchBetter = 0.7f;      // of the squared error
constexpr double kBesideError = 0.25;    // of plain's squared error, half way to the light that was left out
constexpr float kBesideShare = 0.75f;    // of the weights that a captured light has close to it
constexpr int kChannels = 4;             // of a view in a row: red, green, blue and none

using View = float __attribute__((vector_size(kChannels * sizeof(float))));
View viewAt(const std::vector<float>& row, std::size_t at) {
  View view;
  std::memcpy(&view, &row[at], sizeof view);
  return view;
}
void put(const View& view, std::vector<float>& row, std::size_t at) {
  std::memcpy(&row[at], &view, sizeof view);
}

}  // namespace

void SampleHoldout::transpose(const PointSamples& samples, const std::array<std::vector<float>, 3>& model,
                              std::size_t lights) {
  views_.clear();
  for (const PointSamples::View& view : samples.views())
    if (view.lights == lights) views_.push_back(&view);
  const int count = samples.lights()[lights].count;
  half_ = (static_cast<int>(views_.size()) * kChannels + 7) / 8 * 8;
  width_ = 2 * half_;
  for (std::vector<float>* rows : {&value_, &model_, &residual_, &weight_})
    rows->assign(static_cast<std::size_t>(width_) * count, 0.f);
  const auto& inverse = samples.lights()[lights].inverse;
  const std::vector<float>& lit = samples.lights()[lights].lit;
  for (std::size_t v = 0; v < views_.size(); ++v) {
    const float weight = std::max(views_[v]->cosine, 0.f);
    for (int c = 0; c < 3; ++c)
      for (int k = 0; k < count; ++k) {
        const int s = views_[v]->first + k;
        const std::size_t to = static_cast<std::size_t>(k) * width_ + kChannels * v + c;
        const float usable = inverse[c][k] > 0 ? samples.usable()[s] : 0.f;
        value_[to] = samples.values()[c][s];
        model_[to] = model[c][s];
        residual_[to] = usable * (value_[to] - lit[k] * model_[to]);
        weight_[to] = usable * weight;
      }
  }
}

void SampleHoldout::foretell(int lights) {
  sources_.clear();
  const int views = static_cast<int>(views_.size());
  for (int to = 0; to < views && views > 1; ++to) {
    const auto& v = views_[to]->direction;
    candidates_.clear();
    for (int from = 0; from < views; ++from) {
      if (from == to) continue;
      const auto& u = views_[from]->direction;
      const double chord2 = square(double{v[0]} - u[0]) + square(double{v[1]} - u[1]) + square(double{v[2]} - u[2]);
      const double usable = std::sqrt(std::max(views_[from]->cosine, kLeastForeshortening));
      candidates_.push_back({viewPenalty(2 * std::asin(std::min(1.0, 0.5 * std::sqrt(chord2))), 0, usable),
                             static_cast<std::uint32_t>(from)});
    }
    lumigraphWeights(candidates_, kViews, weights_);
    const auto slanted = [&](const Weighted& w) {
      const double root = std::sqrt(std::max(views_[w.source]->cosine, kLeastForeshortening));
      return std::array{w.weight * root, w.weight * root * root * root};
    };
    std::array<double, 2> sum{};
    for (const Weighted& w : weights_) {
      const auto [once, thrice] = slanted(w);
      sum[0] += once, sum[1] += thrice;
    }
    for (const Weighted& w : weights_) {
      const auto [once, thrice] = slanted(w);
      sources_.push_back({to,
                          static_cast<int>(w.source),
                          static_cast<float>(w.weight),
                          {static_cast<float>(once / sum[0]), static_cast<float>(thrice / sum[1])}});
    }
  }
  for (std::vector<float>& rows : slanted_) rows.assign(static_cast<std::size_t>(half_) * lights, 0.f);
  for (int k = 0; k < lights; ++k) {
    const std::size_t row = static_cast<std::size_t>(k) * width_;
    for (const Source& s : sources_) {
      const std::size_t at = row + kChannels * s.to, to = at + half_, from = row + kChannels * s.from;
      const std::size_t slanted = static_cast<std::size_t>(k) * half_ + kChannels * s.to;
      const View residual = viewAt(residual_, from);
      put(viewAt(value_, to) + s.weight * viewAt(value_, from), value_, to);
      put(viewAt(residual_, to) + s.weight * residual, residual_, to);
      for (int way = 0; way < 2; ++way)
        put(viewAt(slanted_[way], slanted) + s.slanted[way] * residual, slanted_[way], slanted);
      put(viewAt(model_, at), model_, to);
      put(viewAt(weight_, at), weight_, to);
    }
  }
}

void SampleHoldout::nearest(const LightLists::List& list, const PointSamples::Lights& lights, int i,
                            std::vector<Weighted>& weights) {
  constexpr std::size_t kWanted = kLights + 1;
  const auto known = [&](std::uint32_t k) { return lights.x[k] != 0 || lights.y[k] != 0 || lights.z[k] != 0; };
  const auto chord2 = [&](std::uint32_t other) {
    return square(double{lights.x[i]} - lights.x[other]) + square(double{lights.y[i]} - lights.y[other]) +
           square(double{lights.z[i]} - lights.z[other]);
  };
  candidates_.clear();
  if (list.distant) {  // by rising angle
    for (const std::uint32_t other : list.others[i]) {
      candidates_.push_back({chord2(other), other});
      if (candidates_.size() == kWanted) break;
    }
  } else {
    for (std::uint32_t other = 0; other < static_cast<std::uint32_t>(lights.count); ++other) {
      if (other == static_cast<std::uint32_t>(i) || !known(other)) continue;
      const Penalised found{chord2(other), other};
      if (candidates_.size() < kWanted)
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
  lumigraphWeights(candidates_, kLights, weights);
}

HoldoutError SampleHoldout::operator()(const FitInput& input, const PointSamples& samples,
                                       const std::array<std::vector<float>, 3>& model) {
  HoldoutError error;
  for (std::size_t l = 0; l < samples.lights().size(); ++l) {
    const PointSamples::Lights& lights = samples.lights()[l];
    const LightLists::List& list = input.lists.lists[lights.list];
    transpose(samples, model, l);
    foretell(lights.count);
    const auto known = [&](std::uint32_t k) { return lights.x[k] != 0 || lights.y[k] != 0 || lights.z[k] != 0; };
    bool any_around = false;
    for (int k = 0; k < lights.count; ++k) any_around = any_around || lights.around[k] > 0;
    usable_.assign(lights.count, 0.f);
    for (int k = 0; k < lights.count; ++k)
      usable_[k] = (any_around ? lights.around[k] : lights.lit[k]) *
                   static_cast<float>(smoothstep(kLowest, kLowEnough, lights.cosine[k]));
    value_sum_.assign(half_, 0.f);
    for (std::vector<float>* row : {&plain_sum_, &lit_sum_, &indirect_sum_, &hidden_sum_, &dark_sum_})
      row->assign(width_, 0.f);
    for (int i = 0; i < lights.count; ++i) {
      if (!known(i)) continue;
      nearest(list, lights, i, plain_);
      if (plain_.empty()) continue;  // a lone light: nothing could stand in for it
      // Whether the light reaches the point: by the ray, corrected by the lights about it as rendering does; what the
      // photographs under the light itself say is left out.
      float usable = 0, unlit = 0, visible = lights.by_ray[i];
      double disagree = 0, lit_there = 0;
      for (const Weighted& w : plain_) {
        const bool differs = lights.lit[w.source] != lights.by_ray[w.source];
        disagree += differs ? w.weight : 0;
        lit_there += differs ? w.weight * lights.lit[w.source] : 0;
        usable += static_cast<float>(w.weight) * usable_[w.source];
        unlit += static_cast<float>(w.weight) * (1 - lights.lit[w.source]);
      }
      if (disagree > 0) visible = static_cast<float>((1 - disagree) * visible + lit_there);
      if (!(lights.cosine[i] > 0)) visible = 0;
      const auto relight = [](float share) {
        return share > 0 ? static_cast<float>(smoothstep(0, kFade, share)) / share : 0.f;
      };

      for (std::vector<float>* row : {&plain_row_, &lit_row_, &indirect_row_, &dark_row_}) row->assign(width_, 0.f);
      const auto add = [&](std::vector<float>& row, const std::vector<float>& from, std::size_t light, float w) {
        if (w == 0) return;
        const float* values = &from[light * width_];
        for (int x = 0; x < width_; ++x) row[x] += w * values[x];
      };
      for (const Weighted& w : plain_) {
        const auto weight = static_cast<float>(w.weight);
        add(plain_row_, value_, w.source, weight);
        add(indirect_row_, residual_, w.source, weight);
        add(dark_row_, residual_, w.source, weight * (1 - lights.lit[w.source]));
        const float ratio = std::min(kMostRatio, lights.cosine[i] / std::max(lights.cosine[w.source], kCosine));
        add(lit_row_, residual_, w.source, weight * usable_[w.source] * ratio);
      }

      const float* const value = &value_[static_cast<std::size_t>(i) * width_];
      const float* const residual = &residual_[static_cast<std::size_t>(i) * width_];
      const float* const weight = &weight_[static_cast<std::size_t>(i) * width_];
      const float* const at_view = &model_[static_cast<std::size_t>(i) * width_];
      // Close to a light whose photograph is not usable the residuals of others stand for it.
      float beside = 0;
      if (lights.lit[i] > 0 && usable_[i] < 1) {
        const float own = kBesideShare * usable_[i], others = 1 - kBesideShare, relit = relight(own + others * usable);
        for (int x = 0; x < half_; ++x)
          beside += weight[x] * srf::square(residual[x] - relit * (others * lit_row_[x] + own * residual[x]));
      }
      const float relit = visible * relight(usable);
      for (float& x : lit_row_) x *= relit;
      add(lit_row_, model_, i, visible);
      add(indirect_row_, model_, i, visible);
      const float hidden = 1 - visible, from_dark = hidden * relight(unlit);
      for (int x = 0; x < width_; ++x) dark_row_[x] = lit_row_[x] + from_dark * dark_row_[x];

      struct Sum {
        float plain = 0, lit = 0, indirect = 0, dark = 0;
      };
      const auto sum = [&](int begin) {
        Sum s;
        for (int x = 0; x < half_; ++x) {
          const float w = weight[begin + x], v = value[x];
          s.plain += w * (plain_row_[begin + x] - v) * (plain_row_[begin + x] - v);
          s.lit += w * (lit_row_[begin + x] - v) * (lit_row_[begin + x] - v);
          s.indirect += w * (indirect_row_[begin + x] - v) * (indirect_row_[begin + x] - v);
          s.dark += w * (dark_row_[begin + x] - v) * (dark_row_[begin + x] - v);
        }
        return s;
      };
      const Sum by_light = sum(0);
      float square = 0;
      for (int x = 0; x < half_; ++x) square += weight[x] * value[x] * value[x], value_sum_[x] += weight[x] * value[x];
      for (int begin = 0; begin < width_; begin += half_)
        for (int x = 0; x < half_; ++x) {
          const int at = begin + x;
          const float shown = visible * weight[at], off = hidden * weight[at];
          plain_sum_[at] += weight[at] * (plain_row_[at] - value[x]);
          lit_sum_[at] += shown * (lit_row_[at] - value[x]),
              indirect_sum_[at] += shown * (indirect_row_[at] - value[x]);
          hidden_sum_[at] += off * (lit_row_[at] - value[x]), dark_sum_[at] += off * (dark_row_[at] - value[x]);
        }
      error.square += square;
      const auto note = [&](HoldoutError::Case& to, const Sum& s) {
        to.plain += s.plain;
        to.in_light.lit += visible * s.lit, to.in_light.indirect += visible * s.indirect;
        to.in_shadow.lit += hidden * s.lit, to.in_shadow.indirect += hidden * s.dark;
      };
      error.by_light.push_back({list.ids[i], {}});
      HoldoutError::Cases& cases = error.by_light.back().second;
      note(cases.light, by_light);
      cases.beside.plain = kBesideError * by_light.plain;
      cases.beside.in_light.lit = beside;
      cases.beside.in_shadow.lit = (1 - lights.lit[i]) * square;
      if (!(visible > 0.5f) && (lights.cosine[i] < kSurelyAverted || lights.cosine[i] > 0)) {
        HoldoutError::Count& count = lights.cosine[i] > 0 ? error.hidden : error.averted;
        ++count.lights;
        count.for_indirect += by_light.dark < kMuchBetter * by_light.lit;
      }
      if (sources_.empty()) continue;
      note(cases.both, sum(half_));
      // Under the captured light itself the photographs' own shadows show.
      const float* const by_cosine = &slanted_[0][static_cast<std::size_t>(i) * half_];
      const float* const by_square = &slanted_[1][static_cast<std::size_t>(i) * half_];
      float plain = 0, guided = 0, slanted[2] = {};
      for (int x = 0; x < half_; ++x) {
        const float w = weight[half_ + x], from_others = value[half_ + x] - value[x], lit = lights.lit[i] * at_view[x];
        plain += w * from_others * from_others;
        guided += w * srf::square(lit + residual[half_ + x] - value[x]);
        slanted[0] += w * srf::square(lit + by_cosine[x] - value[x]);
        slanted[1] += w * srf::square(lit + by_square[x] - value[x]);
      }
      cases.view.plain = plain, cases.view.in_light.lit = guided;
      for (int way = 0; way < 2; ++way) error.view_slanted[way] += slanted[way];
    }
    for (int v = 0; v < static_cast<int>(views_.size()); ++v)
      if (const float w = views_[v]->cosine; w > 0)
        for (int x = kChannels * v; x < kChannels * v + 3; ++x) {
          const auto sum = [&](int at) {
            return HoldoutError::Case{plain_sum_[at] / w,
                                      {lit_sum_[at] / w, indirect_sum_[at] / w},
                                      {hidden_sum_[at] / w, dark_sum_[at] / w}};
          };
          error.sums.push_back({w, value_sum_[x] / w, sum(x), {}});
          if (!sources_.empty()) error.sums.back().both = sum(half_ + x);
        }
  }
  for (const auto& [id, cases] : error.by_light) error.all += cases;
  return error;
}

}  // namespace srf
