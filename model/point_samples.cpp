#include "model/point_samples.h"

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <cstring>

#include "base/half.h"
#include "base/numeric.h"
#include "field/bilinear_fetch.h"

namespace srf {
namespace {

constexpr float kLeastLightCosine = 0.05f;  // n.l of a sample that is fitted to
constexpr int kFewestSamples = 12;          // lit ones, for more than a Lambert term
constexpr double kWorstCondition = 1e4;     // of the normal equations with columns of length 1
constexpr unsigned kLambert = 1, kNoLobe = 3, kAll = (1u << kModelTerms) - 1;  // of the coefficients
// A lobe stays where at most this share of the error without it is left: on a matt surface it would fit chance, and
// narrow ones flare between the samples.
constexpr double kLobePays = 0.95;
// A sample next to an outline of shadow or occlusion may hold a pixel of the other side.
constexpr float kOutlineShare = 0.05f;

using Float8 = float __attribute__((vector_size(32)));

Float8 eight(const float* from) {
  Float8 v;
  std::memcpy(&v, from, sizeof v);
  return v;
}
void put(const Float8& v, float* to) {
  std::memcpy(to, &v, sizeof v);
}
double sum(const Float8& v) {
  double s = 0;
  for (int i = 0; i < 8; ++i) s += v[i];
  return s;
}

// The sums of all samples, eight side by side: floats are enough for a few thousand samples.
struct Sums {
  std::array<NormalEquations<kModelTerms>, 3> equations;
  double square = 0;  // of the values
};
Sums sums(const std::array<std::vector<float>, kModelTerms>& terms, const std::array<std::vector<float>, 3>& values,
          const std::vector<float>& weights) {
  Float8 matrix[10] = {}, right[3][kModelTerms] = {}, square = {};
  const int count = static_cast<int>(weights.size());
  for (int i = 0; i < count; i += 8) {
    const Float8 w = eight(&weights[i]);
    Float8 t[kModelTerms];
    for (int k = 0; k < kModelTerms; ++k) t[k] = eight(&terms[k][i]);
    int at = 0;
    for (int k = 0; k < kModelTerms; ++k) {
      const Float8 wt = w * t[k];
      for (int j = 0; j <= k; ++j) matrix[at++] += wt * t[j];
    }
  }
  for (int i = 0; i < count; i += 8) {
    const Float8 w = eight(&weights[i]);
    Float8 t[kModelTerms];
    for (int k = 0; k < kModelTerms; ++k) t[k] = eight(&terms[k][i]);
    for (int c = 0; c < 3; ++c) {
      const Float8 s = eight(&values[c][i]), ws = w * s;
      square += ws * s;
      for (int k = 0; k < kModelTerms; ++k) right[c][k] += ws * t[k];
    }
  }
  Sums result;
  result.square = sum(square);
  int at = 0;
  for (int k = 0; k < kModelTerms; ++k)
    for (int j = 0; j <= k; ++j, ++at)
      for (auto& e : result.equations) e.matrix[k][j] = e.matrix[j][k] = sum(matrix[at]);
  for (int c = 0; c < 3; ++c)
    for (int k = 0; k < kModelTerms; ++k) result.equations[c].right[k] = sum(right[c][k]);
  return result;
}

// Whether the samples tell the terms apart. Terms that are 0 everywhere do not count.
bool wellConditioned(const NormalEquations<kModelTerms>& e) {
  Eigen::Matrix4d m = Eigen::Matrix4d::Identity();
  for (int k = 0; k < kModelTerms; ++k)
    for (int j = 0; j < kModelTerms; ++j)
      if (k != j && e.matrix[k][k] > 0 && e.matrix[j][j] > 0)
        m(k, j) = e.matrix[k][j] / std::sqrt(e.matrix[k][k] * e.matrix[j][j]);
  const auto values = Eigen::SelfAdjointEigenSolver<Eigen::Matrix4d>(m, Eigen::EigenvaluesOnly).eigenvalues();
  return values[0] * kWorstCondition >= values[kModelTerms - 1];
}

// The best of the `usable` coefficients; returns the error over the square of the samples.
double solve(const Sums& s, unsigned usable, PointReflectance& point) {
  double error = s.square;
  for (int c = 0; c < 3; ++c) {
    const NormalEquations<kModelTerms>& e = s.equations[c];
    const auto x = nonnegativeLeastSquares(e, usable);
    for (int k = 0; k < kModelTerms; ++k) {
      point.coefficient[k][c] = static_cast<float>(x[k]);
      error -= 2 * x[k] * e.right[k];
      for (int j = 0; j < kModelTerms; ++j) error += x[k] * x[j] * e.matrix[k][j];
    }
  }
  return s.square > 0 ? std::max(error, 0.0) / s.square : 0;
}

}  // namespace

void setFrame(PointReflectance& point, const Direction<AcquisitionSpace>& normal, double angle) {
  const Vec3 u = anyPerpendicular(normal).raw(), t = std::cos(angle) * u + std::sin(angle) * cross(normal.raw(), u);
  for (int c = 0; c < 3; ++c) {
    point.normal[c] = static_cast<float>(normal.raw()[c]);
    point.tangent[c] = static_cast<float>(t[c]);
  }
}

LightLists::LightLists(const SrfManifest& field) {
  for (const StoredView& view : field.views) {
    const auto same = std::find_if(lists.begin(), lists.end(), [&](const List& l) { return l.ids == view.lights; });
    of_view.push_back(static_cast<std::uint32_t>(same - lists.begin()));
    if (same != lists.end()) continue;
    List list;
    list.ids = view.lights;
    const auto light = [&](std::uint32_t k) -> const CaptureLight& { return field.lights[list.ids[k].value]; };
    std::vector<std::uint32_t> known;
    for (std::uint32_t k = 0; k < list.ids.size(); ++k) {
      if (light(k).kind != LightKind::captured) known.push_back(k);
      list.distant = list.distant && light(k).kind != LightKind::point;
    }
    if (list.distant) list.others.resize(list.ids.size());
    for (const std::uint32_t k : list.distant ? known : std::vector<std::uint32_t>()) {
      std::vector<std::pair<double, std::uint32_t>> order;
      for (const std::uint32_t other : known) {
        const Vec3 chord = light(k).direction.raw() - light(other).direction.raw();
        if (other != k) order.emplace_back(dot(chord, chord), other);
      }
      std::sort(order.begin(), order.end());
      order.resize(std::min(order.size(), LightLists::List::kOthers));
      for (const auto& [chord, other] : order) list.others[k].push_back(other);
    }
    lists.push_back(std::move(list));
  }
}

void PointSamples::load(const FitInput& input, std::size_t i, const Direction<AcquisitionSpace>& normal) {
  const Point<AcquisitionSpace>& p = input.model.p0[i];
  const std::array<float, 3> n = floats(normal.raw());
  views_.clear();
  std::size_t used = 0;  // of lights_, whose memory stays
  samples_ = 0;
  for (const FitSamples::PointView& at : input.samples.views(i)) {
    const std::uint32_t list = input.lists.of_view[at.view];
    std::size_t which = 0;
    while (which < used && lights_[which].list != list) ++which;
    if (which == used) {
      if (used == lights_.size()) lights_.emplace_back();
      Lights& l = lights_[used++];
      l.list = list;
      const std::vector<LightId>& ids = input.lists.lists[list].ids;
      l.count = static_cast<int>(ids.size());
      l.pad = (l.count + 7) / 8 * 8;
      for (std::vector<float>* row :
           {&l.x, &l.y, &l.z, &l.cosine, &l.lit, &l.by_ray, &l.around, &l.inverse[0], &l.inverse[1], &l.inverse[2]})
        row->assign(l.pad, 0.f);
      for (int k = 0; k < l.count; ++k) {
        const CaptureLight& light = input.field.lights[ids[k].value];
        if (light.kind == LightKind::captured) continue;
        const Direction<AcquisitionSpace> direction = light.directionFrom(p);
        l.x[k] = static_cast<float>(direction.raw().x);
        l.y[k] = static_cast<float>(direction.raw().y);
        l.z[k] = static_cast<float>(direction.raw().z);
        l.cosine[k] = static_cast<float>(dot(normal, direction));
        l.lit[k] = l.cosine[k] > 0 && input.visibility.lit.get(i, ids[k].value);
        l.by_ray[k] = l.cosine[k] > 0 && input.visibility.lit_by_rays.get(i, ids[k].value);
        l.around[k] = l.lit[k] > 0 && input.visibility.lit_around.get(i, ids[k].value);
        const Vec3 irradiance = light.irradianceAt(p);
        for (int c = 0; c < 3; ++c) l.inverse[c][k] = irradiance[c] > 0 ? static_cast<float>(1 / irradiance[c]) : 0.f;
      }
    }
    View view;
    view.view = at.view;
    const Camera<AcquisitionSpace>& camera = input.field.views[at.view].camera;
    const Direction<AcquisitionSpace> direction = camera.viewDirection(p);
    view.direction = floats(direction.raw());
    view.cosine = static_cast<float>(dot(normal, direction));
    if (const auto seen = camera.project(p)) {
      const double variance =
          betweenTexelsVariance(texelAndPart(seen->pixel.x - 0.5).part, texelAndPart(seen->pixel.y - 0.5).part) *
          square(camera.pixelFootprint(seen->depth));
      view.spread = normalSpread(input.turns[i], partSeen(n, view.direction, static_cast<float>(variance)));
    }
    view.lights = static_cast<std::uint32_t>(which);
    view.first = samples_;
    view.around = input.visibility.seen_around.get(i, at.view);
    views_.push_back(view);
    samples_ += lights_[which].pad;
  }
  lights_.resize(used);

  const float saturation = static_cast<float>(std::min(input.samples.saturation(), 1e30));
  for (auto& row : values_) row.resize(samples_);
  usable_.assign(samples_, 1.f);
  std::size_t at = 0;
  for (const FitSamples::PointView& from : input.samples.views(i)) {
    const View& view = views_[at++];
    const Lights& l = lights_[view.lights];
    for (int c = 0; c < 3; ++c) {
      float* row = &values_[c][view.first];
      floatsFromHalves(input.samples.values(from) + c * l.pad, row, l.pad);
      for (int k = 0; k < l.pad; ++k) {
        if (row[k] >= saturation) usable_[view.first + k] = 0;
        row[k] *= l.inverse[c][k];
      }
    }
    for (int k = l.count; k < l.pad; ++k) usable_[view.first + k] = 0;
  }
  setWeights();
}

// Relative errors count, of dim samples those relative to the point's own brightness; what a slanted view sees is
// spread over few pixels.
void PointSamples::setWeights() {
  weights_.assign(samples_, 0.f);
  lit_samples_ = 0;
  double square = 0;
  for (const View& view : views_) {
    const Lights& l = lights_[view.lights];
    for (int k = 0; k < l.count; ++k) {
      const int s = view.first + k;
      if (!(l.lit[k] > 0 && l.cosine[k] > kLeastLightCosine && usable_[s] > 0)) continue;
      const float value = (values_[0][s] + values_[1][s] + values_[2][s]) / 3;
      weights_[s] = 1;
      square += double{value} * value;
      ++lit_samples_;
    }
  }
  const float rms = lit_samples_ > 0 ? static_cast<float>(std::sqrt(square / lit_samples_)) : 0.f;
  for (const View& view : views_) {
    const Lights& l = lights_[view.lights];
    for (int k = 0; k < l.pad; ++k) {
      const int s = view.first + k;
      const float scale = (values_[0][s] + values_[1][s] + values_[2][s]) / 6 + rms / 2;
      const float outline = l.around[k] > 0 && view.around ? 1.f : kOutlineShare;
      weights_[s] =
          weights_[s] > 0 && scale > 0 ? std::max(view.cosine, 0.f) * outline / (scale * std::sqrt(scale)) : 0.f;
    }
  }
}

void PointSamples::terms(const PointReflectance& point) {
  for (auto& row : terms_) row.resize(samples_);
  for (const View& view : views_) {
    const Lights& l = lights_[view.lights];
    modelTerms(seenThrough(point, view.spread), view.direction, {l.x.data(), l.y.data(), l.z.data(), l.count},
               {&terms_[0][view.first], &terms_[1][view.first], &terms_[2][view.first], &terms_[3][view.first]});
  }
}

double PointSamples::fit(PointReflectance& point, int rounds, bool lobe) {
  point.coefficient = {};
  if (lit_samples_ == 0) return 0;
  terms(point);
  const auto told_apart = [this](const Sums& s) {
    return lit_samples_ >= kFewestSamples && wellConditioned(s.equations[0]);
  };
  const Sums plain = sums(terms_, values_, weights_);
  unsigned usable = !told_apart(plain) ? kLambert : lobe ? kAll : kNoLobe;
  const double error = solve(plain, usable, point);
  if (rounds > 1 && usable == kAll) {
    PointReflectance matt = point;
    const double without = solve(plain, kNoLobe, matt);
    if (!(error < kLobePays * without)) usable = kNoLobe, point = matt;
  }
  for (int round = 1; round < rounds; ++round) {
    error_.resize(samples_), robust_.resize(samples_);
    for (int s = 0; s < samples_; s += 8) {
      Float8 t[kModelTerms], e = {};
      for (int k = 0; k < kModelTerms; ++k) t[k] = eight(&terms_[k][s]);
      for (int c = 0; c < 3; ++c) {
        Float8 model = {};
        for (int k = 0; k < kModelTerms; ++k) model += point.coefficient[k][c] * t[k];
        const Float8 off = eight(&values_[c][s]) - model;
        e += off < 0 ? -off : off;
      }
      put(e / 3, &error_[s]);
    }
    double total = 0;
    for (int s = 0; s < samples_; ++s) total += weights_[s] > 0 ? error_[s] : 0.f;
    const float mean = static_cast<float>(total / lit_samples_);
    for (int s = 0; s < samples_; s += 8) {
      const Float8 value = (eight(&values_[0][s]) + eight(&values_[1][s]) + eight(&values_[2][s])) / 3;
      const Float8 scale = 2.5f * mean + 0.1f * value;
      const Float8 ratio = scale > 0 ? eight(&error_[s]) / scale : Float8{};
      put(eight(&weights_[s]) / (1 + ratio * ratio), &robust_[s]);
    }
    const Sums robust = sums(terms_, values_, robust_);
    solve(robust, told_apart(robust) ? usable : kLambert, point);
  }
  return error;
}

void PointSamples::evaluate(const PointReflectance& point, std::array<std::vector<float>, 3>& model) const {
  for (int c = 0; c < 3; ++c) {
    model[c].resize(samples_);
    for (int s = 0; s < samples_; ++s) {
      float value = 0;
      for (int k = 0; k < kModelTerms; ++k) value += point.coefficient[k][c] * terms_[k][s];
      model[c][s] = value;
    }
  }
}

}  // namespace srf
