#include "model/local_frame.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <random>

#include "base/numeric.h"
#include "tests/support/hard_case.h"

namespace srf {
namespace {

using Frame = Orthogonal<AcquisitionSpace, TangentSpace>;
constexpr FrameMode kModes[] = {FrameMode::bisector, FrameMode::polar};

struct Random {
  std::mt19937_64 engine{20251122};
  double uniform(double lo, double hi) { return lo + (hi - lo) * (static_cast<double>(engine() >> 11) * 0x1p-53); }
  double gauss() { return std::sqrt(-2 * std::log(uniform(1e-300, 1))) * std::cos(uniform(0, 2 * kPi)); }
  Vec3 vec() { return {gauss(), gauss(), gauss()}; }
  Vec3 unit() {
    const Vec3 a = vec();
    return a / length(a);
  }
  Mat3 rotation() { return rotationAbout(unit(), uniform(-kPi, kPi)); }
};

double distanceOf(const Mat3& a, const Mat3& b) {
  double most = 0;
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) most = std::fmax(most, std::fabs(a.row[i][j] - b.row[i][j]));
  return most;
}
bool finite(const Mat3& m) {
  return isFinite(m.row[0]) && isFinite(m.row[1]) && isFinite(m.row[2]);
}
// Angle of the rotation between two frames.
double turnBetween(const Mat3& a, const Mat3& b) {
  const Mat3 d = a * b.transposed();
  const Vec3 axis{d.row[2].y - d.row[1].z, d.row[0].z - d.row[2].x, d.row[1].x - d.row[0].y};
  return std::atan2(length(axis), d.row[0].x + d.row[1].y + d.row[2].z - 1);
}
Tangents<ObjectSpace> tangents(const Vec3& u, const Vec3& v, int handedness = 1) {
  return {Vector<ObjectSpace>(u), Vector<ObjectSpace>(v), handedness};
}
// L of Eq. 10 for a point whose rest frame is R0 and that a linear map carries.
Mat3 lookUpOf(const Mat3& r0, const Mat3& map, FrameMode mode) {
  const int side = determinant(map) < 0 ? -1 : 1;
  const auto frame = deformedFrame(tangents(map * r0.column(0), map * r0.column(1), side), mode);
  EXPECT_FALSE(frame.collapsed);
  return r0 * frame.tangent_from_space.raw();
}
void expectOrthonormal(const Mat3& m, int handedness) {
  EXPECT_LE(distanceOf(m * m.transposed(), Mat3{}), 1e-14);
  EXPECT_NEAR(determinant(m), handedness, 1e-14);
}

TEST(Rodrigues, RoundTripsEveryRotation) {
  Random random;
  test::Largest at_half_turns;
  for (int i = 0; i < test::sized(10000, 1000000); ++i) {
    // Every magnitude of angle, up to the half turn itself.
    const double angle = i % 2 ? random.uniform(0, kPi) : kPi - std::pow(10, random.uniform(-16, 0));
    const Mat3 r = rotationAbout(random.unit(), angle);
    const Vec3 r0 = rodriguesFromRotation(Frame(r));
    ASSERT_TRUE(isFinite(r0));
    const Mat3 back = rotationFromRodrigues(r0).raw();
    // The guard turns half turns by at most 2e-6 rad; elsewhere rounding alone is left.
    if (angle < kPi - 1e-5)
      EXPECT_LE(turnBetween(back, r), 1e-14);
    else
      at_half_turns.add(turnBetween(back, r));
    expectOrthonormal(back, 1);
  }
  test::recordHardCase(7, "R0 from r0 within 1e-16 to 1e-5 of a half turn: turned by, radians", at_half_turns.value,
                       test::atMost(2e-6));
}

TEST(Rodrigues, NormalFacingMinusZRoundTrips) {
  test::Largest turned;
  for (const double tilt : {0.0, 1e-8, -1e-8, 1e-16, -1e-16, 1e-4})
    for (const Vec3& axis : {Vec3{1, 0, 0}, Vec3{0, 1, 0}}) {
      const auto n = normalize(Vector<AcquisitionSpace>(Vec3{0, 0, -1} + tilt * axis));
      const Frame frame = restFrame(*n);
      const Vec3 r0 = rodriguesFromRotation(frame);
      ASSERT_TRUE(isFinite(r0)) << tilt;
      turned.add(turnBetween(rotationFromRodrigues(r0).raw(), frame.raw()));
    }
  test::recordHardCase(7, "n0 = -z and tilted from it by 1e-16 to 1e-4: R0 from r0 turned by, radians", turned.value,
                       test::atMost(2e-6));
}

TEST(Rodrigues, LongVectorsStayFinite) {
  for (const double size : {0.0, 1e-300, 1e-8, 1.0, 1e8, 1e19, 1e200, 1.7e308}) {
    const Mat3 r = rotationFromRodrigues({size, -size, 0.5 * size}).raw();
    ASSERT_TRUE(finite(r)) << size;
    expectOrthonormal(r, 1);
  }
}

TEST(RestFrame, HoldsTheNormalAndTheTangentAskedFor) {
  Random random;
  for (int i = 0; i < 1000; ++i) {
    const auto n = Direction<AcquisitionSpace>::fromUnit(random.unit());
    const auto t = Direction<AcquisitionSpace>::fromUnit(random.unit());
    const Mat3 frame = restFrame(n, t).raw();
    expectOrthonormal(frame, 1);
    EXPECT_LE(length(frame.column(2) - n.raw()), 1e-15);
    EXPECT_NEAR(dot(frame.column(1), t.raw()), 0, 1e-14);  // v0 is across the tangent, u0 holds what lies in the plane
    EXPECT_GT(dot(frame.column(0), t.raw()), 0);
    // A tangent along the normal says nothing.
    expectOrthonormal(restFrame(n, n).raw(), 1);
    expectOrthonormal(restFrame(n, -n).raw(), 1);
  }
}

TEST(DeformedFrame, RigidMotionIsGivenBackExactly) {
  Random random;
  for (const FrameMode mode : kModes)
    for (int i = 0; i < 1000; ++i) {
      const Mat3 r0 = random.rotation(), motion = random.rotation();
      // L is the inverse of the motion.
      EXPECT_LE(distanceOf(lookUpOf(r0, motion, mode), motion.transposed()), 1e-12);
    }
}

TEST(DeformedFrame, UniformScaleChangesNothing) {
  Random random;
  test::Largest difference;
  for (const FrameMode mode : kModes)
    for (const double scale : {1e-300, 1e-150, 1e-6, 1e6, 1e150, 1e300}) {
      const Mat3 r0 = random.rotation();
      difference.add(distanceOf(lookUpOf(r0, scale * Mat3{}, mode), Mat3{}));
    }
  test::recordHardCase(4, "L under scales of 1e-300 to 1e300: difference from the identity", difference.value,
                       test::atMost(1e-12));
}

TEST(DeformedFrame, BisectorMinimisesTheSummedSquaredAngles) {
  Random random;
  test::Largest difference;
  for (int i = 0; i < test::sized(300, 10000); ++i) {
    const Vec3 u = std::pow(10, random.uniform(-8, 8)) * random.vec(), v = random.vec();
    const auto found = deformedFrame(tangents(u, v), FrameMode::bisector);
    ASSERT_FALSE(found.collapsed);
    const Vec3 n = cross(u / length(u), v), n_bar = n / length(n);
    const Vec3 e1 = u / length(u), e2 = cross(n_bar, e1);
    const Vec3 v_hat = v / length(v);
    const auto squared_angles = [&](double phi) {
      const Vec3 a = std::cos(phi) * e1 + std::sin(phi) * e2, b = cross(n_bar, a);
      return square(angleBetweenUnit(a, e1)) + square(angleBetweenUnit(b, v_hat));
    };
    double best = 0;
    for (int k = 0; k < 400; ++k) {
      const double phi = 2 * kPi * k / 400;
      if (squared_angles(phi) < squared_angles(best)) best = phi;
    }
    // Between the kinks the sum is a parabola: its lowest point through three places is exact to rounding. The kinks
    // lie where u-bar = u or v-bar = v, so the three are taken half a tooth beside them, inside the stretch of the
    // minimum.
    const double middle = 0.5 * (std::atan2(dot(v_hat, e2), dot(v_hat, e1)) - kPi / 2);
    const double h = 0.5 * std::fabs(middle);
    ASSERT_NEAR(std::remainder(best - middle, 2 * kPi), 0, 2 * kPi / 400);
    const double low = squared_angles(middle - h), at = squared_angles(middle), high = squared_angles(middle + h);
    const double phi = middle - 0.5 * h * (high - low) / (high - 2 * at + low);
    const Vec3 brute = std::cos(phi) * e1 + std::sin(phi) * e2;
    difference.add(length(found.tangent_from_space.raw().row[0] - brute));
  }
  test::recordHardCase(6, "u-bar of the bisector against the brute-force minimiser of the squared angles",
                       difference.value, test::atMost(1e-10));
}

TEST(DeformedFrame, SkewIsSplitEvenly) {
  Random random;
  for (int i = 0; i < 1000; ++i) {
    const Vec3 u = std::pow(10, random.uniform(-8, 8)) * random.unit(), v = random.unit();
    const auto frame = deformedFrame(tangents(u, v), FrameMode::bisector).tangent_from_space.raw();
    expectOrthonormal(frame, 1);
    EXPECT_NEAR(angleBetweenUnit(frame.row[0], u / length(u)), angleBetweenUnit(frame.row[1], v), 1e-10);
  }
}

TEST(DeformedFrame, PolarIsTheNearestPairAndForgetsThePhase) {
  Random random;
  test::Largest difference;
  for (int i = 0; i < test::sized(300, 10000); ++i) {
    const Mat3 r0 = random.rotation();
    const Mat3 map = Mat3::fromColumns(random.vec(), random.vec(), random.vec());
    const Mat3 look_up = lookUpOf(r0, map, FrameMode::polar);
    const double phase = random.uniform(-kPi, kPi);
    const Mat3 turned = r0 * rotationAbout({0, 0, 1}, phase);
    const Mat3 again = lookUpOf(turned, map, FrameMode::polar);
    // Nearly parallel tangents lose digits as 1 / sine.
    const Vec3 u = map * r0.column(0), v = map * r0.column(1);
    const double sine = length(cross(u, v)) / (length(u) * length(v));
    difference.add(distanceOf(look_up, again) * std::fmin(1, 100 * sine));
    // No turn about the normal brings the pair nearer to (u, v).
    const Mat3 frame = r0.transposed() * look_up;
    const auto nearness = [&](double turn) {
      const Vec3 a = std::cos(turn) * frame.row[0] + std::sin(turn) * frame.row[1];
      const Vec3 b = std::cos(turn) * frame.row[1] - std::sin(turn) * frame.row[0];
      return dot(a, u) + dot(b, v);  // squared distance = constant - 2 x this
    };
    for (const double turn : {-1.0, -1e-3, 1e-3, 1.0, kPi}) EXPECT_LT(nearness(turn), nearness(0) * (1 + 1e-15));
  }
  test::recordHardCase(6, "L of the polar mode for two choices of (u0, v0): difference (times 100 sine of thin pairs)",
                       difference.value, test::atMost(1e-10));
}

// Degrees by which the plane map turns the material, L^-1 against the direction itself, over all phases of (u0, v0).
struct Turns {
  double least = 1e9, most = -1e9;
  void add(double angle) { least = std::fmin(least, angle), most = std::fmax(most, angle); }
  double spread() const { return most - least; }
};
Turns turnsOf(const Mat3& map, FrameMode mode) {
  Turns turns;
  for (int k = 0; k < 2000; ++k) {
    const Mat3 r0 = rotationAbout({0, 0, 1}, kPi * k / 2000);
    const Vec3 x = lookUpOf(r0, map, mode).transposed() * Vec3{1, 0, 0};
    turns.add(degrees(std::atan2(x.y, x.x)));
  }
  return turns;
}
// The same by angles alone: the bisector lies midway between the carried tangents.
Turns turnsByAngles(const Mat3& map) {
  Turns turns;
  for (int k = 0; k < 2000; ++k) {
    const double phase = kPi * k / 2000;
    const Vec3 u = map * Vec3{std::cos(phase), std::sin(phase), 0},
               v = map * Vec3{-std::sin(phase), std::cos(phase), 0};
    const double of_u = std::atan2(u.y, u.x), to_v = std::remainder(std::atan2(v.y, v.x) - of_u, 2 * kPi);
    turns.add(degrees(std::remainder(of_u + to_v / 2 - kPi / 4 - phase, 2 * kPi)));
  }
  return turns;
}

TEST(DeformedFrame, MaterialTurnsUnderShearAndStretchByTheKnownAngles) {
  // For each warp: the spread of the bisector's turn over all phases as it was measured once (shears to half
  // their last digit, stretches to 0.1 degree either way), and
  // the turn of the polar frame, which no phase changes: -atan(shear / 2), none for a stretch.
  struct Row {
    Mat3 map;
    double spread, known_to, polar;
  };
  const auto shear = [](double k) { return Mat3{{Vec3{1, k, 0}, Vec3{0, 1, 0}, Vec3{0, 0, 1}}}; };
  const auto stretch = [](double k) { return Mat3{{Vec3{k, 0, 0}, Vec3{0, 1, 0}, Vec3{0, 0, 1}}}; };
  test::Largest bisector, polar;
  for (const Row& row : {Row{shear(0.1), 0.14, 0.005, -2.8624},
                         {shear(0.5), 3.4, 0.05, -14.0362},
                         {shear(1), 11.5, 0.05, -26.5651},
                         {shear(2), 30, 0.5, -45},
                         {shear(4), 53, 0.5, -63.4349},
                         {stretch(1.5), 2 * 1.2, 0.2, 0},
                         {stretch(2), 2 * 3.2, 0.2, 0},
                         {stretch(4), 2 * 10.6, 0.2, 0},
                         {stretch(10), 2 * 21.0, 0.2, 0}}) {
    const Turns exact = turnsByAngles(row.map), found = turnsOf(row.map, FrameMode::bisector),
                of_polar = turnsOf(row.map, FrameMode::polar);
    EXPECT_NEAR(exact.spread(), row.spread, row.known_to);
    bisector.add(std::fabs(found.least - exact.least));
    bisector.add(std::fabs(found.most - exact.most));
    polar.add(std::fabs(of_polar.least - row.polar));
    polar.add(std::fabs(of_polar.most - row.polar));
  }
  test::recordHardCase(6, "shears 0.1 to 4, stretches 1.5 to 10: turn of the material, bisector, off by, degrees",
                       bisector.value, test::atMost(0.1));
  test::recordHardCase(6, "shears 0.1 to 4, stretches 1.5 to 10: turn of the material, polar, off by, degrees",
                       polar.value, test::atMost(0.1));
}

TEST(DeformedFrame, MirrorGivesTheMirrorItself) {
  Random random;
  test::Largest difference;
  for (const FrameMode mode : kModes)
    for (int i = 0; i < 200; ++i) {
      const Vec3 n = random.unit();
      Mat3 mirror;  // I - 2 n n^T
      for (int a = 0; a < 3; ++a) mirror.row[a] -= 2 * n[a] * n;
      const Mat3 map = mirror * random.rotation();
      const Mat3 look_up = lookUpOf(random.rotation(), map, mode);
      EXPECT_NEAR(determinant(look_up), -1, 1e-13);
      difference.add(distanceOf(look_up, map.transposed()));
    }
  test::recordHardCase(5, "L of a mirror: difference from the mirror itself", difference.value, test::atMost(1e-12));
}

TEST(DeformedFrame, MirroredPlaneKeepsItsOutwardNormal) {
  // Psi = diag(-1, 1, 1) on the plane z = 0: u x v points inwards, the outward normal stays +z.
  const auto frame = deformedFrame(tangents({-1, 0, 0}, {0, 1, 0}, -1), FrameMode::bisector).tangent_from_space.raw();
  EXPECT_LE(length(frame.row[2] - Vec3{0, 0, 1}), 1e-15);
  EXPECT_LE(length(frame.row[0] - Vec3{-1, 0, 0}), 1e-15);
}

TEST(DeformedFrame, NearlyOpposedTangentsKeepTheirFrame) {
  Random random;
  test::Largest off;
  for (const FrameMode mode : kModes)
    for (int i = 0; i < 100; ++i) {
      const Mat3 turn = random.rotation();
      const double angle = kPi - 1e-6;
      const auto frame = deformedFrame(
          tangents(turn.column(0), std::cos(angle) * turn.column(0) + std::sin(angle) * turn.column(1)), mode);
      ASSERT_FALSE(frame.collapsed);
      const Mat3& rows = frame.tangent_from_space.raw();
      expectOrthonormal(rows, 1);
      // u and v lie on a line to 1e-6: the bisector is across it, u-bar and v-bar at 45 degrees. Bound: theory 7.8, 9;
      // the tangents' own rounding, 1e-16 over 1e-6, is 6e-9 degrees.
      const double half = 0.5 * angle;
      const Vec3 b = std::cos(half) * turn.column(0) + std::sin(half) * turn.column(1);
      const Vec3 m = std::sin(half) * turn.column(0) - std::cos(half) * turn.column(1);
      if (mode == FrameMode::bisector) {
        off.add(degrees(angleBetweenUnit(rows.row[0], std::sqrt(0.5) * (b + m))));
      }
      off.add(degrees(angleBetweenUnit(rows.row[2], turn.column(2))));
    }
  test::recordHardCase(9, "frame of tangents 1e-6 rad from opposed: off by, degrees", off.value, test::atMost(1e-7));
}

TEST(DeformedFrame, CollapsedTangentsAreFlaggedAndNeverNaN) {
  constexpr double kInf = std::numeric_limits<double>::infinity(), kNan = std::numeric_limits<double>::quiet_NaN();
  const std::vector<Vec3> all{{0, 0, 0},      {1, 0, 0},    {-1, 0, 0},         {0, 1e-300, 0},
                              {1e300, 0, 0},  {kNan, 0, 0}, {0, kInf, -kInf},   {1e308, 1e308, 1e308},
                              {5e-324, 0, 0}, {0, 0, -1},   {kNan, kNan, kNan}, {1, 1, 1}};
  int wrong = 0;
  for (const FrameMode mode : kModes)
    for (const int handedness : {1, -1})
      for (const Vec3& u : all)
        for (const Vec3& v : all) {
          const auto frame = deformedFrame(tangents(u, v, handedness), mode);
          ASSERT_TRUE(finite(frame.tangent_from_space.raw()));
          expectOrthonormal(frame.tangent_from_space.raw(), handedness);
          const bool usable = isFinite(u) && isFinite(v) && length(cross(u * 1e-155, v * 1e-155)) > 0;
          wrong += usable && frame.collapsed;
          wrong += !frame.collapsed && (u == v || u == -v || !isFinite(u) || !isFinite(v));
        }
  test::recordHardCase(8, "zero, parallel, NaN and infinite tangents: frames not flagged, or flagged without need",
                       wrong, test::atMost(0));
}

TEST(DeformedFrame, TheFallbackTurnsTheRestFrameTheShortestWay) {
  Random random;
  test::Largest off_line, phase, jump;
  for (int i = 0; i < test::sized(1000, 100000); ++i) {
    // A map of rank one: everything onto the line along d.
    const Mat3 r0 = random.rotation();
    const Vec3 d = random.unit(), weights = random.vec();
    const auto lookUpAt = [&](const Vec3& line, double turned) {
      const Mat3 own = r0 * rotationAbout({0, 0, 1}, turned);
      const auto frame = deformedFrame(tangents(dot(weights, own.column(0)) * line, dot(weights, own.column(1)) * line),
                                       FrameMode::bisector, Orthogonal<TangentSpace, ObjectSpace>(own.transposed()));
      EXPECT_TRUE(frame.collapsed);
      return own * frame.tangent_from_space.raw();
    };
    const Mat3 look_up = lookUpAt(d, 0);
    expectOrthonormal(look_up, 1);
    // The tangent that kept most of its length is the part of `weights` in the plane; either of its signs may be meant.
    Vec3 kept = weights - dot(weights, r0.column(2)) * r0.column(2);
    kept = kept / length(kept);
    off_line.add(length(look_up * d - kept));
    if (dot(kept, d) < -0.9) continue;  // near the half turn a little turns it much
    phase.add(distanceOf(lookUpAt(d, random.uniform(-kPi, kPi)), look_up));
    const Vec3 beside = d + 1e-6 * random.unit();
    jump.add(distanceOf(lookUpAt(beside / length(beside), 0), look_up));
  }
  test::recordHardCase(8, "rank one: the line of the carried tangents, taken back, off the tangent that made it",
                       off_line.value, test::atMost(1e-12));
  test::recordHardCase(8, "rank one: the fallback for two phases of (u0, v0) differs by", phase.value,
                       test::atMost(1e-12));
  test::recordHardCase(8, "rank one: step of the fallback for a line turned by 1e-6 rad", jump.value,
                       test::atMost(1e-5));
  // Nothing left: as at rest.
  const Mat3 r0 = random.rotation();
  const auto none =
      deformedFrame(tangents({}, {}), FrameMode::bisector, Orthogonal<TangentSpace, ObjectSpace>(r0.transposed()));
  EXPECT_LE(distanceOf(r0 * none.tangent_from_space.raw(), Mat3{}), 1e-15);
}

TEST(DeformedFrame, EveryMagnitudeGivesAnOrthonormalFrame) {
  Random random;
  test::Largest off;
  for (const FrameMode mode : kModes)
    for (int i = 0; i < 5000; ++i) {
      const Vec3 u = std::pow(10, random.uniform(-300, 300)) * random.unit();
      const Vec3 v = std::pow(10, random.uniform(-300, 300)) * random.unit();
      const int handedness = i % 2 ? 1 : -1;
      const auto frame = deformedFrame(tangents(u, v, handedness), mode);
      EXPECT_FALSE(frame.collapsed);
      expectOrthonormal(frame.tangent_from_space.raw(), handedness);
      // Both lie in the tangent plane.
      const Vec3 v_hat = v / length(v), u_hat = u / length(u);
      off.add(std::fabs(dot(frame.tangent_from_space.raw().row[2], u_hat)));
      off.add(std::fabs(dot(frame.tangent_from_space.raw().row[2], v_hat)));
    }
  test::recordHardCase(10, "lengths of u and v of 1e-300 to 1e300: cosine between normal and tangents", off.value,
                       test::atMost(1e-12));
}

}  // namespace
}  // namespace srf
