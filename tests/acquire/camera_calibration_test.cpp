#include "acquire/camera_calibration.h"

#include <gtest/gtest.h>

#include <opencv2/aruco/charuco.hpp>
#include <opencv2/calib3d.hpp>
#include <opencv2/imgproc.hpp>
#include <random>

#include "acquire/calibration_report.h"
#include "acquire/shoot.h"
#include "acquire/structure_from_motion.h"
#include "base/error.h"
#include "base/files.h"
#include "base/numeric.h"
#include "tests/support/test_support.h"

namespace srf {
namespace {

namespace fs = std::filesystem;

bool holds(const std::string& text, const std::string& part) {
  return text.find(part) != std::string::npos;
}

Intrinsics someLens() {
  Intrinsics lens{CameraModel::opencv, 640, 480, 610, 605, 331, 236};
  lens.k1 = -0.21, lens.k2 = 0.09, lens.p1 = 0.0008, lens.p2 = -0.0005, lens.k3 = -0.02;
  return lens;
}

/// camera_from_board as rotation and translation: the board's printed side towards the camera.
struct BoardPose {
  Mat3 rotation;
  Vec3 translation;
  Vec3 operator*(const Vec3& x) const { return rotation * x + translation; }
};
BoardPose randomPose(std::mt19937& random, double distance) {
  std::uniform_real_distribution<double> u(-1, 1);
  const Mat3 facing = rotationAbout({1, 0, 0}, kPi);  // z of the board towards the camera
  const Mat3 tilt = rotationAbout({1, 0, 0}, 0.6 * u(random)) * rotationAbout({0, 1, 0}, 0.6 * u(random)) *
                    rotationAbout({0, 0, 1}, 0.8 * u(random));
  return {tilt * facing, {0.06 * u(random), 0.04 * u(random), distance * (1 + 0.15 * u(random))}};
}

/// The board in the picture with noise of 0.2 pixels; nothing where a corner falls outside.
std::optional<BoardCorners> seen(const Board& board, const Intrinsics& lens, const std::function<Vec3(Vec3)>& to_camera,
                                 std::mt19937& random) {
  std::normal_distribution<double> noise(0, 0.2);
  BoardCorners out;
  for (int i = 0; i < board.cornerCount(); ++i) {
    const auto p = lens.project(Point<CameraSpace>(to_camera(board.corner(i, 0.001).raw())));
    if (!p || !lens.inside(*p)) return std::nullopt;
    out.ids.push_back(i);
    out.pixels.push_back({p->x + noise(random), p->y + noise(random)});
  }
  return out;
}

/// e' C^-1 e of the parameters with these names.
double normalizedSquares(const BoardCalibration& found, const std::vector<std::string>& names,
                         const std::vector<double>& errors) {
  const auto n = static_cast<int>(names.size()), all = static_cast<int>(found.parameter_names.size());
  cv::Mat covariance(n, n, CV_64F), error(n, 1, CV_64F);
  std::vector<int> at;
  for (const std::string& name : names)
    at.push_back(static_cast<int>(std::find(found.parameter_names.begin(), found.parameter_names.end(), name) -
                                  found.parameter_names.begin()));
  for (int i = 0; i < n; ++i) {
    EXPECT_LT(at[i], all) << names[i];
    error.at<double>(i) = errors[static_cast<std::size_t>(i)];
    for (int j = 0; j < n; ++j)
      covariance.at<double>(i, j) = found.covariance[static_cast<std::size_t>(at[i]) * all + at[j]];
  }
  cv::Mat scaled(n, n, CV_64F), solved;
  for (int i = 0; i < n; ++i) {
    const double si = std::sqrt(covariance.at<double>(i, i));
    error.at<double>(i) /= si;
    for (int j = 0; j < n; ++j)
      scaled.at<double>(i, j) = covariance.at<double>(i, j) / (si * std::sqrt(covariance.at<double>(j, j)));
  }
  cv::solve(scaled, error, solved, cv::DECOMP_CHOLESKY);
  return error.dot(solved);
}

/// A sum of `count` squares of unit normal values lies within 4 of its deviations: false alarms 1 in 15000.
void expectChiSquare(double sum, double count) {
  EXPECT_NEAR((sum - count) / std::sqrt(2 * count), 0, 4) << sum << " of " << count;
}

std::vector<std::string> lensNames(const std::string& camera) {
  std::vector<std::string> names;
  for (const char* key : {"fl_x", "fl_y", "cx", "cy", "k1", "k2", "p1", "p2", "k3"})
    names.push_back(camera + "." + key);
  return names;
}
std::vector<double> lensErrors(const Intrinsics& found, const Intrinsics& truth) {
  return {found.fl_x - truth.fl_x, found.fl_y - truth.fl_y, found.cx - truth.cx,
          found.cy - truth.cy,     found.k1 - truth.k1,     found.k2 - truth.k2,
          found.p1 - truth.p1,     found.p2 - truth.p2,     found.k3 - truth.k3};
}

BoardCalibrationInput emptyInput(const std::vector<std::string>& cameras) {
  BoardCalibrationInput input;
  input.board = parseBoard("9x6:25mm");
  input.cameras = cameras;
  input.sizes.assign(cameras.size(), {640, 480});
  return input;
}

/// One camera and 12 boards.
BoardCalibrationInput oneCamera(unsigned seed) {
  std::mt19937 random(seed);
  BoardCalibrationInput input = emptyInput({"c"});
  while (input.sightings.size() < 12) {
    const BoardPose pose = randomPose(random, 0.45);
    auto corners = seen(
        input.board, someLens(), [&](Vec3 x) { return pose * x; }, random);
    if (!corners) continue;
    const std::string name = std::to_string(input.shots.size());
    input.sightings.push_back({name, "", 0, input.shots.size(), std::move(*corners)});
    input.shots.push_back(name);
  }
  return input;
}

// ---- Recovered within the stated uncertainty

TEST(BoardCalibration, ALensIsRecoveredWithinItsStatedUncertainty) {
  constexpr int kTrials = 24;
  double sum = 0, noise = 0;
  std::size_t named = 0;
  for (int trial = 0; trial < kTrials; ++trial) {
    const BoardCalibrationInput input = oneCamera(100 + trial);
    const BoardCalibration found = calibrateWithBoard(input);
    sum += normalizedSquares(found, lensNames("c"), lensErrors(found.cameras[0].lens, someLens()));
    noise += found.rms / std::sqrt(2.0) / kTrials;
    EXPECT_NEAR(found.rms, found.cameras[0].opencv_rms, 1e-5 * found.rms);  // float corners
    for (const SightingResidual& r : found.residuals) named += r.stands_out;
  }
  expectChiSquare(sum, 9.0 * kTrials);
  EXPECT_NEAR(noise, 0.2, 0.01);
  EXPECT_EQ(named, 0u);
}

TEST(BoardCalibration, ARigIsRecoveredWithinItsStatedUncertainty) {
  constexpr int kTrials = 10;
  const Mat3 turned = rotationAbout({0, 1, 0}, -0.35);  // camera b's axes in the rig
  const Vec3 center{0.16, 0.01, 0.03};
  double sum = 0;
  for (int trial = 0; trial < kTrials; ++trial) {
    std::mt19937 random(300 + trial);
    BoardCalibrationInput input = emptyInput({"a", "b"});
    while (input.shots.size() < 14) {
      const BoardPose pose = randomPose(random, 0.5);
      auto a = seen(
          input.board, someLens(), [&](Vec3 x) { return pose * x; }, random);
      auto b = seen(
          input.board, someLens(), [&](Vec3 x) { return turned.transposed() * (pose * x - center); }, random);
      if (!a && !b) continue;
      const std::string name = std::to_string(input.shots.size());
      if (a) input.sightings.push_back({name + "a", "", 0, input.shots.size(), std::move(*a)});
      if (b) input.sightings.push_back({name + "b", "", 1, input.shots.size(), std::move(*b)});
      input.shots.push_back(name);
    }
    const BoardCalibration found = calibrateWithBoard(input);
    // camera_from_rig = exp(delta) camera_from_rig(true): delta about the camera's axes.
    const Quaternion q = quaternionFromRotation(found.cameras[1].pose.rotation().raw().transposed() * turned);
    const Vec3 off = found.cameras[1].pose.origin().raw() - center;
    sum += normalizedSquares(found,
                             {"b.rotation.x", "b.rotation.y", "b.rotation.z", "b.center.x", "b.center.y", "b.center.z"},
                             {2 * q.x, 2 * q.y, 2 * q.z, off.x, off.y, off.z});
  }
  expectChiSquare(sum, 6.0 * kTrials);
}

BoardCalibrationInput onTurntable(unsigned seed, double step, const Vec3& axis, const Vec3& point) {
  std::mt19937 random(seed);
  BoardCalibrationInput input = emptyInput({"c"});
  input.turntable.emplace();
  // The camera looks down on the table by 40 degrees.
  const BoardPose pose{rotationAbout({1, 0, 0}, kPi - radians(50)), {0.01, -0.01, 0.5}};
  for (int stop = 0; stop < 12; ++stop) {
    auto corners = seen(
        input.board, someLens(),
        [&](Vec3 x) { return pose * (point + rotationAbout(axis, step * stop) * (x - point)); }, random);
    if (!corners) continue;
    input.sightings.push_back({std::to_string(stop), "", 0, input.shots.size(), std::move(*corners)});
    input.shots.push_back(std::to_string(stop));
    input.turntable->stops.push_back(stop);
  }
  return input;
}

TEST(BoardCalibration, ATurntableIsRecoveredWithinItsStatedUncertainty) {
  constexpr int kTrials = 16;
  const double step = radians(-15);
  const Vec3 point{0.02, -0.03, 0};
  const Vec3 axis = normalize(Vector<BoardSpace>(0.02, -0.03, 1))->raw();  // the board does not lie quite flat
  double steps = 0, tilts = 0, shifts = 0;
  for (int trial = 0; trial < kTrials; ++trial) {
    const BoardCalibration found = calibrateWithBoard(onTurntable(500 + trial, step, axis, point));
    const TurntableFit& t = *found.turntable;
    steps += square((t.step - step) / t.step_deviation);
    EXPECT_LT(t.step_deviation, radians(0.02));
    // Two tilts and two shifts, by the larger deviation of either: their sum is at most that of chi-square.
    tilts += square(length(cross(t.axis.raw(), axis)) / t.axis_deviation);
    const Vec3 off = t.point.raw() - point;
    const Vec3 across = off - dot(off, axis) * axis;
    shifts += dot(across, across) / square(t.point_deviation);
  }
  expectChiSquare(steps, kTrials);
  EXPECT_LT(tilts, 2 * kTrials + 4 * std::sqrt(4.0 * kTrials));
  EXPECT_LT(shifts, 2 * kTrials + 4 * std::sqrt(4.0 * kTrials));
  EXPECT_GT(tilts, 0.2 * kTrials);
  EXPECT_GT(shifts, 0.2 * kTrials);
}

TEST(BoardCalibration, AStepThatIsGivenIsHeldAndComparedWithTheFit) {
  BoardCalibrationInput input = onTurntable(7, radians(15), {0, 0, 1}, {0.01, 0, 0});
  input.turntable->step = radians(15.2);
  const BoardCalibration found = calibrateWithBoard(input);
  EXPECT_DOUBLE_EQ(found.turntable->step, radians(15.2));
  EXPECT_NEAR(*found.turntable->free_step, radians(15), 5 * found.turntable->free_step_deviation);
  input.turntable->step = radians(-15);
  EXPECT_TRUE(holds(test::messageOf([&] { calibrateWithBoard(input); }), "counter-clockwise"));
}

// ---- Faults

TEST(BoardCalibration, AViewWithAMovedBoardIsNamed) {
  BoardCalibrationInput input = oneCamera(3);
  std::mt19937 random(4);
  std::normal_distribution<double> blur(0, 1.5);
  for (Vec2& p : input.sightings[5].corners.pixels) p.x += blur(random);
  const BoardCalibration found = calibrateWithBoard(input);
  for (std::size_t i = 0; i < input.sightings.size(); ++i) EXPECT_EQ(found.residuals[i].stands_out, i == 5) << i;
}

TEST(BoardCalibration, PhotographsThatFitNoCameraAreRefused) {
  BoardCalibrationInput input = onTurntable(7, radians(15), {0, 0, 1}, {0.01, 0, 0});
  std::swap(input.turntable->stops[2], input.turntable->stops[9]);
  EXPECT_TRUE(holds(test::messageOf([&] { calibrateWithBoard(input); }), "stops' numbers"));
}

TEST(BoardCalibration, FaultsSayWhatToPhotograph) {
  BoardCalibrationInput input = oneCamera(3);
  input.sightings.resize(2);
  EXPECT_TRUE(holds(test::messageOf([&] { calibrateWithBoard(input); }), "in 2 photographs, and 3 are the least"));
  input = oneCamera(3);
  input.cameras.emplace_back("d");
  input.sizes.push_back({640, 480});
  for (std::size_t i = 0; i < 6; ++i) input.sightings[i].camera = 1;  // no shot in common
  EXPECT_TRUE(
      holds(test::messageOf([&] { calibrateWithBoard(input); }), "sees the board in no shot together with 'c'"));
  input.board = parseBoard("8x6:25mm");
  EXPECT_TRUE(holds(test::messageOf([&] { calibrateWithBoard(input); }), "half a turn"));
  // The same view of the board over and over does not tell the focal length from the distance.
  input = oneCamera(3);
  std::mt19937 random(1);
  const BoardPose flat{rotationAbout({1, 0, 0}, kPi), {0, 0, 0.45}};
  for (BoardSighting& s : input.sightings)
    s.corners = *seen(
        input.board, someLens(), [&](Vec3 x) { return flat * x; }, random);
  const BoardCalibration weak = calibrateWithBoard(oneCamera(3));
  const std::string said = test::messageOf([&] {
    const BoardCalibration found = calibrateWithBoard(input);
    // If an answer comes, it must own up to its uncertainty.
    if (found.cameras[0].parameters[0].deviation > 30 * weak.cameras[0].parameters[0].deviation)
      throw badInput("", "uncertain");
  });
  EXPECT_NE(said, "");
}

// ---- Boards

TEST(Board, ReadsWhatItWrites) {
  for (const char* text : {"chessboard:9x6:25mm", "charuco:8x11:20mm:15mm:5X5_100", "charuco:5x7:30.5mm:22mm:4X4_50"})
    EXPECT_EQ(parseBoard(text).text(), text);
  EXPECT_EQ(parseBoard("9x6:2.5cm").text(), "chessboard:9x6:25mm");
  EXPECT_EQ(parseBoard("charuco:8x11:20mm").text(), "charuco:8x11:20mm:15mm:5X5_100");
  for (const char* text : {"", "9x6", "9:25mm", "9x6:25", "9x6:-1mm", "2x6:25mm", "charuco:8x11:20mm:25mm",
                           "charuco:8x11:20mm:15mm:5X5_99", "charuco:30x31:20mm:15mm:4X4_50", "9x6:25mm:1mm"})
    EXPECT_NE(test::messageOf([&] { parseBoard(text); }), "") << text;
}

Intrinsics pinhole() {
  return {CameraModel::pinhole, 640, 480, 610, 605, 331, 236};
}

/// Picture of rectangles on a plane, 0.1 mm a texel, photographed by a camera.
Image8 photographed(const cv::Mat& texture, double width, double height, const Intrinsics& lens,
                    const BoardPose& pose) {
  Image8 out(lens.width, lens.height, 1);
  const Mat3 back = pose.rotation.transposed();
  const Vec3 center = -(back * pose.translation);
  constexpr int kSub = 2;
  for (int y = 0; y < lens.height; ++y)
    for (int x = 0; x < lens.width; ++x) {
      double sum = 0;
      for (int k = 0; k < kSub * kSub; ++k) {
        const auto d = lens.unproject({x + (k % kSub + 0.5) / kSub, y + (k / kSub + 0.5) / kSub});
        const Vec3 ray = back * d->raw();
        const double t = -center.z / ray.z;
        const double u = 1000 * (center.x + t * ray.x) + 0.5 * width, v = 0.5 * height - 1000 * (center.y + t * ray.y);
        const bool inside = t > 0 && u >= 0 && v >= 0 && u < width && v < height;
        sum += inside ? 30 + 200 * (texture.at<std::uint8_t>(std::min(texture.rows - 1, static_cast<int>(v * 10)),
                                                             std::min(texture.cols - 1, static_cast<int>(u * 10))) /
                                    255.0)
                      : 230;
      }
      out.at(x, y) = static_cast<std::uint8_t>(std::lround(sum / (kSub * kSub)));
    }
  return out;
}
cv::Mat textureOf(const Board& board) {
  cv::Mat texture(static_cast<int>(board.squareRows() * board.square * 10),
                  static_cast<int>(board.squareColumns() * board.square * 10), CV_8UC1, cv::Scalar(255));
  for (const PrintedRectangle& r : printedBoard(board))
    cv::rectangle(texture,
                  cv::Rect(cv::Point(static_cast<int>(std::lround(r.x * 10)), static_cast<int>(std::lround(r.y * 10))),
                           cv::Point(static_cast<int>(std::lround((r.x + r.width) * 10)),
                                     static_cast<int>(std::lround((r.y + r.height) * 10)))),
                  cv::Scalar(r.dark ? 0 : 255), cv::FILLED);
  return texture;
}

TEST(Board, ThePrintedBoardsAreFoundWhereTheyAre) {
  for (const char* name : {"charuco:7x5:28mm:21mm:4X4_50", "7x4:25mm", "charuco:5x7:20mm:15mm:5X5_100"}) {
    SCOPED_TRACE(name);
    const Board board = parseBoard(name);
    const BoardPose pose{
        rotationAbout({0, 1, 0}, 0.3) * rotationAbout({0, 0, 1}, 2.5) * rotationAbout({1, 0, 0}, kPi - 0.3),
        {0.01, -0.005, 0.36}};
    const Image8 picture = photographed(textureOf(board), board.squareColumns() * board.square,
                                        board.squareRows() * board.square, pinhole(), pose);
    const auto found = findBoard(board, picture, "picture");
    ASSERT_TRUE(found);
    EXPECT_EQ(static_cast<int>(found->ids.size()), board.cornerCount());
    double squares = 0;
    for (std::size_t i = 0; i < found->ids.size(); ++i) {
      const auto p = pinhole().project(Point<CameraSpace>(pose * board.corner(found->ids[i], 0.001).raw()));
      squares += square(found->pixels[i].x - p->x) + square(found->pixels[i].y - p->y);
    }
    EXPECT_LT(std::sqrt(squares / static_cast<double>(found->ids.size())), 0.15);  // pixels
  }
  EXPECT_FALSE(findBoard(parseBoard("9x6:25mm"), Image8(320, 240, 1, 90), "grey"));
  EXPECT_FALSE(findBoard(parseBoard("charuco:7x5:28mm"), Image8(8, 8, 1, 90), "tiny"));
}

TEST(Board, ACharucoBoardOfTheOldLayoutIsExplained) {
  // Before 4.6: the bottom left square is dark, markers stand in the light ones, numbered from the top.
  const Board board = parseBoard("charuco:5x6:24mm:18mm:4X4_50");
  cv::Mat texture(1440, 1200, CV_8UC1, cv::Scalar(255));
  int id = 0;
  for (int row = 0; row < 6; ++row)
    for (int column = 0; column < 5; ++column)
      if ((row + column) % 2 == 1) {
        texture(cv::Rect(column * 240, row * 240, 240, 240)) = 0;
      } else {
        cv::Mat marker;
        cv::aruco::drawMarker(cv::aruco::getPredefinedDictionary(cv::aruco::DICT_4X4_50), id++, 180, marker);
        marker.copyTo(texture(cv::Rect(column * 240 + 30, row * 240 + 30, 180, 180)));
      }
  const BoardPose pose{rotationAbout({1, 0, 0}, kPi - 0.2), {0, 0, 0.3}};
  const Image8 old = photographed(texture, 120, 144, pinhole(), pose);
  const std::string said = test::messageOf([&] { findBoard(board, old, "old.jpg"); });
  for (const char* part : {"old.jpg", "OpenCV before 4.6", "odd number of rows", "--print-board"})
    EXPECT_TRUE(holds(said, part)) << said;
  // The layout of 4.6 itself is read.
  const Image8 fresh = photographed(textureOf(board), 120, 144, pinhole(), pose);
  EXPECT_TRUE(findBoard(board, fresh, "new.jpg"));
}

TEST(Board, IsPrintedAtItsSizeWithAnOddNumberOfRows) {
  const test::TemporaryFolder folder;
  printBoard(parseBoard("charuco:8x11:20mm"), folder / "b.svg");
  const std::string svg = readTextFile(folder / "b.svg");
  EXPECT_TRUE(holds(svg, "width=\"200mm\" height=\"274mm\""));
  EXPECT_TRUE(holds(svg, "charuco:8x11:20mm:15mm:5X5_100"));
  printBoard(parseBoard("charuco:8x11:20mm"), folder / "b.pdf");
  const std::string pdf = readTextFile(folder / "b.pdf");
  EXPECT_TRUE(holds(pdf, "/MediaBox [0 0 566.929 776.693]"));  // points
  const std::size_t start = std::stoul(pdf.substr(pdf.rfind("startxref") + 10));
  EXPECT_EQ(pdf.substr(start, 4), "xref");
  EXPECT_TRUE(
      holds(test::messageOf([&] { printBoard(parseBoard("charuco:8x10:20mm"), folder / "c.svg"); }), "even number"));
  EXPECT_TRUE(holds(test::messageOf([&] { printBoard(parseBoard("9x6:20mm"), folder / "c.png"); }), ".svg or .pdf"));
}

// ---- Real photographs

TEST(Board, EveryChessboardPhotographIsFoundAndTheErrorsAreOpenCvs) {
  SRF_REQUIRE_DATA(folder, "calib-chessboard");
  std::size_t boards = 0;
  for (const auto& [camera, bar] : {std::pair{"left", 0.41}, std::pair{"right", 0.46}}) {
    BoardCalibrationInput input = emptyInput({camera});
    std::vector<std::vector<cv::Point3f>> object;
    std::vector<std::vector<cv::Point2f>> image;
    for (const ShootPhoto& photo : findPhotos(folder, std::string(camera) + "{view}.jpg")) {
      auto corners = findBoard(input.board, greyPhotograph(photo.file), photo.file);
      ASSERT_TRUE(corners) << photo.file;
      ++boards;
      object.emplace_back();
      image.emplace_back();
      for (std::size_t i = 0; i < corners->ids.size(); ++i) {
        const Vec3 p = input.board.corner(corners->ids[i], 0.001).raw();
        object.back().emplace_back(p.x, p.y, p.z);
        image.back().emplace_back(corners->pixels[i].x - 0.5, corners->pixels[i].y - 0.5);
      }
      input.sightings.push_back({photo.view, photo.file, 0, input.shots.size(), std::move(*corners)});
      input.shots.push_back(photo.view);
    }
    const BoardCalibration found = calibrateWithBoard(input);
    cv::Mat matrix, coefficients;
    std::vector<cv::Mat> rvecs, tvecs;
    const double theirs = cv::calibrateCamera(object, image, {640, 480}, matrix, coefficients, rvecs, tvecs);
    EXPECT_LE(found.rms, bar);
    EXPECT_NEAR(found.rms, theirs, 1e-3 * theirs);
    EXPECT_LE(found.rms, theirs * (1 + 1e-5));  // its corners are floats
    EXPECT_NEAR(found.cameras[0].lens.fl_x, matrix.at<double>(0, 0), 0.5);
    EXPECT_NEAR(found.cameras[0].lens.cx, matrix.at<double>(0, 2) + 0.5, 0.5);
    RecordProperty(std::string(camera) + "_rms", std::to_string(found.rms));
  }
  EXPECT_EQ(boards, 26u);
}

// ---- Structure from motion

TEST(StructureFromMotion, FailuresBecomeSentences) {
  EXPECT_TRUE(holds(colmapFailure("mapper", 1, "ERROR: failed to create sparse model"), "overlap neighbouring"));
  EXPECT_TRUE(holds(colmapFailure("feature_extractor", 134, ""), "display"));
  EXPECT_TRUE(holds(colmapFailure("exhaustive_matcher", 137, ""), "memory"));
  const test::TemporaryFolder folder;
  StructureFromMotionOptions options;
  options.photos = folder.path();
  for (const char* name : {"a.png", "b.png", "c.png"}) {
    writePng(folder / name, Image8(32, 32, 1, 128));
    options.names.emplace_back(name);
    options.cameras.emplace_back("c");
  }
  options.workspace = folder / "work";
  options.program = "no-such-program";
  EXPECT_TRUE(holds(test::messageOf([&] { runStructureFromMotion(options, Reporter::silent()); }), "install COLMAP"));
  options.program = "false";
  EXPECT_TRUE(holds(test::messageOf([&] { runStructureFromMotion(options, Reporter::silent()); }), "exit code 1"));
  setInterruptRequested(true);
  options.program = "sleep";
  EXPECT_THROW(runStructureFromMotion(options, Reporter::silent()), Error);
  setInterruptRequested(false);
}

TEST(StructureFromMotion, ABoardSetsTheScaleAndTheSpace) {
  const Board board = parseBoard("9x6:25mm");
  std::mt19937 random(8);
  Capture capture;
  std::vector<std::optional<BoardCorners>> corners;
  const Mat3 rotation = rotationAbout({0.6, 0, 0.8}, 1.1);
  std::vector<BoardPose> poses;
  while (capture.views.size() < 4) {
    const BoardPose pose = randomPose(random, 0.5);
    auto found = seen(
        board, someLens(), [&](Vec3 x) { return pose * x; }, random);
    if (!found) continue;
    CaptureView view;
    // Another space: turned, moved, 7 times as large.
    view.camera = {
        someLens(),
        {Orthogonal<AcquisitionSpace, CameraSpace>(rotation * pose.rotation.transposed()),
         Point<AcquisitionSpace>(7.0 * (rotation * -(pose.rotation.transposed() * pose.translation)) + Vec3{1, 2, 3})}};
    capture.views.push_back(view);
    corners.push_back(found);
    poses.push_back(pose);
  }
  const BoardAlignment fit = alignWithBoard(capture, board, 0.001, corners);
  EXPECT_EQ(fit.corners, 54u);
  EXPECT_LT(fit.residual, 0.0005);
  EXPECT_NEAR(fit.similarity.scale, 1 / 7.0, 0.003 / 7);
  applySimilarity(capture, fit.similarity);
  for (std::size_t i = 0; i < poses.size(); ++i)
    EXPECT_LT(length(capture.views[i].camera.center().raw() + poses[i].rotation.transposed() * poses[i].translation),
              0.002);
}

}  // namespace
}  // namespace srf
