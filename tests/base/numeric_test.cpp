// Small numbers of base/: products, angles, rotations, keyed values, files.
#include "base/numeric.h"

#include <gtest/gtest.h>

#include <random>

#include "base/animated.h"
#include "base/error.h"
#include "base/files.h"
#include "base/parallel.h"
#include "base/reporter.h"
#include "base/sin_cos.h"
#include "base/transform.h"
#include "tests/support/hard_case.h"
#include "tests/support/test_support.h"

namespace srf {
namespace {

using Dir = Direction<ObjectSpace>;

TEST(DifferenceOfProducts, KeepsItsDigitsWhereTheProductsAgree) {
  std::mt19937_64 random(7);
  std::uniform_real_distribution<double> value(-3, 3);
  for (int i = 0; i < 10000; ++i) {
    // c d differs from a b in its last places.
    const double a = value(random), b = value(random), c = a * (1 + 1e-14 * value(random)), d = b;
    const long double exact = static_cast<long double>(a) * b - static_cast<long double>(c) * d;
    // 1.5 ulp of the result, and what the 64-bit reference itself loses.
    const double bound = 1.5 * 2.3e-16 * std::fabs(static_cast<double>(exact)) + 9.0 * 1.1e-19;
    EXPECT_NEAR(differenceOfProducts(a, b, c, d), static_cast<double>(exact), bound);
  }
}

TEST(CrossProduct, OfNearlyParallelVectorsIsExactToRounding) {
  const Vec3 a{1, 1e-9, 0.3}, b{1 + 1e-15, 1e-9, 0.3};
  const Vec3 c = cross(a, b);
  const long double e = static_cast<long double>(b.x) - 1;  // b - a has this x alone
  EXPECT_NEAR(c.y, static_cast<double>(0.3L * e), 1e-30);
  EXPECT_NEAR(c.z, static_cast<double>(-1e-9L * e), 1e-38);
}

TEST(AngleBetween, OfUnitVectorsWhoseCosineRoundsAboveOneIsZero) {
  std::mt19937 random(4);
  std::normal_distribution<double> normal;
  int above = 0;
  test::Largest angle;
  for (int i = 0; i < 10000; ++i) {
    const Dir a = *normalize(Vector<ObjectSpace>(normal(random), normal(random), normal(random)));
    above += dot(a, a) > 1;
    angle.add(angleBetween(a, a));
  }
  EXPECT_GT(above, 100) << "no cosine was beyond 1";
  test::recordHardCase(18, "angle between equal directions whose cosine is up to 1 + 2 ulp, radians", angle.value,
                       test::atMost(0));
}

TEST(AngleBetween, IsAccurateFromTinyAnglesToAHalfTurn) {
  std::mt19937 random(3);
  std::normal_distribution<double> normal;
  for (const double angle :
       {0.0, 1e-12, 1e-9, 1e-6, 1e-3, 0.5, 1.0, 1.5707, 1.5709, 2.0, 3.0, kPi - 1e-6, kPi - 1e-9}) {
    for (int i = 0; i < 20; ++i) {
      const Dir axis = *normalize(Vector<ObjectSpace>(normal(random), normal(random), normal(random)));
      const Dir a = anyPerpendicular(axis);
      const Dir b = *normalize(Vector<ObjectSpace>(rotationAbout(axis.raw(), angle) * a.raw()));
      // The directions themselves are known to 2e-16 each.
      EXPECT_NEAR(angleBetween(a, b), angle, 1e-15 + 4e-16 * angle) << angle;
    }
  }
  EXPECT_EQ(angleBetween(Dir::fromUnit({0, 0, 1}), Dir::fromUnit({0, 0, -1})), kPi);
}

TEST(AnyPerpendicular, IsUnitAndPerpendicularForEveryNormal) {
  std::mt19937 random(5);
  std::normal_distribution<double> normal;
  for (int i = 0; i < 1000; ++i) {
    const double tilt = i < 500 ? 1 : 1e-9;
    const auto n = *normalize(Vector<ObjectSpace>(tilt * normal(random), tilt * normal(random), i % 2 ? 1 : -1));
    const auto t = anyPerpendicular(n);
    EXPECT_NEAR(length(t.raw()), 1, 1e-15);
    EXPECT_NEAR(dot(t, n), 0, 1e-15);
  }
}

TEST(Normalize, WorksFromTheSmallestToTheLargestLengths) {
  for (const double scale : {1e-300, 1e-200, 1e-20, 1.0, 1e20, 1e200, 1e300}) {
    const auto d = normalize(Vector<ObjectSpace>(3 * scale, 0, -4 * scale));
    ASSERT_TRUE(d) << scale;
    EXPECT_NEAR(d->raw().x, 0.6, 1e-15);
    EXPECT_NEAR(d->raw().z, -0.8, 1e-15);
  }
  EXPECT_FALSE(normalize(Vector<ObjectSpace>(0, 0, 0)));
  EXPECT_FALSE(normalize(Vector<ObjectSpace>(NAN, 0, 0)));
  EXPECT_FALSE(normalize(Vector<ObjectSpace>(INFINITY, 0, 0)));
}

TEST(Smoothstep, IsFlatAtItsEndsAndHalfInTheMiddle) {
  EXPECT_EQ(smoothstep(1, 3, 0), 0);
  EXPECT_EQ(smoothstep(1, 3, 2), 0.5);
  EXPECT_EQ(smoothstep(1, 3, 9), 1);
  EXPECT_LT(smoothstep(1, 3, 1 + 1e-4), 1e-7);
}

Mat3 randomRotation(std::mt19937& random) {
  std::normal_distribution<double> normal;
  return rotationFromQuaternion({normal(random), normal(random), normal(random), normal(random)});
}

double farthest(const Mat3& a, const Mat3& b) {
  double off = 0;
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) off = std::max(off, std::fabs(a.row[i][j] - b.row[i][j]));
  return off;
}

TEST(Quaternion, RotationsRoundTripAtEveryAngleUpToAHalfTurn) {
  std::mt19937 random(11);
  std::normal_distribution<double> normal;
  for (int i = 0; i < 2000; ++i) {
    const auto axis = *normalize(Vector<ObjectSpace>(normal(random), normal(random), normal(random)));
    const double angle = i % 4 == 0 ? kPi : i % 4 == 1 ? kPi - 1e-9 * i : i % 4 == 2 ? 1e-9 * i : 0.003 * i;
    const Mat3 r = rotationAbout(axis.raw(), angle);
    const Quaternion q = quaternionFromRotation(r);
    EXPECT_GE(q.w, 0);
    EXPECT_NEAR(q.w * q.w + q.x * q.x + q.y * q.y + q.z * q.z, 1, 1e-15);
    EXPECT_LT(farthest(rotationFromQuaternion(q), r), 4e-15);
  }
}

TEST(Quaternion, OfAQuarterTurnAboutZIsTheTextbooks) {
  const Quaternion q = quaternionFromRotation(rotationAbout({0, 0, 1}, kPi / 2));
  EXPECT_NEAR(q.w, std::sqrt(0.5), 1e-15);
  EXPECT_NEAR(q.z, std::sqrt(0.5), 1e-15);
  const Vec3 y = rotationFromQuaternion(q) * Vec3{1, 0, 0};
  EXPECT_NEAR(y.y, 1, 1e-15);
}

TEST(Rigid, InverseTimesUndoesTheMapFarFromTheOrigin) {
  std::mt19937 random(13);
  for (int i = 0; i < 100; ++i) {
    const Rigid<AcquisitionSpace, CameraSpace> pose(Orthogonal<AcquisitionSpace, CameraSpace>(randomRotation(random)),
                                                    Point<AcquisitionSpace>(1e6, -2e6, 3e6));
    const Point<CameraSpace> p(0.25, -0.5, 0.125);
    // The map itself rounds at 4e6 x 1.1e-16; nothing more may be lost on the way back.
    EXPECT_LT(distance(pose.inverseTimes(pose * p), p), 3e-9);
  }
}

TEST(Mat3, InverseTimesTheMatrixIsTheIdentity) {
  const Mat3 m{{Vec3{2, -1, 0.5}, Vec3{0, 3, 1}, Vec3{-1, 0.25, 4}}};
  EXPECT_LT(farthest(inverse(m) * m, Mat3{}), 1e-15);
  EXPECT_NEAR(determinant(m), 2 * (12 - 0.25) + 1 * (0 + 1) + 0.5 * (0 + 3), 1e-14);
}

TEST(Box, IsEmptyUntilAPointIsInItAndThenHoldsIt) {
  Box<ObjectSpace> box;
  EXPECT_TRUE(box.empty());
  EXPECT_EQ(box.diameter(), 0);
  box.extend(Point<ObjectSpace>(1, 2, 3));
  EXPECT_FALSE(box.empty());
  box.extend(Point<ObjectSpace>(-1, 2, 3));
  EXPECT_EQ(box.diameter(), 2);
  EXPECT_EQ(box.center(), Point<ObjectSpace>(0, 2, 3));
}

// ---- Animated

JsonNode json(const std::string& text) {
  return parseJson(text, "scene.json");
}

TEST(Animated, HoldsBeforeTheFirstAndAfterTheLastKey) {
  for (const char* word : {"linear", "step", "cubic"}) {
    const auto a =
        readAnimatedNumber(json(R"({"keys": [[10, 1], [20, 5]], "interpolation": ")" + std::string(word) + "\"}"));
    EXPECT_EQ(a.at(-100), 1);
    EXPECT_EQ(a.at(10), 1);
    EXPECT_EQ(a.at(20), 5);
    EXPECT_EQ(a.at(1e9), 5);
  }
}

TEST(Animated, LinearAndStepBetweenTwoKeys) {
  const auto linear = readAnimatedNumber(json(R"({"keys": [[0, 1], [4, 3]]})"));
  EXPECT_DOUBLE_EQ(linear.at(1), 1.5);
  EXPECT_FALSE(linear.constant());
  const auto step = readAnimatedNumber(json(R"({"keys": [[0, 1], [4, 3]], "interpolation": "step"})"));
  EXPECT_EQ(step.at(3.999), 1);
  EXPECT_EQ(step.at(4), 3);
}

TEST(Animated, CubicIsCatmullRomThroughTheKeys) {
  // Equal steps: the textbook's matrix form 0.5 [1 t t2 t3] M.
  const double k[] = {1, 4, 2, 7};
  const auto a = readAnimatedNumber(json(R"({"keys": [[0, 1], [1, 4], [2, 2], [3, 7]], "interpolation": "cubic"})"));
  for (const double t : {0.0, 0.25, 0.5, 0.9}) {
    const double expected = 0.5 * (2 * k[1] + (k[2] - k[0]) * t + (2 * k[0] - 5 * k[1] + 4 * k[2] - k[3]) * t * t +
                                   (3 * k[1] - k[0] - 3 * k[2] + k[3]) * t * t * t);
    EXPECT_NEAR(a.at(1 + t), expected, 1e-14);
  }
  // One-sided ends: the first piece starts with the slope to the second key.
  EXPECT_NEAR((a.at(1e-6) - a.at(0)) / 1e-6, 3, 1e-4);
}

TEST(Animated, CubicOverUnequalStepsReproducesALineAndHasNoKinks) {
  const auto line =
      readAnimatedNumber(json(R"({"keys": [[0, 0], [1, 2], [5, 10], [6, 12]], "interpolation": "cubic"})"));
  for (double f = 0; f <= 6; f += 0.37) EXPECT_NEAR(line.at(f), 2 * f, 1e-13);
  const auto a = readAnimatedNumber(json(R"({"keys": [[0, 0], [1, 2], [5, -3], [6, 12]], "interpolation": "cubic"})"));
  const double h = 1e-6;
  for (const double f : {1.0, 5.0}) EXPECT_NEAR((a.at(f) - a.at(f - h)) / h, (a.at(f + h) - a.at(f)) / h, 1e-4);
}

TEST(Animated, VectorsMoveComponentByComponent) {
  const auto a = readAnimatedVec3(json(R"({"keys": [[0, [0, 0, 0]], [2, [2, 4, -6]]]})"));
  EXPECT_EQ(a.at(1), (Vec3{1, 2, -3}));
  const auto constant = readAnimatedVec3(json("[1, 2, 3]"));
  EXPECT_TRUE(constant.constant());
  EXPECT_EQ(constant.at(17), (Vec3{1, 2, 3}));
}

TEST(Animated, KeysOutOfOrderAreRefusedByPlace) {
  try {
    readAnimatedNumber(json(R"({"keys": [[0, 1], [0, 2]]})"));
    FAIL();
  } catch (const Error& e) {
    EXPECT_NE(std::string(e.what()).find("/keys/1/0"), std::string::npos) << e.what();
  }
  EXPECT_THROW(readAnimatedNumber(json(R"({"keys": []})")), Error);
  EXPECT_THROW(readAnimatedNumber(json(R"({"keys": [[0, 1, 2]]})")), Error);
  EXPECT_THROW(readAnimatedNumber(json(R"({"keys": [[0, 1]], "interpolation": "bezier"})")), Error);
  EXPECT_THROW(readAnimatedNumber(json(R"("fast")")), Error);
}

// ---- Files

std::size_t entries(const std::filesystem::path& folder) {
  return static_cast<std::size_t>(std::distance(std::filesystem::directory_iterator(folder), {}));
}

TEST(PartialFile, LeavesNothingBehindWithoutCommit) {
  const test::TemporaryFolder folder;
  {
    PartialFile file(folder / "a.bin");
    file.write("abc", 3);
    EXPECT_FALSE(std::filesystem::exists(folder / "a.bin"));
    EXPECT_EQ(entries(folder.path()), 1u);
  }
  EXPECT_EQ(entries(folder.path()), 0u);
}

TEST(PartialFile, KeepsTheOldFileUntilTheNewOneIsWhole) {
  const test::TemporaryFolder folder;
  writeTextFile(folder / "a.txt", "old");
  {
    PartialFile file(folder / "a.txt");
    file.write("new", 3);
    EXPECT_EQ(readTextFile(folder / "a.txt"), "old");
    file.writeAt(1, "o", 1);
    EXPECT_EQ(file.size(), 3u);
    file.commit();
  }
  EXPECT_EQ(readTextFile(folder / "a.txt"), "now");
  EXPECT_EQ(entries(folder.path()), 1u);
}

TEST(PartialFile, FailsWithTheNameWhereItCannotBeMade) {
  const test::TemporaryFolder folder;
  writeTextFile(folder / "file", "x");
  try {
    PartialFile(folder / "file/below.txt");
    FAIL();
  } catch (const Error& e) {
    EXPECT_NE(std::string(e.what()).find("file"), std::string::npos);
  }
  std::filesystem::create_directory(folder / "taken");
  PartialFile onto_folder(folder / "taken");
  EXPECT_THROW(onto_folder.commit(), Error);
}

TEST(PartialFile, AFullDiskIsOutOfBudgetAndLeavesNothing) {
  if (!std::filesystem::exists("/dev/full")) GTEST_SKIP() << "skipped: no /dev/full";
  const test::TemporaryFolder folder;
  std::filesystem::create_symlink("/dev/full", folder / ("a.bin.part-" + std::to_string(::getpid())));
  try {
    PartialFile file(folder / "a.bin");
    file.write("abc", 3);
    FAIL();
  } catch (const Error& e) {
    EXPECT_EQ(e.kind(), ErrorKind::out_of_budget);
  }
  EXPECT_EQ(entries(folder.path()), 0u);
}

TEST(Files, MissingFilesAndFoldersAreNamed) {
  const test::TemporaryFolder folder;
  for (const auto& path : {folder / "none", folder.path()}) try {
      readTextFile(path);
      FAIL();
    } catch (const Error& e) {
      EXPECT_EQ(e.kind(), ErrorKind::bad_input);
      EXPECT_TRUE(std::string(e.what()).starts_with(path.string()));
    }
}

TEST(Files, BytesRoundTripAndHashesTellThemApart) {
  const test::TemporaryFolder folder;
  const std::string bytes("a\0b\n\r", 5);
  writeTextFile(folder / "new/deep/file", bytes);
  EXPECT_EQ(readTextFile(folder / "new/deep/file"), bytes);
  EXPECT_EQ(readBinaryFile(folder / "new/deep/file").size(), 5u);
  EXPECT_NE(contentHash("abc", 3), contentHash("abd", 3));
  EXPECT_NE(contentHash("abc", 3), contentHash("abc", 3, 1));
  EXPECT_EQ(hexHash(0xab), "00000000000000ab");
}

// ---- Threads and the reporter

TEST(ParallelFor, CoversEveryIndexOnceAndPassesExceptionsOn) {
  std::vector<int> seen(1003);
  parallelFor(seen.size(), 10, [&](std::size_t begin, std::size_t end) {
    EXPECT_EQ(begin % 10, 0u);
    EXPECT_LE(end - begin, 10u);
    for (std::size_t i = begin; i < end; ++i) ++seen[i];
  });
  for (const int n : seen) EXPECT_EQ(n, 1);
  EXPECT_THROW(parallelFor(100, 1,
                           [](std::size_t begin, std::size_t) {
                             if (begin == 57) throw badInput("x", "y");
                           }),
               Error);
  parallelFor(0, 1, [](std::size_t, std::size_t) { FAIL(); });
}

TEST(Reporter, RemembersWhatItWasTold) {
  Reporter reporter(ProgressMode::none, LogLevel::error);
  {
    Reporter::Stage stage(reporter, "work", 2);
    stage.advance();
    stage.advance();
  }
  reporter.warn("careful");
  reporter.count("pixels.nan", 2);
  reporter.count("pixels.nan");
  reporter.figure("volume", 1.5);
  ASSERT_EQ(reporter.stageTimes().size(), 1u);
  EXPECT_EQ(reporter.stageTimes()[0].steps, 2u);
  EXPECT_EQ(reporter.warnings(), std::vector<std::string>{"careful"});
  EXPECT_EQ(reporter.counters().at("pixels.nan"), 3u);
  EXPECT_EQ(reporter.figures().at("volume"), 1.5);
}

TEST(Reporter, AnInterruptEndsTheNextStepOfAStage) {
  Reporter::Stage stage(Reporter::silent(), "long", 10);
  setInterruptRequested(true);
  try {
    stage.advance();
    FAIL();
  } catch (const Error& e) {
    EXPECT_EQ(e.kind(), ErrorKind::interrupted);
  }
  setInterruptRequested(false);
  stage.advance();
}

TEST(SinCos, IsOffByAtMostTwoToTheMinus52WhereverAnAngleStands) {
  std::mt19937_64 engine(5);
  const auto uniform = [&] { return static_cast<double>(engine() >> 11) * 0x1p-53; };
  std::vector<double> angles{0.0, -0.0, kPi / 4, -kPi / 4, 1e5, -1e5, 1.1e5, 3e9, 1e300, -1e22, 5e-324, 1e-310};
  for (int i = 0; i < 20; ++i) angles.push_back(i * kPi / 4);
  for (int i = 0; i < 200'000; ++i) angles.push_back((uniform() < 0.5 ? -1 : 1) * std::pow(10, 17 * uniform() - 12));
  for (int n = 1; n < 63'000; n += 61)  // as near to multiples of pi / 2 as doubles come, and beside them
    for (const double beside : {0.0, 1e-15, -1e-9}) angles.push_back(n * (kPi / 2) * (1 + beside));
  std::vector<double> sine(angles.size()), cosine(angles.size());
  sinCos(angles.data(), sine.data(), cosine.data(), angles.size());
  long double off = 0;
  for (std::size_t i = 0; i < angles.size(); ++i) {
    const long double x = angles[i];
    off = std::max({off, std::fabs(sine[i] - std::sin(x)), std::fabs(cosine[i] - std::cos(x))});
    double alone[2];
    sinCos(&angles[i], &alone[0], &alone[1], 1);
    ASSERT_TRUE(alone[0] == sine[i] && alone[1] == cosine[i]) << angles[i];
  }
  EXPECT_LE(off, 0x1p-52L);
  EXPECT_EQ(sine[0], 0);
  EXPECT_EQ(cosine[0], 1);
  for (const double x : {std::nan(""), double{INFINITY}, -double{INFINITY}}) {
    double s = 0, c = 0;
    sinCos(&x, &s, &c, 1);
    EXPECT_TRUE(std::isnan(s) && std::isnan(c));
  }
}

}  // namespace
}  // namespace srf
