#include "model/reflectance_fit.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <bit>
#include <functional>

#include "tests/support/glossy_sphere.h"
#include "tests/support/test_support.h"

namespace srf {
namespace {

constexpr int kLights = 128;

/// FittedPoint::indirect_shadow of a matt sphere, in the middle of its points, where a light behind the surface gives
/// `hidden` of its number, times the cosine it stands behind it (the same from all would be taken for the camera's
/// limit).
float indirectInShadow(const std::function<double(int light)>& hidden) {
  const test::TemporaryFolder folder;
  test::FormulaFieldOptions options;
  options.views = 8, options.lights = kLights, options.size = 32, options.subdivision = 3;
  const test::FormulaField field =
      test::makeSphereField(folder / "f.srf", options, [&](const Vec3& p, const Vec3& l, const Vec3&) {
        const double cosine = dot(p, l);
        if (cosine > 0) return 0.3 * cosine * Vec3{1, 1, 1};
        const int light = static_cast<int>((1 - l.z) / 2 * kLights);  // of the sphere of lights, from top to bottom
        return hidden(light) * -cosine * Vec3{1, 1, 1};
      });
  const auto fit = fitReflectance(field.folder, field.manifest, field.model, {}, Reporter::silent());
  if (!fit) return -1;
  std::vector<float> found;
  for (const FittedPoint& point : fit->points) found.push_back(point.indirect_shadow);
  std::nth_element(found.begin(), found.begin() + found.size() / 2, found.end());
  return found[found.size() / 2];
}

// None of the nearest lights of those that give something: each by itself is foretold best as dark. A sky has them all,
// and a quarter of its light would be lost.
TEST(ReflectanceFit, WhatManyHiddenLightsGiveTogetherIsNotTakenForShadow) {
  EXPECT_GT(indirectInShadow([](int light) { return light % 6 ? 0 : 0.8; }), 0.95);
}

TEST(ReflectanceFit, LittleLightOrThatOfFewHiddenLightsIsTakenForShadow) {
  EXPECT_LT(indirectInShadow([](int light) { return light % 6 ? 0 : 0.08; }), 0.05);
  // As much as above, by the blur of an outline.
  EXPECT_LT(indirectInShadow([](int light) { return light % 30 ? 0 : 4.0; }), 0.05);
}

// Few views and photographs that agree badly leave kf to chance; at a crease, seen at grazing angles, what is too much
// of it is a white speck.
TEST(ReflectanceFit, NothingReflectsFarMoreThanArrives) {
  const auto fitted = [](double scale) {
    const test::TemporaryFolder folder;
    test::FormulaFieldOptions options;
    options.views = 8, options.lights = 24, options.size = 32, options.subdivision = 3;
    const test::FormulaField field =
        test::makeSphereField(folder / "f.srf", options, [&](const Vec3& p, const Vec3& l, const Vec3& v) {
          const double disagreement = 0.5 * std::sin(97 * p.x + 61 * p.y + 53 * l.y + 43 * v.z);
          return scale * (1 + disagreement) * test::glossy(p, l, v);
        });
    float most = 0;
    const auto fit = fitReflectance(field.folder, field.manifest, field.model, {}, Reporter::silent());
    for (const FittedPoint& point : fit->points)
      for (const float kf : point.reflectance.coefficient[3]) most = std::max(most, kf);
    return most;
  };
  EXPECT_LE(fitted(1), 2);  // of that spread a point is believed
  // Photographs on a scale of their own: no more than their brightest points show.
  const float brighter = fitted(20);
  EXPECT_GT(brighter, 5);
  EXPECT_LT(brighter, 40);
}

// By the error with views left out: what photographs hold amiss the more, the more aslant they see the surface, is best
// taken from those that face it; what comes and goes with the view, from the nearest.
TEST(ReflectanceFit, SlantedViewsCountAsFarAsTheyForetellOthers) {
  const auto slant = [](const std::function<double(double slanted, const Vec3& v)>& lacking) {
    const test::TemporaryFolder folder;
    test::FormulaFieldOptions options;
    options.lights = 32, options.size = 32, options.subdivision = 3;
    const test::FormulaField field =
        test::makeSphereField(folder / "f.srf", options, [&](const Vec3& p, const Vec3& l, const Vec3& v) {
          return std::max(0.0, dot(p, l)) * (0.3 + lacking(1 - dot(p, v), v)) * Vec3{1, 1, 1};
        });
    const auto fit = fitReflectance(field.folder, field.manifest, field.model, {}, Reporter::silent());
    double sum = 0;
    for (const FittedPoint& point : fit->points) sum += double{point.slant};
    return sum / static_cast<double>(fit->points.size());
  };
  const double blurred =
                   slant([](double slanted, const Vec3&v) { return slanted * 0.3 * std::sin(40 * v.x + 30 * v.y); }),
               turning = slant([](double, const Vec3&v) { return 0.1 * v.x - 0.1 * v.y; });
  EXPECT_GT(blurred, 0.8);
  EXPECT_LT(turning, 0.3);
}

// Light that comes by way of other surfaces shows from all sides alike; the model takes it for a lobe, and foretells a
// view less well than other views do, but a light far better than other lights.
TEST(ReflectanceFit, LittleHarmFromViewsLeftOutClosesNoGate) {
  const auto gates = [](double indirect) {
    const test::TemporaryFolder folder;
    test::FormulaFieldOptions options;
    options.lights = 24, options.size = 32, options.subdivision = 3;
    const test::FormulaField field =
        test::makeSphereField(folder / "f.srf", options, [&](const Vec3& p, const Vec3& l, const Vec3& v) {
          const double cosine = std::max(0.0, dot(p, l));
          const double blur = 0.05 * std::sin(40 * v.x + 30 * v.y);
          return 0.2 * cosine * (1 + indirect * (1 - cosine)) * (1 + blur) * Vec3{1, 1, 1};
        });
    const auto fit = fitReflectance(field.folder, field.manifest, field.model, {}, Reporter::silent());
    double sum = 0;
    for (const FittedPoint& point : fit->points) sum += double{point.gate};
    return sum / static_cast<double>(fit->points.size());
  };
  EXPECT_GT(gates(0.2), 0.7);  // 0.37 where no harm is excused
  EXPECT_LT(gates(2), 0.05);
}

// 20 pixels to the radius. Were pixels taken for points, 0.162 and 0.153 would be found.
TEST(ReflectanceFit, ABendingSurfaceIsNotTakenForARougherOne) {
  const test::TemporaryFolder folder;
  test::FormulaFieldOptions options;
  options.views = 16, options.lights = 48, options.size = 48, options.samples = 3, options.subdivision = 4;
  const test::FormulaField field = test::makeSphereField(folder / "f.srf", options, test::glossy);
  const auto fit = fitReflectance(field.folder, field.manifest, field.model, {}, Reporter::silent());
  const PointReflectance& found = fit->points[0].reflectance;
  EXPECT_NEAR(found.alpha_x, 0.15, 0.05 * 0.15);
  EXPECT_EQ(found.alpha_x, found.alpha_y);
}

// One view under a few lights: by a dozen samples alone noise would close the gates of 15 of these points.
TEST(ReflectanceFit, ChanceClosesNoGateWhereSamplesAreFew) {
  const test::TemporaryFolder folder;
  test::FormulaFieldOptions options;
  options.views = 1, options.lights = 24, options.size = 48, options.subdivision = 4;
  const test::FormulaField field =
      test::makeSphereField(folder / "f.srf", options, [](const Vec3& p, const Vec3& l, const Vec3&) {
        const double noise = std::sin(911 * p.x + 613 * p.y + 487 * p.z + 1371 * l.x + 917 * l.y);
        return 0.3 * std::max(0.0, dot(p, l)) * (1 + noise) * Vec3{1, 1, 1};
      });
  const auto fit = fitReflectance(field.folder, field.manifest, field.model, {}, Reporter::silent());
  int seen = 0, shut = 0;
  for (const FittedPoint& point : fit->points) {
    if (!(point.reflectance.coefficient[0][0] > 0)) continue;
    ++seen, shut += point.gate < 0.5f;
  }
  EXPECT_GT(seen, 200);
  EXPECT_LE(shut, 5);
}

// A hull fills a bowl: through its lid each view sees another point of the bowl, which faces it. Of one light the model
// tells a little more than the lights about it do; of all together it is wrong, where plain interpolation is right.
TEST(ReflectanceFit, NothingGuidesWhereAHullIsNotTheObject) {
  const auto gates = [](const test::ReflectanceFormula& formula) {
    const test::TemporaryFolder folder;
    test::FormulaFieldOptions options;
    options.lights = 32, options.size = 32, options.subdivision = 3;
    test::FormulaField field = test::makeSphereField(folder / "f.srf", options, formula);
    field.model.shape = "hull";
    const auto fit = fitReflectance(field.folder, field.manifest, field.model, {}, Reporter::silent());
    double sum = 0;
    for (const FittedPoint& point : fit->points) sum += double{point.gate};
    return sum / static_cast<double>(fit->points.size());
  };
  const auto bowl = [](const Vec3& p, const Vec3& l, const Vec3& v) {
    const Vec3 to = v + 0.3 * p, n = to / length(to);
    // Under all lights at once the bowl is the same everywhere.
    const double direct = dot(p, l) > 0 ? std::max(0.0, dot(n, l)) * 2 / (1 + dot(n, p)) : 0;
    return (0.5 * direct + 0.05) * Vec3{1, 1, 1};
  };
  EXPECT_LT(gates(bowl), 0.1);  // 0.7 by lights and views left out one at a time
  EXPECT_GT(gates(test::glossy), 0.99);
}

// A sphere that some lights do not reach within `half_width` of a circle on it, units, though no ray is stopped there.
ReflectanceFit fitShadowedHull(double half_width) {
  const test::TemporaryFolder folder;
  test::FormulaFieldOptions options;
  options.lights = 32, options.size = 32, options.subdivision = 5;
  test::FormulaField field =
      test::makeSphereField(folder / "f.srf", options, [half_width](const Vec3& p, const Vec3& l, const Vec3&) {
        const bool shadowed = l.x > 0 && std::fabs(p.y) < half_width;
        return (shadowed ? 0 : 0.3 * std::max(0.0, dot(p, l))) * Vec3{1, 1, 1};
      });
  field.model.shape = "hull";
  return *fitReflectance(field.folder, field.manifest, field.model, {}, Reporter::silent());
}

std::size_t count(const std::vector<std::uint64_t>& words) {
  std::size_t bits = 0;
  for (const std::uint64_t word : words) bits += static_cast<std::size_t>(std::popcount(word));
  return bits;
}

std::size_t countOverruled(const ReflectanceFit& fit) {
  std::vector<std::uint64_t> differ = fit.lit.words();
  for (std::size_t w = 0; w < differ.size(); ++w) differ[w] ^= fit.lit_by_rays.words()[w];
  return count(differ);
}

// Along the outline of a shadow photographs and rays differ over a pixel or two, and guidance errs. Bend the object,
// and the shadow ends elsewhere: were photographs believed there, the old outline would shine through the new shadow.
TEST(ReflectanceFit, PhotographsOverruleRaysWhereAHullHidesTheObjectAndNotAlongOutlines) {
  const ReflectanceFit outline = fitShadowedHull(0.06), hidden = fitShadowedHull(0.3);  // a pixel: 0.074
  EXPECT_EQ(countOverruled(outline), 0u);
  EXPECT_EQ(count(outline.worse.words()), 0u);
  EXPECT_GT(countOverruled(hidden), 1500u);
  EXPECT_GT(count(hidden.worse.words()), 3000u);
}

}  // namespace
}  // namespace srf
