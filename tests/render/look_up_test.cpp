#include "render/look_up.h"

#include <gtest/gtest.h>

#include <cmath>
#include <random>

#include "base/numeric.h"
#include "tests/support/hard_case.h"

namespace srf {
namespace {

SurfaceHit hitWith(const Mat3& r0, const Mat3& jacobian) {
  SurfaceHit hit;
  hit.count = 1;
  hit.p0 = Point<AcquisitionSpace>(1, 2, 3);
  hit.acquisition_from_tangent = Orthogonal<AcquisitionSpace, TangentSpace>(r0);
  hit.tangents.u = Vector<ObjectSpace>(jacobian * r0.column(0));
  hit.tangents.v = Vector<ObjectSpace>(jacobian * r0.column(1));
  hit.tangents.handedness = determinant(jacobian) < 0 ? -1 : 1;
  return hit;
}

Mat3 randomRotation(std::mt19937& random) {
  std::normal_distribution<double> normal;
  return rotationFromQuaternion({normal(random), normal(random), normal(random), normal(random)});
}

void expectNear(const Mat3& a, const Mat3& b, double bound) {
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) EXPECT_NEAR(a.row[i][j], b.row[i][j], bound);
}

TEST(LookUp, ARigidMotionIsUndoneExactly) {
  std::mt19937 random(1);
  for (const FrameMode mode : {FrameMode::bisector, FrameMode::polar})
    for (int trial = 0; trial < 200; ++trial) {
      const Mat3 motion = randomRotation(random);
      const LookUp look_up = lookUp(hitWith(randomRotation(random), motion), mode);
      expectNear(look_up.acquisition_from_object.raw(), motion.transposed(), 1e-12);
      EXPECT_EQ(look_up.p.raw(), (Vec3{1, 2, 3}));
      EXPECT_FALSE(look_up.collapsed);
    }
}

TEST(LookUp, OfManyHitsIsThatOfEach) {
  std::mt19937 random(4);
  std::normal_distribution<double> normal;
  std::vector<SurfaceHit> hits;
  std::vector<std::size_t> which;
  for (std::size_t i = 0; i < 200; ++i) {
    Mat3 jacobian{{Vec3{normal(random), normal(random), normal(random)},
                   Vec3{normal(random), normal(random), normal(random)},
                   Vec3{normal(random), normal(random), normal(random)}}};
    if (i % 10 == 3) jacobian = 1e-140 * jacobian;
    if (i % 10 == 7) jacobian = 0.0 * jacobian;
    hits.push_back(hitWith(randomRotation(random), jacobian));
    if (i % 3 != 1) which.push_back(i);
  }
  for (const FrameMode mode : {FrameMode::bisector, FrameMode::polar}) {
    std::vector<LookUp> many(which.size());
    lookUp(hits, which, mode, many);
    for (std::size_t i = 0; i < which.size(); ++i) {
      const LookUp one = lookUp(hits[which[i]], mode);
      EXPECT_EQ(many[i].acquisition_from_object.raw(), one.acquisition_from_object.raw()) << i;
      EXPECT_EQ(many[i].p.raw(), one.p.raw());
      EXPECT_EQ(many[i].normal.raw(), one.normal.raw());
      EXPECT_EQ(many[i].collapsed, one.collapsed);
    }
  }
}

TEST(LookUp, AMirrorIsUndoneByAReflection) {
  std::mt19937 random(2);
  for (const FrameMode mode : {FrameMode::bisector, FrameMode::polar})
    for (int trial = 0; trial < 200; ++trial) {
      const Mat3 mirror = randomRotation(random) * Mat3{{Vec3{-1, 0, 0}, Vec3{0, 1, 0}, Vec3{0, 0, 1}}};
      const LookUp look_up = lookUp(hitWith(randomRotation(random), mirror), mode);
      expectNear(look_up.acquisition_from_object.raw(), mirror.transposed(), 1e-12);
      EXPECT_NEAR(determinant(look_up.acquisition_from_object), -1, 1e-12);
    }
}

TEST(LookUp, AnglesToTheNormalAreKeptUnderAnyDeformation) {
  std::mt19937 random(3);
  std::normal_distribution<double> normal;
  test::Largest off;
  for (int trial = 0; trial < test::sized(500, 100000); ++trial) {
    Mat3 jacobian;
    for (auto& row : jacobian.row) row = {normal(random), normal(random), normal(random)};
    const SurfaceHit hit = hitWith(randomRotation(random), jacobian);
    const LookUp look_up = lookUp(hit, FrameMode::bisector);
    // The outward normal of the deformed surface: the tangents' cross product, turned where the deformation mirrors.
    const auto n = *normalize(hit.tangents.handedness * cross(hit.tangents.u, hit.tangents.v));
    const auto direction = *normalize(Vector<ObjectSpace>(normal(random), normal(random), normal(random)));
    off.add(std::fabs(dot(look_up.acquisition_from_object * direction, look_up.normal) - dot(direction, n)));
    EXPECT_NEAR(length(Vector<AcquisitionSpace>(look_up.acquisition_from_object * direction)), 1, 1e-12);
  }
  test::recordHardCase(6, "any Jacobian: cosine to the normal before and after the look-up differs by", off.value,
                       test::atMost(1e-9));
}

TEST(LookUp, CollapsedTangentsAreFlaggedAndFinite) {
  SurfaceHit hit = hitWith(Mat3{}, Mat3{});
  for (const auto& [u, v] : {std::pair{Vec3{1, 0, 0}, Vec3{2, 0, 0}}, {Vec3{}, Vec3{0, 1, 0}}, {Vec3{}, Vec3{}}}) {
    hit.tangents.u = Vector<ObjectSpace>(u);
    hit.tangents.v = Vector<ObjectSpace>(v);
    const LookUp look_up = lookUp(hit, FrameMode::bisector);
    EXPECT_TRUE(look_up.collapsed);
    for (const Vec3& row : look_up.acquisition_from_object.raw().row) EXPECT_TRUE(isFinite(row));
    EXPECT_NEAR(std::fabs(determinant(look_up.acquisition_from_object)), 1, 1e-9);
  }
}

}  // namespace
}  // namespace srf
