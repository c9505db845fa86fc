// `srf calibrate` as a user meets it: pictures of a board on a turntable become a capture whose views and lights are in
// the object's frame.
#include <gtest/gtest.h>
#include <sys/wait.h>

#include <cmath>
#include <cstdlib>
#include <functional>
#include <tuple>

#include "acquire/board.h"
#include "acquire/develop.h"
#include "base/camera.h"
#include "base/files.h"
#include "base/image_io.h"
#include "base/numeric.h"
#include "field/capture_file.h"
#include "tests/support/test_support.h"

namespace srf {
namespace {

namespace fs = std::filesystem;

constexpr double kStep = -20;  // degrees
const Vec3 kPoint{0.03, -0.02, 0};
const Vec3 kAxis{0, -0.5, std::sqrt(0.75)};  // the board leans by 30 degrees
// The camera looks down on the table by 40 degrees.
const Rigid<BoardSpace, CameraSpace> kCamera =
    *lookAt(Point<BoardSpace>(0.5 * (rotationAbout({1, 0, 0}, radians(-50)) * kAxis)), Point<BoardSpace>(0, 0, 0),
            Vector<BoardSpace>(kAxis));
const Mat3 kCameraFromBoard = kCamera.rotation().raw().transposed();
const Vec3 kShift = -(kCameraFromBoard * kCamera.origin().raw());

Vec3 onTable(const Vec3& board, double stop) {
  return kPoint + rotationAbout(kAxis, radians(kStep) * stop) * (board - kPoint);
}

/// The board leans on the table; 3 x 3 samples a pixel.
Image8 picture(const Board& board, const Intrinsics& lens, double stop) {
  const std::vector<PrintedRectangle> parts = printedBoard(board);
  const double width = board.squareColumns() * board.square, height = board.squareRows() * board.square;
  Image8 texture(static_cast<int>(width * 8), static_cast<int>(height * 8), 1, 255);  // 8 texels a millimetre
  for (const PrintedRectangle& r : parts)
    for (int y = static_cast<int>(std::lround(r.y * 8)); y < std::lround((r.y + r.height) * 8); ++y)
      for (int x = static_cast<int>(std::lround(r.x * 8)); x < std::lround((r.x + r.width) * 8); ++x)
        texture.at(x, y) = r.dark ? 0 : 255;
  const Mat3 turned = rotationAbout(kAxis, -radians(kStep) * stop);
  Image8 out(lens.width, lens.height, 1);
  for (int y = 0; y < lens.height; ++y)
    for (int x = 0; x < lens.width; ++x) {
      double sum = 0;
      for (int k = 0; k < 9; ++k) {
        // The ray in the board's own coordinates.
        const Vec3 ray = turned * (kCameraFromBoard.transposed() *
                                   lens.unproject({x + (k % 3 + 0.5) / 3, y + (k / 3 + 0.5) / 3})->raw());
        const Vec3 center = kPoint + turned * (kCamera.origin().raw() - kPoint);
        const Vec3 hit = center - (center.z / ray.z) * ray;
        const double u = 1000 * hit.x + 0.5 * width, v = 0.5 * height - 1000 * hit.y;
        sum += u >= 0 && v >= 0 && u < width && v < height
                   ? 30 + 0.8 * texture.at(static_cast<int>(u * 8), static_cast<int>(v * 8))
                   : 230;
      }
      out.at(x, y) = static_cast<std::uint8_t>(std::lround(sum / 9));
    }
  return out;
}

TEST(Calibrate, ATurntablesViewsAndLightsAreInTheObjectsFrame) {
  const test::TemporaryFolder folder;
  const Board board = parseBoard("charuco:7x5:25mm");
  const Intrinsics lens{CameraModel::pinhole, 640, 480, 700, 700, 322, 238};
  for (int stop = 0; stop < 6; ++stop)
    writePng(folder / "board" / ("b" + std::to_string(stop) + ".png"), picture(board, lens, stop));
  for (int stop = 0; stop < 9; ++stop)
    writePng(folder / "object" / ("v" + std::to_string(stop) + "_lamp.png"), Image8(640, 480, 3, 90));
  // Above and beside the table, in acquisition space at stop 0.
  writeTextFile(folder / "lights.json",
                R"({"lights": [{"name": "lamp", "type": "point", "position": [0.4, 0.1, 0.5]}]})");
  // With the lens held the turntable alone is at test.
  writeTextFile(folder / "object" / "transforms.json",
                R"({"w": 640, "h": 480, "fl_x": 700, "fl_y": 700, "cx": 322, "cy": 238, "frames": [{"file_path": )"
                R"("v0_lamp.png", "transform_matrix": [[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]}]})");
  const std::string capture_folder = folder / "capture";
  const std::string command = std::string(SRF_PROGRAMS) + "/srf calibrate " + (folder / "object").string() + " -o " +
                              capture_folder + " --photos {view}_{light}.png --board-photos " +
                              (folder / "board").string() + " --board-pattern {view}.png --turntable --board " +
                              board.text() + " --lens-from " + (folder / "object").string() + " --lights " +
                              (folder / "lights.json").string() + " --copy --log-level error > " +
                              (folder / "out").string() + " 2>&1";
  ASSERT_EQ(std::system(command.c_str()), 0) << readTextFile(folder / "out");
  const Capture capture = readCapture(capture_folder);
  ASSERT_EQ(capture.views.size(), 9u);
  EXPECT_TRUE(fs::exists(folder / "capture/calibration/b3.png.png"));
  EXPECT_TRUE(fs::exists(folder / "capture/images/v8_lamp.png"));
  const Camera<AcquisitionSpace>& first = capture.views[0].camera;
  EXPECT_NEAR(first.center().raw().y, 0, 1e-9);  // x points to the camera
  EXPECT_EQ(first.lens.fl_x, 700);
  for (int stop = 0; stop < 9; ++stop) {
    SCOPED_TRACE(stop);
    const CaptureView& view = capture.views[static_cast<std::size_t>(stop)];
    // A point of the object, given where it lies at stop 0, is seen where the table carries it.
    for (const Vec3& at_rest : {Vec3{0, 0, 0}, Vec3{0.05, 0.04, 0.03}, Vec3{-0.04, 0.02, 0.06}}) {
      // To acquisition space through the first view, whose camera is the true one.
      const auto object = first.pose * Point<CameraSpace>(kCameraFromBoard * at_rest + kShift);
      const auto seen = view.camera.project(object);
      const auto truth = lens.project(Point<CameraSpace>(kCameraFromBoard * onTable(at_rest, stop) + kShift));
      ASSERT_TRUE(seen && truth);
      EXPECT_NEAR(seen->pixel.x, truth->x, 0.5);
      EXPECT_NEAR(seen->pixel.y, truth->y, 0.5);
    }
    // The lamp stands still in the room, so it keeps its place in the camera.
    const CaptureLight& lamp = capture.lights[view.photos[0].light->value];
    EXPECT_LT(distance(view.camera.pose.inverseTimes(lamp.position),
                       first.pose.inverseTimes(Point<AcquisitionSpace>(0.4, 0.1, 0.5))),
              1e-9);
  }
}

struct Outcome {
  int code = 0;
  std::string said;
};
Outcome calibrate(const test::TemporaryFolder& folder, const std::string& words) {
  const int status = std::system(("cd " + folder.path().string() + " && " + SRF_PROGRAMS + "/srf calibrate " + words +
                                  " --progress none > out.txt 2>&1")
                                     .c_str());
  return {WEXITSTATUS(status), readTextFile(folder / "out.txt")};
}

/// A table top under three lights: a matt ball, a white card that faces the camera, a dark ground.
struct TableTop {
  static constexpr int kWidth = 160, kHeight = 120;
  std::vector<Vec3> directions, irradiances;  // a ring of lights 40 degrees off the camera's axis
  TableTop() {
    for (int l = 0; l < 6; ++l) {
      const double a = 2 * kPi * l / 6;
      directions.push_back(
          {std::sin(radians(40)) * std::cos(a), std::sin(radians(40)) * std::sin(a), std::cos(radians(40))});
      irradiances.push_back(Vec3{2, 1.6, 1.2} + 0.1 * l * Vec3{-1, 0, 1});
    }
  }
  static double vignetting(int x, int y) {
    return 1 - 0.4 * (square(x + 0.5 - 0.5 * kWidth) + square(y + 0.5 - 0.5 * kHeight)) /
                   (square(0.5 * kWidth) + square(0.5 * kHeight));
  }
  static Image8 encoded(const std::function<Vec3(int, int)>& linear) {
    Image8 out(kWidth, kHeight, 3);
    for (int y = 0; y < kHeight; ++y)
      for (int x = 0; x < kWidth; ++x)
        for (int c = 0; c < 3; ++c)
          out.at(x, y, c) = static_cast<std::uint8_t>(
              std::lround(255 * std::min(1.f, srgbFromLinear(static_cast<float>(linear(x, y)[c])))));
    return out;
  }
  Vec3 radiance(std::size_t light, double x, double y) const {
    const Vec3 n{(x - 110) / 30, -(y - 60) / 30, 0};
    const double rest = 1 - dot(n, n);
    const double cosine = rest > 0 ? dot(n + Vec3{0, 0, std::sqrt(rest)}, directions[light]) : directions[light].z;
    const double albedo = rest > 0 ? 0.8 : x > 10 && x < 40 && y > 10 && y < 40 ? 0.9 : 0.05;
    return (albedo / kPi * std::max(0.0, cosine)) * irradiances[light];
  }
  void write(const fs::path& folder) const {
    for (std::size_t l = 0; l < directions.size(); ++l)
      writePng(folder / ("shoot/l" + std::to_string(l) + ".png"), encoded([&](int x, int y) {
                 Vec3 sum;
                 for (int k = 0; k < 16; ++k) sum += radiance(l, x + (k % 4 + 0.5) / 4, y + (k / 4 + 0.5) / 4) / 16;
                 return Vec3{0.02, 0.02, 0.02} + vignetting(x, y) * sum;
               }));
    writePng(folder / "dark.png", encoded([](int, int) { return Vec3{0.02, 0.02, 0.02}; }));
    writePng(folder / "flat.png", encoded([](int x, int y) {
               return Vec3{0.02, 0.02, 0.02} + 0.8 * vignetting(x, y) * Vec3{1, 1, 1};
             }));
    std::string lp = std::to_string(directions.size()) + "\n";
    for (std::size_t l = 0; l < directions.size(); ++l)
      lp += "l" + std::to_string(l) + ".png " + std::to_string(directions[l].x) + " " +
            std::to_string(directions[l].y) + " " + std::to_string(directions[l].z) + "\n";
    writeTextFile(folder / "set.lp", lp);
    writeTextFile(folder / "strengths.csv", "light,value\n0,1\n1,2\n2,3\n3,4\n4,5\n5,6\n");
  }
};

// One camera that is calibrated by a board apart from the photographs of the object.
TEST(Calibrate, MasksAreUndistortedAsTheirPhotographsAre) {
  const test::TemporaryFolder folder;
  const Board board = parseBoard("charuco:7x5:25mm");
  const Intrinsics lens{CameraModel::opencv, 320, 240, 350, 350, 161, 119, 0, -0.3, 0.1};
  for (int stop = 0; stop < 6; ++stop)
    writePng(folder / "board" / ("b" + std::to_string(stop) + ".png"), picture(board, lens, stop));
  const auto transforms = [](const std::string& name) {
    return R"({"camera_model": "OPENCV", "w": 320, "h": 240, "fl_x": 350, "fl_y": 350, "cx": 161, "cy": 119, "k1": -0.3,
               "k2": 0.1, "frames": [{"file_path": ")" +
           name + R"(", "transform_matrix": [[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]}]})";
  };
  writePng(folder / "object/v0_lamp.png", Image8(320, 240, 3, 90));
  writeTextFile(folder / "lens/transforms.json", transforms("../object/v0_lamp.png"));
  Image8 mask(320, 240, 1);
  for (int y = 4; y < 200; ++y)
    for (int x = 6; x < 140; ++x) mask.at(x, y) = 255;
  writePng(folder / "object/masks/v0_lamp.png", mask);
  writePng(folder / "elsewhere/camera.png", mask);  // by the view's name
  Image8 inverted = mask;
  for (std::uint8_t& v : inverted.data()) v = static_cast<std::uint8_t>(255 - v);
  writePng(folder / "inverted/v0_lamp.png.png", inverted);
  writePng(folder / "small/v0_lamp.png", Image8(160, 120, 1, 255));
  const std::string command =
      "object -o cap --photos {view}_{light}.png --board-photos board --board-pattern {view}.png "
      "--lens-from lens --board " +
      board.text() + " ";
  const Image8 expected = Undistortion(lens).apply(mask);
  for (const char* masks : {"", "--masks elsewhere ", "--masks inverted "}) {
    SCOPED_TRACE(masks);
    fs::remove_all(folder / "cap");
    const Outcome run = calibrate(folder, command + masks + "--develop --undistort");
    ASSERT_EQ(run.code, 0) << run.said;
    const Capture capture = readCapture(folder / "cap");
    ASSERT_EQ(capture.views.size(), 1u);
    EXPECT_EQ(capture.views[0].camera.lens.model, CameraModel::pinhole);
    EXPECT_EQ(capture.views[0].mask_file.lexically_normal(), folder / "cap/masks/camera.png");
    EXPECT_EQ(readMask(capture.views[0].mask_file).data(), expected.data());
  }
  EXPECT_NE(expected.data(), mask.data());
  fs::remove_all(folder / "cap");
  // Developed alone: as it lies.
  Outcome run = calibrate(folder, command + "--develop");
  ASSERT_EQ(run.code, 0) << run.said;
  EXPECT_TRUE(fs::equivalent(readCapture(folder / "cap").views[0].mask_file, folder / "object/masks/v0_lamp.png"));
  fs::remove_all(folder / "cap");
  run = calibrate(folder, command + "--develop --undistort --masks small");
  EXPECT_EQ(run.code, 3);
  EXPECT_NE(run.said.find("v0_lamp.png: is 160 x 120, its photographs 320 x 240"), std::string::npos) << run.said;
  run = calibrate(folder, command + "--develop --undistort --masks board");
  EXPECT_NE(run.said.find("holds no mask of any photograph or view"), std::string::npos) << run.said;
}

TEST(Calibrate, AMattBallAndAWhiteCardTellLightsInDevelopedPictures) {
  const test::TemporaryFolder folder;
  const TableTop table;
  table.write(folder.path());
  const std::string images =
      "shoot -o cap --one-view orthographic --photos l{light}.png --develop --dark dark.png "
      "--flat flat.png --spheres l{light}.png --matt-sphere --white l{light}.png "
      "--white-rectangle 14,14,20,20 ";
  Outcome run = calibrate(folder, images + "--sphere 108,61,29");
  ASSERT_EQ(run.code, 0) << run.said;
  for (const bool kept : {false, true}) {
    if (kept) {
      fs::remove_all(folder / "cap");
      run = calibrate(folder, images + "--sphere 110,60,30 --keep-spheres");
      ASSERT_EQ(run.code, 0) << run.said;
    }
    const Capture capture = readCapture(folder / "cap");
    ASSERT_EQ(capture.lights.size(), 6u);
    for (std::size_t l = 0; l < 6; ++l) {
      // With a dark frame left in, or vignetting, they are degrees off.
      EXPECT_LT(degrees(angleBetweenUnit(capture.lights[l].direction.raw(), table.directions[l])), kept ? 0.3 : 0.6);
      for (int c = 0; c < 3; ++c)
        EXPECT_NEAR(capture.lights[l].strength[c] / table.irradiances[l][c], 1, 0.01) << l << " " << c;
    }
  }
}

TEST(Calibrate, OptionsThatWouldDoNothingAreRefusedWithTheReason) {
  const test::TemporaryFolder folder;
  TableTop().write(folder.path());
  writeTextFile(folder / "lights.json",
                R"({"lights": [{"name": "0", "type": "directional", "direction": [0, 0, 1]}]})");
  const std::string one = "shoot -o cap --one-view orthographic --photos l{light}.png --lp set.lp ";
  const std::tuple<std::string, int, std::string> wrong[] = {
      {one + "--dark dark.png", 2, "--dark: needs --develop"},
      {one + "--encoding measure", 2, "--encoding: needs --develop"},
      {one + "--develop --encoding gamma", 2, "'gamma': expected srgb, linear, measure"},
      {one + "--white-normal 0,0,1", 2, "need --white"},
      {one + "--lights lights.json", 2, "exclude each other"},
      {one + "--develop --copy", 2, "--copy and --develop exclude each other"},
      {one + "--world 3", 2, "--world needs --rig"},
      {one + "--camera a=l{light}.png", 2, "--camera and --photos exclude each other"},
      {one + "--units km", 2, "expected m, cm or mm"},
      {one + "--leave-out l7.png", 2, "'l7.png': no photograph has that name"},
      {one + "--develop --white l{light}.png --white-rectangle 150,5,20,20", 2,
       "do not lie in the photographs' 160 x 120"},
      {"shoot -o cap --one-view orthographic --photos l{light}.png --strengths strengths.csv", 2, "needs lights"},
      {"shoot -o cap --one-view orthographic --photos *{view}.png --leave-out l1 l2 l3 l4 l5 --lp set.lp", 2,
       "needs {light}"},
      {"shoot -o cap --one-view 40 --photos {exposure}.png --develop", 3, "tells no exposure time"},
  };
  for (const auto& [words, code, message] : wrong) {
    const Outcome run = calibrate(folder, words);
    EXPECT_EQ(run.code, code) << words << "\n" << run.said;
    EXPECT_NE(run.said.find(message), std::string::npos) << words << "\n" << run.said;
    fs::remove_all(folder / "cap");
  }
  // What integer photographs mean stays true of photographs that are not developed.
  const Outcome run = calibrate(folder, one + "--strengths strengths.csv --encoding linear");
  ASSERT_EQ(run.code, 0) << run.said;
  EXPECT_EQ(readCapture(folder / "cap").integer_transfer, Transfer::linear);
}

TEST(Calibrate, MasksAndMarkedPlacesOfAColmapModel) {
  const test::TemporaryFolder folder;
  for (const char* name : {"a.png", "b.png"}) {
    writePng(folder / "photos" / name, Image8(100, 80, 3, 90));
    writePng(folder / "masks" / name, Image8(100, 80, 1, 255));
  }
  // Two cameras one unit apart that look along +z.
  writeTextFile(folder / "model/cameras.txt", "1 PINHOLE 100 80 100 100 50 40\n");
  writeTextFile(folder / "model/images.txt", "1 1 0 0 0 0 0 0 1 a.png\n\n2 1 0 0 0 -1 0 0 1 b.png\n\n");
  writeTextFile(folder / "model/points3D.txt", "");
  const std::string by_model = "photos -o cap --colmap model ";
  // At depth 10, two units apart: (0, 0, 10) and (2, 0, 10).
  const auto marks = [&](const std::string& last) {
    writeTextFile(folder / "marks.json", R"({"distance": 0.5, "a": {"a.png": [50, 40], "b.png": [40, 40]},
                                             "b": {"a.png": [70, 40], "b.png": )" +
                                             last + "}}");
  };
  marks("[60, 40]");
  Outcome run = calibrate(folder, by_model + "--points marks.json --masks masks");
  ASSERT_EQ(run.code, 0) << run.said;
  const Capture capture = readCapture(folder / "cap");
  EXPECT_NEAR(distance(capture.views[0].camera.center(), capture.views[1].camera.center()), 0.25, 1e-12);
  EXPECT_EQ(capture.views[0].mask_file.filename(), "a.png");
  EXPECT_EQ(run.said.find("look whether they show the same place"), std::string::npos) << run.said;
  marks("[60, 400]");
  run = calibrate(folder, by_model + "--points marks.json");
  EXPECT_EQ(run.code, 3);
  EXPECT_NE(run.said.find("lies outside its photograph of 100 x 80"), std::string::npos) << run.said;
  marks("[60, 49]");
  run = calibrate(folder, by_model + "--points marks.json");
  EXPECT_NE(run.said.find("look whether they show the same place"), std::string::npos) << run.said;
  run = calibrate(folder, by_model + "--masks model");
  EXPECT_NE(run.said.find("holds no mask of any photograph"), std::string::npos) << run.said;
  run = calibrate(folder, by_model + "--distance a.png b.png 1 --points marks.json");
  EXPECT_NE(run.said.find("one thing sets the scale"), std::string::npos) << run.said;
}

}  // namespace
}  // namespace srf
