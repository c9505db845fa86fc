#include "model/hull_correction.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <functional>

#include "base/numeric.h"
#include "base/parallel.h"
#include "model/points_around.h"

namespace srf {
namespace {

const double kFarthest = radians(41);  // from the hull's normal
constexpr double kPays = 0.97;         // at most this share of the error is left
constexpr float kLeastCosine = 0.08f;  // n.l of a light that photographs can show to be lit
constexpr int kFewestVotes = 3;
constexpr float kLitShare = 0.5f;    // of the model's value: darker is shadow
constexpr float kTelling = 0.1f;     // of the samples' rms: dimmer model values tell nothing
constexpr std::size_t kChunk = 256;  // points

}  // namespace

Direction<AcquisitionSpace> photometricNormal(PointSamples& samples, const Direction<AcquisitionSpace>& start,
                                              PointReflectance point, double tangent_angle) {
  const auto error = [&](const Direction<AcquisitionSpace>& n) {
    if (angleBetween(n, start) > kFarthest) return std::numeric_limits<double>::infinity();
    setFrame(point, n, tangent_angle);
    return samples.fit(point, 1);
  };
  const double before = error(start);
  Direction<AcquisitionSpace> best = start;
  double least = before;
  // The vertex of a paraboloid through five tilts, ever closer.
  for (const double step : {0.2, 0.08, 0.03}) {
    const Direction<AcquisitionSpace> middle = best, u = anyPerpendicular(middle);
    const Vector<AcquisitionSpace> v = cross(middle, u);
    const auto tilted = [&](double a, double b) {
      return *normalize(Vector<AcquisitionSpace>(middle) + std::tan(a) * Vector<AcquisitionSpace>(u) + std::tan(b) * v);
    };
    const double centre = least;
    const auto consider = [&](double a, double b) {
      const Direction<AcquisitionSpace> n = tilted(a, b);
      const double e = error(n);
      if (e < least) least = e, best = n;
      return e;
    };
    const auto vertex = [&](double minus, double plus) {
      const double bend = minus + plus - 2 * centre;
      return bend > 0 && std::isfinite(bend) ? std::clamp(0.5 * (minus - plus) / bend, -2.0, 2.0) * step : 0.0;
    };
    const double a = vertex(consider(-step, 0), consider(step, 0)), b = vertex(consider(0, -step), consider(0, step));
    if (a != 0 || b != 0) consider(a, b);
  }
  return least < kPays * before ? best : start;
}

void correctLit(const FitInput& input, const PointSamples& samples, const PointReflectance& point, std::size_t i,
                VisibilityBits& lit) {
  std::array<std::vector<float>, 3> model;
  samples.evaluate(point, model);
  const auto mean = [](const std::array<std::vector<float>, 3>& rows, int s) {
    return (rows[0][s] + rows[1][s] + rows[2][s]) / 3;
  };
  double square = 0;
  std::size_t count = 0;
  for (const PointSamples::View& view : samples.views())
    for (int k = 0; k < samples.lights()[view.lights].count; ++k, ++count)
      square += srf::square(mean(samples.values(), view.first + k));
  const float telling =
      kTelling * static_cast<float>(std::sqrt(square / static_cast<double>(std::max<std::size_t>(count, 1))));
  for (std::uint32_t l = 0; l < samples.lights().size(); ++l) {
    const PointSamples::Lights& lights = samples.lights()[l];
    for (int k = 0; k < lights.count; ++k) {
      if (!(lights.cosine[k] > kLeastCosine)) continue;
      int votes = 0, bright = 0;
      for (const PointSamples::View& view : samples.views()) {
        const int s = view.first + k;
        if (view.lights != l || !(samples.usable()[s] > 0) || !(mean(model, s) > telling)) continue;
        ++votes;
        bright += mean(samples.values(), s) > kLitShare * mean(model, s);
      }
      if (votes < kFewestVotes) continue;
      const std::size_t column = input.lists.lists[lights.list].ids[k].value;
      if (2 * bright > votes)
        lit.set(i, column);
      else
        lit.words()[i * lit.wordsPerPoint() + column / 64] &= ~(std::uint64_t{1} << (column % 64));
    }
  }
}

void dropOutlines(const SrfManifest& field, const DeformableModel& model, VisibilityBits& bits) {
  const double reach = aroundReach(field, model);
  if (!(reach > 0)) return;
  const PointsAround around(model.p0, reach);
  const std::size_t words = bits.wordsPerPoint();
  const auto step = [&](const auto& combine) {
    const VisibilityBits before = bits;
    parallelFor(model.size(), kChunk, [&](std::size_t begin, std::size_t end) {
      for (std::size_t i = begin; i < end; ++i) {
        std::uint64_t* row = &bits.words()[i * words];
        around(i, [&](std::uint32_t j) {
          for (std::size_t w = 0; w < words; ++w) row[w] = combine(row[w], before.row(j)[w]);
        });
      }
    });
  };
  step(std::bit_and<>());
  step(std::bit_or<>());
}

void agreeAlongOutlines(const FitInput& input, CapturedVisibility& visibility) {
  const std::vector<std::uint64_t>& lit = visibility.lit.words();
  VisibilityBits differ = visibility.lit_by_rays;
  std::transform(lit.begin(), lit.end(), differ.words().begin(), differ.words().begin(), std::bit_xor<>());
  dropOutlines(input.field, input.model, differ);
  std::transform(lit.begin(), lit.end(), differ.words().begin(), visibility.lit_by_rays.words().begin(),
                 std::bit_xor<>());
}

void litAroundFromNeighbours(const FitInput& input, CapturedVisibility& visibility) {
  const std::vector<Point<AcquisitionSpace>>& points = input.model.p0;
  const double reach = aroundReach(input.field, input.model);
  if (!(reach > 0)) return;
  const PointsAround around(points, reach);
  visibility.lit_around = visibility.lit;
  const std::size_t words = visibility.lit.wordsPerPoint();
  parallelFor(points.size(), kChunk, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) {
      std::uint64_t* lit = &visibility.lit_around.words()[i * words];
      around(i, [&](std::uint32_t j) {
        for (std::size_t w = 0; w < words; ++w) lit[w] &= visibility.lit.row(j)[w];
      });
    }
  });
}

}  // namespace srf
