#include "model/reflectance_fit.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>
#include <random>

#include "base/numeric.h"
#include "base/parallel.h"
#include "base/quantile.h"
#include "model/captured_visibility.h"
#include "model/hull_correction.h"
#include "model/normal_spread.h"
#include "model/point_samples.h"
#include "model/points_around.h"
#include "model/sample_holdout.h"

namespace srf {
namespace {

constexpr std::size_t kChunk = 64;           // points
constexpr int kFewestLights = 8;             // of known direction
constexpr std::size_t kSearchPoints = 900;   // that tell the roughness
constexpr int kFewestSearchSamples = 24;     // lit ones, of such a point
constexpr std::size_t kTangentPoints = 150;  // of those, that tell whether it depends on the tangent
constexpr double kAnisotropyPays = 0.85;     // at most this share of the error is left
constexpr int kMostMaterials = 3;            // of roughness of their own
constexpr double kMaterialPays = 0.85;       // one more leaves at most this share of the error
constexpr float kMaterialsApart = 1.5f;      // ratio of their roughnesses at least
constexpr double kFewestWithLobe = 0.02;     // share of the points at which a lobe pays, for there to be one ...
constexpr double kLobePays = 0.98;           // ... that leaves at most this share of the error of all
constexpr double kFresnelShare = 0.95;       // of the points have no larger kf than the largest believed ...
constexpr float kFresnelSpread = 2;          // ... over this
constexpr double kBrightShare = 0.99;        // of the points are no brighter than a surface that reflects all it gets
// Under captured lights guidance may err more with a view left out than plain interpolation: by this share of plain's
// squared error at most, where that is small beside what it gains with a light left out too: at most this share of it.
constexpr double kLittleHarm = 0.5, kSmallBesideGain = 0.05;
// Of plain's squared error under one light, and of its mean over the lights: more than both together is harm.
constexpr double kHarm = 1.1, kSlack = 0.05;
constexpr int kDoubtedLights = 2;  // more in shadow, so that one alone tells little
// Of a point's light under all lights together: lost in shadow; and the lights that lose it, weighed by how much: a
// highlight or a lit surface that a pixel's blur carries into the shadow is under one to four.
constexpr double kLostLittle = 0.1, kLostMuch = 0.2;
constexpr double kFewLose = 5, kManyLose = 8;
constexpr double kSamplesThatTell = 12;  // whether guidance helps at a point
constexpr double kOffReach = 2;          // of aroundReach: where a hull is off, so is what lies around it
constexpr double kBumps = 8;             // of the positional error: a carved surface is bumpy over less
constexpr int kRounds = 3;               // of robust weights
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
    if (input.samples.views(i).empty()) continue;
    SearchPoint point{normals[i], {}};
    point.samples.load(input, i, normals[i]);
    if (point.samples.litSamples() >= kFewestSearchSamples) found.push_back(std::move(point));
  }
  return found;
}

constexpr int kTangents = 8;  // angles that are tried for the direction of brushing

// The tangent angle whose plain fit explains the samples best: the best of eight and the vertex of the parabola through
// it and its neighbours; `point` has the frame. Returns the error of the best of the eight.
double findTangent(PointSamples& samples, const Direction<AcquisitionSpace>& normal, PointReflectance& point) {
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
  return error[best];
}

// Of each point the share of its samples that the model leaves unexplained.
std::vector<double> searchErrors(std::span<SearchPoint> points, const Roughness& roughness) {
  std::vector<double> errors(points.size(), 0);
  parallelFor(points.size(), 8, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) {
      PointReflectance tried;
      tried.alpha_x = roughness.x, tried.alpha_y = roughness.y;
      if (roughness.x == roughness.y) {
        setFrame(tried, points[i].normal, 0);
        errors[i] = points[i].samples.fit(tried, 1);
      } else {
        errors[i] = findTangent(points[i].samples, points[i].normal, tried);
      }
    }
  });
  return errors;
}

double mean(const std::vector<double>& errors) {
  return std::accumulate(errors.begin(), errors.end(), 0.0) / static_cast<double>(errors.size());
}

Roughness clamped(double log_x, double log_y) {
  const auto alpha = [](double log) { return std::clamp(static_cast<float>(std::exp(log)), kLeastAlpha, kMostAlpha); };
  return {alpha(log_x), alpha(log_y)};
}

struct RoughnessSearch {
  Roughness best;
  double error = std::numeric_limits<double>::infinity();  ///< mean over the points
  struct Tried {
    Roughness roughness;
    std::vector<double> errors;  ///< of the points
  };
  std::vector<Tried> tried;

  /// Whether it is the best so far.
  bool consider(std::span<SearchPoint> points, const Roughness& roughness, Reporter& reporter) {
    tried.push_back({roughness, searchErrors(points, roughness)});
    const double e = mean(tried.back().errors);
    reporter.debug("fit: alpha " + std::to_string(roughness.x) + " " + std::to_string(roughness.y) + ": " +
                   std::to_string(e));
    if (!(e < error)) return false;
    error = e, best = roughness;
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

/// Roughnesses of which each point has the one that explains it best.
struct Materials {
  std::vector<Roughness> roughness;
  double error = 0;            ///< mean over the points
  std::vector<double> errors;  ///< of the points
};

// The best `count` of the tried roughnesses together.
Materials bestTogether(const RoughnessSearch& search, int count) {
  const int candidates = static_cast<int>(search.tried.size());
  Materials best;
  best.error = std::numeric_limits<double>::infinity();
  std::vector<int> chosen(count);
  std::iota(chosen.begin(), chosen.end(), 0);
  const auto apart = [&] {
    for (int k = 0; k < count; ++k)
      for (int j = 0; j < k; ++j) {
        const float a = search.tried[chosen[k]].roughness.x, b = search.tried[chosen[j]].roughness.x;
        if (!(std::max(a, b) > kMaterialsApart * std::min(a, b))) return false;
      }
    return true;
  };
  while (true) {
    std::vector<double> errors = search.tried[chosen[0]].errors;
    for (int k = 1; k < count; ++k)
      for (std::size_t i = 0; i < errors.size(); ++i)
        errors[i] = std::min(errors[i], search.tried[chosen[k]].errors[i]);
    const double e = mean(errors);
    if (e < best.error && apart()) {
      best = {{}, e, std::move(errors)};
      for (const int k : chosen) best.roughness.push_back(search.tried[k].roughness);
    }
    int last = count - 1;  // the next combination
    while (last >= 0 && chosen[last] == candidates - count + last) --last;
    if (last < 0) return best;
    ++chosen[last];
    for (int k = last + 1; k < count; ++k) chosen[k] = chosen[k - 1] + 1;
  }
}

// As many materials as pay: points are told apart by the roughness that explains each best.
Materials findMaterials(const RoughnessSearch& search) {
  Materials found = bestTogether(search, 1);
  for (int count = 2; count <= kMostMaterials; ++count) {
    Materials more = bestTogether(search, count);
    if (!(more.error < kMaterialPays * found.error)) break;
    found = std::move(more);
  }
  return found;
}

// The roughness of `materials` that explains the point best, and its tangent; leaves them in `point`.
void chooseMaterial(const std::vector<Roughness>& materials, PointSamples& samples,
                    const Direction<AcquisitionSpace>& normal, PointReflectance& point) {
  setFrame(point, normal, 0);
  point.alpha_x = materials[0].x, point.alpha_y = materials[0].y;
  double least = std::numeric_limits<double>::infinity();
  for (const Roughness& roughness : materials) {
    if (materials.size() == 1 && roughness.x == roughness.y) break;
    PointReflectance tried = point;
    tried.alpha_x = roughness.x, tried.alpha_y = roughness.y;
    double error;
    if (roughness.x != roughness.y) {
      error = findTangent(samples, normal, tried);
    } else {
      setFrame(tried, normal, 0);
      error = samples.fit(tried, 1);
    }
    if (error < least) least = error, point = tried;
  }
}

// What the object's points together say of its lobe.
struct Lobe {
  bool pays = true;  // at more points than chance has it, and for all together
  float most_fresnel = std::numeric_limits<float>::infinity();  // kf that is believed of a point
};

// A point's own samples seldom come near grazing angles, so its kf alone may be anything. Most points' is believed, up
// to what reflects all that arrives: 1, or what the brightest points reflect where photographs are on a scale of their
// own. A lobe that pays at few points, or at more but hardly for all together, is one of shadow outlines and bent
// normals: over the mouth of a matt bowl, closed by its hull, it was a near mirror of 0.19 of the points that left
// 0.996 of the error; glossy objects keep 0.02 to 0.55.
Lobe findLobe(std::span<SearchPoint> points, const std::vector<Roughness>& materials) {
  std::vector<float> fresnel(points.size(), -1), matt(points.size());
  std::vector<double> with(points.size()), without(points.size());
  parallelFor(points.size(), 8, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) {
      PointReflectance fitted;
      chooseMaterial(materials, points[i].samples, points[i].normal, fitted);
      without[i] = points[i].samples.fit(fitted, 1, false);
      with[i] = points[i].samples.fit(fitted, kRounds);
      const auto most = [&](int term) {
        return *std::max_element(fitted.coefficient[term].begin(), fitted.coefficient[term].end());
      };
      if (most(2) > 0 || most(3) > 0) fresnel[i] = most(3);
      matt[i] = most(0) + most(1);
    }
  });
  std::erase_if(fresnel, [](float kf) { return kf < 0; });
  Lobe lobe;
  lobe.pays = static_cast<double>(fresnel.size()) > kFewestWithLobe * static_cast<double>(points.size()) &&
              mean(with) < kLobePays * mean(without);
  if (!lobe.pays) return lobe;
  const float all = std::max(1.f, quantile(matt, kBrightShare)), believed = quantile(fresnel, kFresnelShare);
  lobe.most_fresnel = kFresnelSpread * (believed > 0 ? std::min(believed, all) : all);
  return lobe;
}

// Normals and lit bits of a hull by the photographs.
void correctHull(const FitInput& input, const std::vector<Roughness>& materials,
                 std::vector<Direction<AcquisitionSpace>>& normals, CapturedVisibility& visibility,
                 Reporter& reporter) {
  Reporter::Stage stage(reporter, "fit: normals", normals.size());
  VisibilityBits lit = visibility.lit;
  parallelFor(normals.size(), kChunk, [&](std::size_t begin, std::size_t end) {
    PointSamples point;
    for (std::size_t i = begin; i < end; ++i) {
      point.load(input, i, normals[i]);
      if (point.litSamples() < kFewestSearchSamples) continue;
      PointReflectance fitted;
      chooseMaterial(materials, point, normals[i], fitted);
      // The angle about the normal from which setFrame starts again for each normal that is tried.
      const Vec3 u = anyPerpendicular(normals[i]).raw();
      const Vec3 t{fitted.tangent[0], fitted.tangent[1], fitted.tangent[2]};
      const double tangent = std::atan2(dot(t, cross(normals[i].raw(), u)), dot(t, u));
      normals[i] = photometricNormal(point, normals[i], fitted, tangent);
      point.load(input, i, normals[i]);
      chooseMaterial(materials, point, normals[i], fitted);
      point.fit(fitted, kRounds);
      correctLit(input, point, fitted, i, lit);
    }
    stage.advance(end - begin);
  });
  visibility.lit = std::move(lit);
  agreeAlongOutlines(input, visibility);
  litAroundFromNeighbours(input, visibility);
}

/// Squares of a point's errors and samples, weighted.
struct PointError {
  struct Ways {
    double plain = 0, guided = 0;
    Ways& operator+=(const Ways& other) {
      plain += other.plain, guided += other.guided;
      return *this;
    }
  };
  Ways light, both, view;  ///< left out
  Ways sum;                ///< of the sum over the lights, one view left out
  double square = 0;
  int samples = 0;  ///< lit ones
};

// The error with the residuals that the point takes: squared, or of a sum.
double guidedError(const HoldoutError::Case& e, const FittedPoint& point) {
  return lerp(e.in_light.lit, e.in_light.indirect, double{point.indirect}) +
         lerp(e.in_shadow.lit, e.in_shadow.indirect, double{point.indirect_shadow});
}

// Never worse than plain: 1 where guidance helps by 10 %, or by as much as `open` says, 0 where it harms by 5 %.
double gateOf(double guided, double plain, double open = 0.9) {
  constexpr double kShut = 1.05;
  if (!(plain > 0)) return guided > 0 ? 0.0 : 1.0;
  return smoothstep(0, 1, (kShut - guided / plain) / (kShut - open));
}

// At a point of few samples chance tells more than they do: it is judged together with as many samples as suffice that
// err as the object's points do in the mean.
void openGates(std::span<const PointError> errors, std::vector<FittedPoint>& fitted) {
  PointError all;
  for (const PointError& e : errors) {
    all.light += e.light, all.both += e.both, all.view += e.view;
    all.square += e.square;
  }
  if (!(all.square > 0)) return;
  for (std::size_t i = 0; i < errors.size(); ++i) {
    const PointError& e = errors[i];
    if (e.samples == 0) continue;
    const double others = kSamplesThatTell / e.samples * e.square / all.square;
    const double excused =
        std::min(kLittleHarm * e.view.plain, kSmallBesideGain * std::max(0.0, e.both.plain - e.both.guided));
    const auto gate = [&](const PointError::Ways& own, const PointError::Ways& of_all, double open) {
      return gateOf(std::sqrt(own.guided + others * of_all.guided), std::sqrt(own.plain + others * of_all.plain), open);
    };
    const PointError::Ways view{e.view.plain + excused, e.view.guided};
    // Under a captured light, where both return the photographs of a matt surface, open where it does not harm.
    fitted[i].gate = static_cast<float>(
        std::min({gate(e.light, all.light, 0.9), gate(e.both, all.both, 0.9), gate(view, all.view, 1)}));
  }
}

// Where a hull lies off the object each view's photographs are of another point of it. A model fitted to all of them
// may still foretell a light a little better than its neighbours do, and is then wrong to the same side under all: a
// sky adds that up. So what guidance gains under one light it must not lose under all at once, from a view that is left
// out; together with the points around, since a hull is off over more than a point, while chance is not.
void closeOffTheObject(const std::vector<Point<AcquisitionSpace>>& points, double reach,
                       std::span<const PointError> errors, std::vector<FittedPoint>& fitted) {
  const PointsAround around(points, reach);
  parallelFor(points.size(), kChunk, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) {
      PointError sum;
      around(i, [&](std::uint32_t j) { sum.light += errors[j].light, sum.sum += errors[j].sum; });
      const double guided = std::sqrt(sum.light.guided * sum.sum.guided),
                   plain = std::sqrt(sum.light.plain * sum.sum.plain);
      fitted[i].gate = std::min(fitted[i].gate, static_cast<float>(gateOf(guided, plain)));
    }
  });
}

// Whether the residual of all lights is clearly the better one, where both leave a squared error: 1 at `enough` less.
double muchLess(double indirect, double lit, double enough) {
  return lit > 0 ? smoothstep(0, enough, 1 - std::sqrt(indirect / lit)) : 0;
}

// How far the residual of unlit lights is needed in shadow for the sum over many lights to hold: the little that each
// of many gives indirectly, which outlines under a few hide in the errors of lights one by one.
double neededForSum(const HoldoutError& error) {
  double value = 0, lit = 0, indirect = 0;
  for (const HoldoutError::Sum& sum : error.sums) {
    value += sum.weight * square(sum.value);
    lit += sum.weight * square(sum.light.in_shadow.lit);
    indirect += sum.weight * square(sum.light.in_shadow.indirect);
  }
  if (!(lit > 0 && value > 0)) return 0;
  return smoothstep(kLostLittle, kLostMuch, std::sqrt(lit / value)) *
         smoothstep(kFewLose, kManyLose, lit / error.all.light.in_shadow.lit) * muchLess(indirect, lit, 0.5);
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
  const double reach = aroundReach(field, model);
  const double even = std::max(reach, kBumps * model.positional_error);
  std::vector<SymmetricMatrix> turns = normalTurns(model.p0, normals, even);
  const FitInput input{field, model, lists, samples, visibility, turns};
  const bool is_hull = model.shape == "hull";

  std::vector<Roughness> materials{Roughness()};
  Lobe lobe;
  if (std::vector<SearchPoint> points = searchPoints(input, normals); points.empty()) {
    reporter.info("reflectance model: no point has " + std::to_string(kFewestSearchSamples) +
                  " lit samples, which a lobe would need; Lambert's law guides alone");
  } else {
    Reporter::Stage stage(reporter, "fit: roughness", 2);
    RoughnessSearch isotropic = searchIsotropic(points, reporter);
    if (is_hull) {  // bent normals look like roughness
      PointReflectance known;
      known.alpha_x = known.alpha_y = isotropic.best.x;
      parallelFor(points.size(), 8, [&](std::size_t begin, std::size_t end) {
        for (std::size_t i = begin; i < end; ++i)
          points[i].normal = photometricNormal(points[i].samples, points[i].normal, known, 0);
      });
      isotropic = searchIsotropic(points, reporter);
    }
    const Materials found = findMaterials(isotropic);
    materials = found.roughness;
    stage.advance();
    // Two roughnesses explain a little more of anything: taken where it is much.
    const std::span few(points.data(), std::min(points.size(), kTangentPoints));
    const RoughnessSearch anisotropic = searchAnisotropic(few, isotropic.best.x, reporter);
    const double before = mean({found.errors.begin(), found.errors.begin() + static_cast<std::ptrdiff_t>(few.size())});
    if (anisotropic.error < kAnisotropyPays * before) materials = {anisotropic.best};
    lobe = findLobe(points, materials);
    if (!lobe.pays) reporter.info("reflectance model: the object is matt; Lambert's law guides alone");
    stage.advance();
  }

  ReflectanceFit fit;
  if (is_hull) {
    correctHull(input, materials, normals, visibility, reporter);
    turns = normalTurns(model.p0, normals, even);
  }
  fit.points.resize(model.size());
  fit.worse = VisibilityBits(model.size(), field.lights.size());
  std::vector<PointError> errors(model.size());
  {
    Reporter::Stage stage(reporter, "fit: coefficients", model.size());
    parallelFor(model.size(), kChunk, [&](std::size_t begin, std::size_t end) {
      PointSamples point;
      SampleHoldout hold_out;
      std::array<std::vector<float>, 3> values;
      for (std::size_t i = begin; i < end; ++i) {
        FittedPoint& fitted = fit.points[i];
        setFrame(fitted.reflectance, normals[i], 0);
        fitted.turn = turns[i];
        fitted.reflectance.alpha_x = materials[0].x, fitted.reflectance.alpha_y = materials[0].y;
        point.load(input, i, normals[i]);
        if (point.litSamples() == 0) continue;
        chooseMaterial(materials, point, normals[i], fitted.reflectance);
        point.fit(fitted.reflectance, kRounds, lobe.pays);
        for (float& kf : fitted.reflectance.coefficient[3]) kf = std::min(kf, lobe.most_fresnel);
        point.evaluate(fitted.reflectance, values);
        const HoldoutError e = hold_out(input, point, values);
        // The residual of all lights only where it is clearly the better one.
        const auto all_lights = [](const HoldoutError::Part& part) { return muchLess(part.indirect, part.lit, 0.1); };
        fitted.indirect = static_cast<float>(all_lights(e.all.light.in_light));
        // Indirect light is in most shadows of one kind, those that fall on the point or the surface's own; what is in
        // a few is the outline of a shadow that a pixel has blurred.
        const auto share = [](const HoldoutError::Count& count) {
          return count.for_indirect / static_cast<double>(count.lights + kDoubtedLights);
        };
        const double by_lights =
            all_lights(e.all.light.in_shadow) * smoothstep(0.2, 0.4, std::max(share(e.hidden), share(e.averted)));
        fitted.indirect_shadow = static_cast<float>(std::max(by_lights, neededForSum(e)));
        const double by_root = std::sqrt(e.all.view.in_light.lit), by_cosine = std::sqrt(e.view_slanted[0]),
                     by_square = std::sqrt(e.view_slanted[1]);
        fitted.slant = static_cast<float>(
            0.5 * (gateOf(by_cosine, by_root, 1) + gateOf(by_square, by_cosine, 1) * gateOf(by_square, by_root, 1)));
        const double lights_asked = std::max<double>(1, e.by_light.size());
        const auto harmed = [&](const HoldoutError::Case& one, const HoldoutError::Case& all) {
          return guidedError(one, fitted) > kHarm * one.plain + kSlack * all.plain / lights_asked;
        };
        for (const auto& [light, cases] : e.by_light)
          if (is_hull && (harmed(cases.light, e.all.light) || harmed(cases.both, e.all.both) ||
                          harmed(cases.view, e.all.view) || harmed(cases.beside, e.all.beside)))
            fit.worse.set(i, light.value);
        const auto ways = [&](const HoldoutError::Case& of) {
          return PointError::Ways{of.plain, guidedError(of, fitted)};
        };
        errors[i] = {ways(e.all.light), ways(e.all.both), ways(e.all.view), {}, e.square, point.litSamples()};
        for (const HoldoutError::Sum& sum : e.sums) {
          errors[i].sum.plain += sum.weight * square(sum.both.plain);
          errors[i].sum.guided += sum.weight * square(guidedError(sum.both, fitted));
        }
      }
      stage.advance(end - begin);
    });
  }
  if (is_hull) dropOutlines(field, model, fit.worse);
  openGates(errors, fit.points);
  if (is_hull && reach > 0) closeOffTheObject(model.p0, kOffReach * reach, errors, fit.points);
  double plain = 0, guided = 0, square = 0;
  for (std::size_t i = 0; i < errors.size(); ++i) {
    plain += errors[i].light.plain, square += errors[i].square;
    guided += lerp(errors[i].light.plain, errors[i].light.guided, double{fit.points[i].gate});
  }
  if (square > 0) fit.error_plain = std::sqrt(plain / square), fit.error_guided = std::sqrt(guided / square);
  fit.lit = std::move(visibility.lit);
  fit.lit_by_rays = std::move(visibility.lit_by_rays);
  fit.lit_around = std::move(visibility.lit_around);
  fit.seen_around = std::move(visibility.seen_around);
  reporter.figure("fit.error_plain", fit.error_plain);
  reporter.figure("fit.error_guided", fit.error_guided);
  reporter.figure("fit.alpha_x", materials[0].x);
  reporter.figure("fit.alpha_y", materials[0].y);
  reporter.figure("fit.materials", static_cast<double>(materials.size()));
  return fit;
}

}  // namespace srf
