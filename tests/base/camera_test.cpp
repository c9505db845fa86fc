#include "base/camera.h"

#include <gtest/gtest.h>

#include <random>

#include "base/numeric.h"

namespace srf {
namespace {

Intrinsics lensOf(CameraModel model) {
  Intrinsics lens;
  lens.model = model;
  lens.width = 640;
  lens.height = 480;
  lens.fl_x = 500;
  lens.fl_y = 510;
  lens.cx = 322.5;
  lens.cy = 238.25;
  if (model == CameraModel::simple_radial) lens.k1 = -0.12;
  if (model == CameraModel::opencv) {
    lens.k1 = -0.25;
    lens.k2 = 0.11;
    lens.k3 = -0.02;
    lens.p1 = 1e-3;
    lens.p2 = -2e-3;
  }
  if (model == CameraModel::opencv_fisheye) {
    lens.k1 = -0.03;
    lens.k2 = 0.004;
    lens.k3 = -0.002;
    lens.k4 = 0.0003;
  }
  return lens;
}

constexpr CameraModel kModels[] = {CameraModel::pinhole, CameraModel::simple_radial, CameraModel::opencv,
                                   CameraModel::opencv_fisheye, CameraModel::orthographic};

Camera<AcquisitionSpace> posed(const Intrinsics& lens) {
  return {lens, *lookAt(Point<AcquisitionSpace>(1, -3, 2), Point<AcquisitionSpace>(0.1, 0.2, -0.1),
                        Vector<AcquisitionSpace>(0, 0, 1))};
}

TEST(Camera, NamesOfModelsRoundTrip) {
  for (const CameraModel model : kModels) EXPECT_EQ(cameraModelFromName(cameraModelName(model)), model);
  EXPECT_FALSE(cameraModelFromName("pinhole"));
}

TEST(Camera, EveryPixelOfEveryModelRoundTrips) {
  for (const CameraModel model : kModels) {
    const auto camera = posed(lensOf(model));
    for (double y = 0; y <= 480; y += 12)
      for (double x = 0; x <= 640; x += 16) {
        const auto ray = camera.ray({x, y});
        ASSERT_TRUE(ray) << cameraModelName(model) << " " << x << " " << y;
        EXPECT_NEAR(length(ray->direction.raw()), 1, 1e-14);
        const auto back = camera.project(ray->origin + 2.5 * ray->direction);
        ASSERT_TRUE(back);
        // Newton stops at 1e-14 of the focal plane: 500 pixels of focal length, a few roundings.
        EXPECT_NEAR(back->pixel.x, x, 1e-9) << cameraModelName(model);
        EXPECT_NEAR(back->pixel.y, y, 1e-9) << cameraModelName(model);
      }
  }
}

TEST(Camera, PointsRoundTripThroughPixelAndDepth) {
  std::mt19937 random(1);
  std::uniform_real_distribution<double> offset(-0.5, 0.5);
  for (const CameraModel model : kModels) {
    const auto camera = posed(lensOf(model));
    for (int i = 0; i < 200; ++i) {
      const Point<AcquisitionSpace> p(offset(random), offset(random), offset(random));
      const auto seen = camera.project(p);
      ASSERT_TRUE(seen);
      const auto ray = camera.ray(seen->pixel);
      ASSERT_TRUE(ray);
      EXPECT_LT(length(cross(p - ray->origin, ray->direction)), 1e-11) << cameraModelName(model);
      EXPECT_NEAR(seen->depth, dot(p - camera.center(), camera.forward()), 1e-13);
    }
  }
}

TEST(Camera, SkewShiftsColumnsByTheRow) {
  Intrinsics lens = lensOf(CameraModel::pinhole);
  lens.skew = 25;
  const auto pixel = lens.project(Point<CameraSpace>(0, 0.2, 2));
  ASSERT_TRUE(pixel);
  EXPECT_DOUBLE_EQ(pixel->x, lens.cx + 25 * 0.1);
  const auto direction = lens.unproject(*pixel);
  ASSERT_TRUE(direction);
  EXPECT_NEAR(direction->raw().x, 0, 1e-15);
}

TEST(Camera, OpenCvDistortionFollowsItsFormula) {
  // OpenCV's calib3d page, typed anew for x' = 0.3, y' = -0.2.
  const Intrinsics c = lensOf(CameraModel::opencv);
  const double x = 0.3, y = -0.2, r2 = 0.13;
  const double radial = 1 + c.k1 * r2 + c.k2 * r2 * r2 + c.k3 * r2 * r2 * r2;
  const double u = x * radial + 2 * c.p1 * x * y + c.p2 * (r2 + 2 * x * x);
  const double v = y * radial + c.p1 * (r2 + 2 * y * y) + 2 * c.p2 * x * y;
  const auto pixel = c.project(Point<CameraSpace>(0.6, -0.4, 2));
  ASSERT_TRUE(pixel);
  EXPECT_NEAR(pixel->x, 500 * u + 322.5, 1e-12);
  EXPECT_NEAR(pixel->y, 510 * v + 238.25, 1e-12);
}

TEST(Camera, FisheyeSeesBeyondAHalfSphereAndKeepsEquidistance) {
  Intrinsics lens = lensOf(CameraModel::opencv_fisheye);
  lens.k1 = lens.k2 = lens.k3 = lens.k4 = 0;
  const double theta = radians(110);
  const auto pixel = lens.project(Point<CameraSpace>(std::sin(theta), 0, std::cos(theta)));
  ASSERT_TRUE(pixel);
  EXPECT_NEAR(pixel->x, lens.cx + 500 * theta, 1e-9);
  EXPECT_FALSE(lens.project(Point<CameraSpace>(0, 0, -1)));
  EXPECT_EQ(lens.project(Point<CameraSpace>(0, 0, 1)), (Vec2{lens.cx, lens.cy}));
}

TEST(Camera, PointsBehindTheCameraHaveNoPixel) {
  for (const CameraModel model : {CameraModel::pinhole, CameraModel::simple_radial, CameraModel::opencv}) {
    EXPECT_FALSE(lensOf(model).project(Point<CameraSpace>(0.1, 0, -1)));
    EXPECT_FALSE(lensOf(model).project(Point<CameraSpace>(0.1, 0, 0)));
  }
}

TEST(Camera, BeyondTheDistortionsRangeNothingFoldsBackIntoThePicture) {
  // r (1 - 0.5 r^2 + 0.1 r^4) grows up to r = 1, shrinks to r = 1.414 and grows again: the point at r = 2 would land at
  // 1.2, which is another point's pixel.
  Intrinsics lens = lensOf(CameraModel::opencv);
  lens.k1 = -0.5;
  lens.k2 = 0.1;
  lens.k3 = lens.p1 = lens.p2 = 0;
  EXPECT_TRUE(lens.project(Point<CameraSpace>(0.99, 0, 1)));
  EXPECT_FALSE(lens.project(Point<CameraSpace>(1.2, 0, 1)));
  EXPECT_FALSE(lens.project(Point<CameraSpace>(2, 0, 1)));
  EXPECT_FALSE(lens.project(Point<CameraSpace>(5, 0, 1)));
  lens.model = CameraModel::simple_radial;
  lens.k1 = -0.3;
  lens.k2 = 0;
  EXPECT_FALSE(lens.project(Point<CameraSpace>(3, 0, 1)));
  lens.model = CameraModel::opencv_fisheye;  // the same polynomial in the angle
  lens.k1 = -0.5;
  lens.k2 = 0.1;
  EXPECT_TRUE(lens.project(Point<CameraSpace>(std::sin(0.9), 0, std::cos(0.9))));
  EXPECT_FALSE(lens.project(Point<CameraSpace>(std::sin(1.2), 0, std::cos(1.2))));
  EXPECT_FALSE(lens.project(Point<CameraSpace>(std::sin(2), 0, std::cos(2))));
}

TEST(Camera, LookAtPutsTheTargetInTheMiddleAndUpUpwards) {
  const auto camera = posed(lensOf(CameraModel::pinhole));
  const auto middle = camera.project(Point<AcquisitionSpace>(0.1, 0.2, -0.1));
  ASSERT_TRUE(middle);
  EXPECT_NEAR(middle->pixel.x, 322.5, 1e-9);
  EXPECT_NEAR(middle->pixel.y, 238.25, 1e-9);
  EXPECT_LT(camera.project(Point<AcquisitionSpace>(0.1, 0.2, 0.3))->pixel.y, 238);
  EXPECT_NEAR(determinant(camera.pose.rotation()), 1, 1e-14);
  const Point<AcquisitionSpace> eye(0, 0, 1);
  EXPECT_FALSE(lookAt(eye, eye, Vector<AcquisitionSpace>(0, 0, 1)));
  EXPECT_FALSE(lookAt(eye, Point<AcquisitionSpace>(0, 0, 0), Vector<AcquisitionSpace>(0, 0, 1)));
}

TEST(Camera, OrthographicRaysAreParallelAndStartAtTheirPixel) {
  const auto camera = posed(lensOf(CameraModel::orthographic));
  const auto a = camera.ray({10, 20}), b = camera.ray({510, 20});
  ASSERT_TRUE(a && b);
  EXPECT_EQ(a->direction, b->direction);
  EXPECT_NEAR(distance(a->origin, b->origin), 1, 1e-12);  // 500 pixels at 500 pixels a unit
  EXPECT_EQ(camera.viewDirection(Point<AcquisitionSpace>(0, 0, 0)), -camera.forward());
  EXPECT_DOUBLE_EQ(camera.pixelFootprint(7), 1.0 / 500);
}

TEST(Camera, ViewDirectionPointsFromTheSurfaceToTheEye) {
  const auto camera = posed(lensOf(CameraModel::pinhole));
  const Point<AcquisitionSpace> p(0.3, 0.1, 0);
  EXPECT_NEAR(length(cross(camera.viewDirection(p), camera.center() - p)), 0, 1e-15 * 10);
  EXPECT_GT(dot(camera.viewDirection(p), camera.center() - p), 0);
}

TEST(Camera, FieldOfViewSpansTheHeight) {
  const Intrinsics lens = pinholeFromFov(512, 256, 40);
  const auto top = lens.project(Point<CameraSpace>(0, -std::tan(radians(20)), 1));
  ASSERT_TRUE(top);
  EXPECT_NEAR(top->y, 0, 1e-12);
  EXPECT_EQ(lens.fl_x, lens.fl_y);
}

}  // namespace
}  // namespace srf
