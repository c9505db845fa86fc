#include "model/normal_spread.h"

#include <gtest/gtest.h>

#include <cmath>
#include <random>

#include "base/numeric.h"

namespace srf {
namespace {

using Normal = Direction<AcquisitionSpace>;

double along(const SymmetricMatrix& m, const Vec3& a, const Vec3& b) {
  const auto [xx, xy, xz, yy, yz, zz] = m;
  return dot(a, Mat3{{Vec3{xx, xy, xz}, Vec3{xy, yy, yz}, Vec3{xz, yz, zz}}} * b);
}

TEST(NormalSpread, ACylinderTurnsRoundItsAxisAndNotAlongIt) {
  const double radius = 2;
  std::vector<Point<AcquisitionSpace>> points;
  std::vector<Normal> normals;
  for (int i = 0; i < 120; ++i)
    for (int j = 0; j < 30; ++j) {
      const double angle = i * kPi / 60;
      points.emplace_back(radius * std::cos(angle), radius * std::sin(angle), 0.1 * j);
      normals.push_back(Normal::fromUnit({std::cos(angle), std::sin(angle), 0}));
    }
  // A wall of its own within reach, that faces the other way, says nothing.
  const std::size_t count = points.size();
  for (std::size_t i = 0; i < count; ++i)
    points.push_back(points[i] - 0.1 * normals[i]), normals.push_back(-normals[i]);
  const auto turns = normalTurns(points, normals, 0.35);
  for (const std::size_t i : {15ul, 1005ul, 3015ul}) {
    const Vec3 round = cross({0, 0, 1}, normals[i].raw());
    EXPECT_NEAR(along(turns[i], round, round), 1 / radius, 0.02 / radius);
    EXPECT_NEAR(along(turns[i], {0, 0, 1}, {0, 0, 1}), 0, 1e-6);
    EXPECT_NEAR(along(turns[i], round, {0, 0, 1}), 0, 1e-6);
  }
  EXPECT_EQ(normalTurns({points[0]}, std::span(normals).first(1), 0.35)[0], SymmetricMatrix{});
}

TEST(NormalSpread, AslantAPixelSpreadsAsMuchMoreAsItIsLonger) {
  const SymmetricMatrix sphere = symmetricInPlane(0.5, 0, 0.5, {1, 0, 0}, {0, 1, 0});
  const auto seen = [&](const std::array<float, 3>& view) {
    return normalSpread(sphere, partSeen({0, 0, 1}, view, 0.04f));
  };
  const SymmetricMatrix facing = seen({0, 0, 1}), aslant = seen({0, 0.8f, 0.6f});
  EXPECT_NEAR(along(facing, {1, 0, 0}, {1, 0, 0}), 0.01, 1e-6);
  EXPECT_NEAR(along(facing, {0, 1, 0}, {0, 1, 0}), 0.01, 1e-6);
  EXPECT_NEAR(along(aslant, {1, 0, 0}, {1, 0, 0}), 0.01, 1e-6);
  EXPECT_NEAR(along(aslant, {0, 1, 0}, {0, 1, 0}), 0.01 / 0.36, 1e-6);
}

// The mean of many lobes about normals that spread, at its peak, where a highlight is told by.
TEST(NormalSpread, TheWiderLobeIsTheMeanOfThoseAboutTheNormals) {
  std::mt19937 random(3);
  std::normal_distribution<double> normal;
  PointReflectance point;
  point.alpha_x = 0.1f, point.alpha_y = 0.2f;
  const double sx = 0.04, sy = 0.03, turned = 0.6;
  const Vec3 u{std::cos(turned), std::sin(turned), 0}, v{-std::sin(turned), std::cos(turned), 0};
  const auto view = Normal::fromUnit({0, 0, 1});
  const auto peak = [&](const PointReflectance& of) { return modelTermsReference(of, view, view)[2]; };
  double sum = 0;
  const int count = 20000;
  for (int i = 0; i < count; ++i) {
    const Vec3 n = Vec3{0, 0, 1} + sx * normal(random) * u + sy * normal(random) * v;
    PointReflectance one = point;
    const Vec3 unit = n / length(n), t = Vec3{1, 0, 0} - dot(Vec3{1, 0, 0}, unit) * unit;
    for (int c = 0; c < 3; ++c)
      one.normal[c] = static_cast<float>(unit[c]), one.tangent[c] = static_cast<float>((t / length(t))[c]);
    sum += peak(one);
  }
  const PointReflectance seen = seenThrough(point, symmetricInPlane(sx * sx, 0, sy * sy, u, v));
  EXPECT_NEAR(peak(seen), sum / count, 0.06 * sum / count);
  EXPECT_GT(peak(point), 1.2 * sum / count);
  double upright = 0;
  for (int c = 0; c < 3; ++c) upright += seen.normal[c] * seen.tangent[c];
  EXPECT_NEAR(upright, 0, 1e-6);
}

TEST(NormalSpread, WhatReflectsEveryWayAlikeDoesNotGetWider) {
  PointReflectance point;
  point.alpha_x = point.alpha_y = 1;
  const PointReflectance seen = seenThrough(point, symmetricInPlane(0.3, 0.1, 0.1, {1, 0, 0}, {0, 1, 0}));
  EXPECT_EQ(seen.alpha_x, 1);
  EXPECT_EQ(seen.alpha_y, 1);
  // Nor any beyond that, however much the normals spread.
  point.alpha_x = 0.1f, point.alpha_y = 0.3f;
  const PointReflectance edge = seenThrough(point, symmetricInPlane(5, 2, 3, {1, 0, 0}, {0, 1, 0}));
  EXPECT_LE(std::max(edge.alpha_x, edge.alpha_y), 1);
  EXPECT_GE(std::min(edge.alpha_x, edge.alpha_y), 0.1f);
}

}  // namespace
}  // namespace srf
