#include "acquire/capture_drawing.h"

#include <gtest/gtest.h>

#include <regex>

namespace srf {
namespace {

// One camera at (0, -4, 0) that looks along +y with +z upwards, in a box of two units.
Capture oneCamera() {
  Capture capture;
  CaptureView view;
  view.name = "a<b";
  view.camera.lens = pinholeFromFov(400, 300, 30);
  view.camera.pose =
      *lookAt(Point<AcquisitionSpace>(0, -4, 0), Point<AcquisitionSpace>(), Vector<AcquisitionSpace>(0, 0, 1));
  capture.views = {view};
  capture.bounds = Box<AcquisitionSpace>{{-1, -1, -1}, {1, 1, 1}};
  CaptureLight light;
  light.name = "sky";
  light.direction = Direction<AcquisitionSpace>::fromUnit({0, 1, 0});
  capture.lights = {light};
  return capture;
}

/// The two ends of every line of a colour, in the order of the drawing.
std::vector<std::array<double, 4>> lines(const std::string& svg, const std::string& colour) {
  const std::regex one("<path d=\"M([-0-9.]+),([-0-9.]+)L([-0-9.]+),([-0-9.]+)\" fill=\"none\" stroke=\"" + colour);
  std::vector<std::array<double, 4>> found;
  for (std::sregex_iterator i(svg.begin(), svg.end(), one), end; i != end; ++i)
    found.push_back({std::stod((*i)[1]), std::stod((*i)[2]), std::stod((*i)[3]), std::stod((*i)[4])});
  return found;
}

TEST(CaptureDrawing, ShowsTheCamerasAxesAsEitherConventionHasThem) {
  for (const CameraAxes axes : {CameraAxes::opencv, CameraAxes::opengl}) {
    const double forward = axes == CameraAxes::opencv ? 1 : -1;
    const std::string svg = captureDrawing(oneCamera(), axes);
    const auto x = lines(svg, "#d03a2e"), y = lines(svg, "#2f9e44"), z = lines(svg, "#2f62c9");
    ASSERT_TRUE(x.size() == 2 && y.size() == 2 && z.size() == 2);  // from above and from the side
    EXPECT_GT(x[0][2] - x[0][0], 20);                              // world x in both
    EXPECT_GT(x[1][2] - x[1][0], 20);
    EXPECT_GT(forward * (z[0][1] - z[0][3]), 20);  // from above world y goes up the page
    EXPECT_GT(forward * (y[1][3] - y[1][1]), 20);  // from the side world z does: OpenCV's y goes down
    EXPECT_LT(std::abs(y[0][1] - y[0][3]), 0.2);   // towards the eye
  }
}

TEST(CaptureDrawing, PutsLightsWhereTheEnvironmentMapHasThem) {
  Capture capture = oneCamera();
  const auto inMap = [&](const Vec3& direction) {
    capture.lights[0].direction = Direction<AcquisitionSpace>::fromUnit(direction);
    const std::string svg = captureDrawing(capture, CameraAxes::opencv);
    const std::regex one("<circle cx=\"([-0-9.]+)\" cy=\"([-0-9.]+)\" r=\"3\" fill=\"#d99a00\"");
    std::array<double, 2> last{};
    for (std::sregex_iterator i(svg.begin(), svg.end(), one), end; i != end; ++i)
      last = {std::stod((*i)[1]) / 820, (std::stod((*i)[2]) - 472) / 410};
    return last;  // as shares of its width and height
  };
  const std::pair<Vec3, std::array<double, 2>> known[] = {
      {{1, 0, 0}, {0.5, 0.5}}, {{0, 1, 0}, {0.25, 0.5}}, {{0, -1, 0}, {0.75, 0.5}}, {{0.6, 0, 0.8}, {0.5, 0.2048}}};
  for (const auto& [direction, place] : known) {
    EXPECT_NEAR(inMap(direction)[0], place[0], 0.001);
    EXPECT_NEAR(inMap(direction)[1], place[1], 0.001);
  }
}

TEST(CaptureDrawing, NamesAreText) {
  const std::string svg = captureDrawing(oneCamera(), CameraAxes::opencv);
  EXPECT_EQ(svg.find("a<b"), std::string::npos);
  EXPECT_NE(svg.find("a&lt;b"), std::string::npos);
}

}  // namespace
}  // namespace srf
