// `srf calibrate` as a user meets it: pictures of a board on a turntable become a capture whose views and lights are in
// the object's frame.
#include <gtest/gtest.h>

#include <cstdlib>

#include "acquire/board.h"
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

}  // namespace
}  // namespace srf
