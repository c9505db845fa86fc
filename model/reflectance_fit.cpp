#include "model/reflectance_fit.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>
#include <random>

#include "base/numeric.h"
#include "base/parallel.h"
#include "model/captured_visibility.h"
#include "model/hull_correction.h"
#include "model/light_holdout.h"
#include "model/point_samples.h"

namespace srf {
namespace {

constexpr std::size_t kChunk = 64;           // points
constexpr int kFewestLights = 8;             // of known direction
constexpr std::size_t kSearchPoints = 900;   // that tell the roughness
constexpr int kFewestSearchSamples = 24;     // lit ones, of such a point
constexpr std::size_t kTangentPoints = 150;  // of those, that tell whether it depends on the tangent
constexpr double kAnisotropyPays = 0.85;     // at most this share of the error is left
constexpr int kRounds = 3;                   // of robust weights
constexpr float kLeastAlpha = 0.02f, kMostAlpha = 1.f;

struct Roughness {
  float x = 0.3f, y = 0.3f;
  friend bool operator==(const Roughness&, const Roughness&) = default;
};

// Points whose samples tell the roughness, held in memory.
struct SearchPoint {
  Direction<AcquisitionSpace> normal;
  PointSamples samples;
};

std::vector<SearchPoint> searchPoints(const FitInput& input, std::span<const Direction<AcquisitionSpace>> normals) {
  std::vector<std::uint32_t> order(input.model.size());
  std::iota(order.begin(), order.end(), 0u);
  std::mt19937_64 random(1);
  std::vector<SearchPoint> found;
  for (std::size_t tried = 0; tried < order.size() && found.size() < kSearchPoints; ++tried) {
    std::swap(order[tried], order[tried + random() % (order.size() - tried)]);
    const std::uint32_t i = order[tried];
    if (input.samples.views(i).size() < 1) continue;
    SearchPoint point{normals[i], {}};
    point.samples.load(input, i, normals[i]);
    if (point.samples.litSamples() >= kFewestSearchSamples) found.push_back(std::move(point));
  }
  return found;
}

constexpr int kTangents = 8;  // angles that are tried for the direction of brushing

// The tangent angle whose plain fit explains the samples best: the best of eight and the vertex of the parabola through
// it and its neighbours; `point` has the frame.
struct Tangent {
  double angle, error;
};
Tangent findTangent(PointSamples& samples, const Direction<AcquisitionSpace>& normal, PointReflectance& point) {
  std::array<double, kTangents> error;
  for (int k = 0; k < kTangents; ++k) {
    setFrame(point, normal, k * kPi / kTangents);
    error[k] = samples.fit(point, 1);
  }
  const int best = static_cast<int>(std::min_element(error.begin(), error.end()) - error.begin());
  const double before = error[(best + kTangents - 1) % kTangents], after = error[(best + 1) % kTangents];
  const double bend = before + after - 2 * error[best];
  const double shift = bend > 0 ? std::clamp(0.5 * (before - after) / bend, -0.5, 0.5) : 0;
  const double angle = (best + shift) * kPi / kTangents;
  setFrame(point, normal, angle);
  return {angle, error[best]};
}

// Mean over the points of the share of the samples that the model leaves unexplained.
double searchError(std::span<SearchPoint> points, const Roughness& roughness) {
  std::vector<double> errors(points.size(), 0);
  parallelFor(points.size(), 8, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) {
      PointReflectance tried;
      tried.alpha_x = roughness.x, tried.alpha_y = roughness.y;
      if (roughness.x == roughness.y) {
        setFrame(tried, points[i].normal, 0);
        errors[i] = points[i].samples.fit(tried, 1);
      } else {
        errors[i] = findTangent(points[i].samples, points[i].normal, tried).error;
      }
    }
  });
  return std::accumulate(errors.begin(), errors.end(), 0.0) / static_cast<double>(errors.size());
}

Roughness clamped(double log_x, double log_y) {
  const auto alpha = [](double log) { return std::clamp(static_cast<float>(std::exp(log)), kLeastAlpha, kMostAlpha); };
  return {alpha(log_x), alpha(log_y)};
}

struct RoughnessSearch {
  Roughness best;
  double error = std::numeric_limits<double>::infinity();

  /// Whether it is the best so far.
  bool consider(std::span<SearchPoint> points, const Roughness& tried, Reporter& reporter) {
    const double e = searchError(points, tried);
    reporter.debug("fit: alpha " + std::to_string(tried.x) + " " + std::to_string(tried.y) + ": " + std::to_string(e));
    if (!(e < error)) return false;
    error = e, best = tried;
    return true;
  }
};

// One roughness for all tangents: eight values, then the better of two around the best, ever closer.
RoughnessSearch searchIsotropic(std::span<SearchPoint> points, Reporter& reporter) {
  constexpr int kValues = 8, kRefinements = 4;
  const double first = std::log(0.04), last = std::log(0.8);
  RoughnessSearch search;
  double step = (last - first) / (kValues - 1);
  for (int k = 0; k < kValues; ++k) search.consider(points, clamped(first + k * step, first + k * step), reporter);
  for (int k = 0; k < kRefinements; ++k) {
    step /= 2;
    const double middle = std::log(search.best.x);
    for (const double at : {middle - step, middle + step}) search.consider(points, clamped(at, at), reporter);
  }
  return search;
}

// Two: a coarse grid about the one found for all tangents, then steps along each, ever shorter.
RoughnessSearch searchAnisotropic(std::span<SearchPoint> points, float alpha, Reporter& reporter) {
  constexpr int kRefinements = 4;
  RoughnessSearch search;
  const double middle = std::log(alpha);
  for (const double x : {-1.6, -0.9, -0.3})
    for (const double y : {0.3, 0.9, 1.6}) search.consider(points, clamped(middle + x, middle + y), reporter);
  double step = 0.35;
  for (int k = 0; k < kRefinements; ++k, step /= 2)
    for (int moves = 0; moves < 4; ++moves) {
      const double x = std::log(search.best.x), y = std::log(search.best.y);
      bool better = false;
      for (const auto& [dx, dy] : {std::pair{-step, 0.0}, {step, 0.0}, {0.0, -step}, {0.0, step}})
        better = search.consider(points, clamped(x + dx, y + dy), reporter) || better;
      if (!better) break;
    }
  return search;
}

// Normals and lit bits of a hull by the photographs.
void correctHull(const FitInput& input, const Roughness& roughness, std::vector<Direction<AcquisitionSpace>>& normals,
                 CapturedVisibility& visibility, Reporter& reporter) {
  Reporter::Stage stage(reporter, "fit: normals", normals.size());
  VisibilityBits lit = visibility.lit;
  parallelFor(normals.size(), kChunk, [&](std::size_t begin, std::size_t end) {
    PointSamples point;
    for (std::size_t i = begin; i < end; ++i) {
      point.load(input, i, normals[i]);
      if (point.litSamples() < kFewestSearchSamples) continue;
      PointReflectance fitted;
      fitted.alpha_x = roughness.x, fitted.alpha_y = roughness.y;
      const bool brushed = roughness.x != roughness.y;
      const double tangent = brushed ? findTangent(point, normals[i], fitted).angle : 0;
      normals[i] = photometricNormal(point, normals[i], fitted, tangent);
      point.load(input, i, normals[i]);
      if (brushed)
        findTangent(point, normals[i], fitted);
      else
        setFrame(fitted, normals[i], 0);
      point.fit(fitted, kRounds);
      correctLit(input, point, fitted, i, lit);
    }
    stage.advance(end - begin);
  });
  visibility.lit = std::move(lit);
  litAroundFromNeighbours(input, visibility);
}

}  // namespace

std::optional<ReflectanceFit> fitReflectance(const std::filesystem::path& srf_folder, const SrfManifest& field,
                                             const DeformableModel& model, const FitOptions& options,
                                             Reporter& reporter) {
  const auto known = std::count_if(field.lights.begin(), field.lights.end(),
                                   [](const CaptureLight& light) { return light.kind != LightKind::captured; });
  if (known < kFewestLights) {
    reporter.info("no reflectance model: " + std::to_string(known) + " lights of known direction, " +
                  std::to_string(kFewestLights) + " are needed; interpolation stays plain");
    return std::nullopt;
  }
  std::vector<Direction<AcquisitionSpace>> normals;
  for (const Vec3& r0 : model.r0)
    normals.push_back(Direction<AcquisitionSpace>::fromUnit(rotationFromRodrigues(r0).raw().column(2)));

  const FitSamples samples(srf_folder, field, model, normals, {options.memory_bytes, options.most_views}, reporter);
  CapturedVisibility visibility = castCapturedVisibility(field, model, normals, reporter);
  const LightLists lists(field);
  const FitInput input{field, model, lists, samples, visibility};
  const bool is_hull = model.shape == "hull";

  Roughness roughness;
  {
    std::vector<SearchPoint> points = searchPoints(input, normals);
    if (points.empty()) {
      reporter.info("no reflectance model: no point has samples enough; interpolation stays plain");
      return std::nullopt;
    }
    Reporter::Stage stage(reporter, "fit: roughness", 2);
    roughness = searchIsotropic(points, reporter).best;
    if (is_hull) {  // bent normals look like roughness
      PointReflectance known;
      known.alpha_x = known.alpha_y = roughness.x;
      parallelFor(points.size(), 8, [&](std::size_t begin, std::size_t end) {
        for (std::size_t i = begin; i < end; ++i)
          points[i].normal = photometricNormal(points[i].samples, points[i].normal, known, 0);
      });
      roughness = searchIsotropic(points, reporter).best;
    }
    stage.advance();
    // Two roughnesses explain a little more of anything: taken where it is much.
    const std::span few(points.data(), std::min(points.size(), kTangentPoints));
    const RoughnessSearch anisotropic = searchAnisotropic(few, roughness.x, reporter);
    if (anisotropic.error < kAnisotropyPays * searchError(few, roughness)) roughness = anisotropic.best;
    stage.advance();
  }

  ReflectanceFit fit;
  fit.lit_by_rays = visibility.lit;
  if (is_hull) correctHull(input, roughness, normals, visibility, reporter);
  fit.points.resize(model.size());
  std::vector<HoldoutError> errors(model.size());
  {
    Reporter::Stage stage(reporter, "fit: coefficients", model.size());
    parallelFor(model.size(), kChunk, [&](std::size_t begin, std::size_t end) {
      PointSamples point;
      LightHoldout hold_out;
      std::array<std::vector<float>, 3> values;
      for (std::size_t i = begin; i < end; ++i) {
        FittedPoint& fitted = fit.points[i];
        setFrame(fitted.reflectance, normals[i], 0);
        fitted.reflectance.alpha_x = roughness.x, fitted.reflectance.alpha_y = roughness.y;
        point.load(input, i, normals[i]);
        if (point.litSamples() == 0) continue;
        if (roughness.x != roughness.y) findTangent(point, normals[i], fitted.reflectance);
        point.fit(fitted.reflectance, kRounds);
        point.evaluate(fitted.reflectance, values);
        HoldoutError& e = errors[i] = hold_out(input, point, values);
        const double plain = std::sqrt(e.plain), lit = std::sqrt(e.lit), indirect = std::sqrt(e.indirect);
        // The residual of all lights only where it is clearly the better one.
        fitted.indirect = lit > 0 ? static_cast<float>(smoothstep(0, 0.1, 1 - indirect / lit)) : 0.f;
        const double guided = lerp(lit, indirect, fitted.indirect);
        // Never worse than plain: 1 where guidance helps by 10 %, 0 where it harms by 5 %.
        fitted.gate = plain > 0 ? static_cast<float>(smoothstep(0, 1, (1.05 * plain - guided) / (0.15 * plain))) : 0.f;
      }
      stage.advance(end - begin);
    });
  }
  double plain = 0, guided = 0, square = 0;
  for (std::size_t i = 0; i < model.size(); ++i) {
    const double g = fit.points[i].gate, indirect = fit.points[i].indirect;
    plain += errors[i].plain;
    guided += lerp(errors[i].plain, lerp(errors[i].lit, errors[i].indirect, indirect), g);
    square += errors[i].square;
  }
  if (square > 0) fit.error_plain = std::sqrt(plain / square), fit.error_guided = std::sqrt(guided / square);
  fit.lit = std::move(visibility.lit);
  fit.lit_around = std::move(visibility.lit_around);
  fit.seen_around = std::move(visibility.seen_around);
  reporter.figure("fit.error_plain", fit.error_plain);
  reporter.figure("fit.error_guided", fit.error_guided);
  reporter.figure("fit.alpha_x", roughness.x);
  reporter.figure("fit.alpha_y", roughness.y);
  return fit;
}

}  // namespace srf
