// Cameras with lens distortion. Pixel (0,0) is top left, the centre of the first pixel is (0.5, 0.5); cx, cy in the
// same coordinates. Camera space: x right, y down, z forward. Files with the OpenGL camera (transforms.json) are turned
// on reading by diag(1, -1, -1).
#pragma once

#include <array>
#include <cmath>
#include <optional>
#include <string>

#include "base/transform.h"

namespace srf {

enum class CameraModel { pinhole, simple_radial, opencv, opencv_fisheye, orthographic };
std::string cameraModelName(CameraModel model);  ///< as in transforms.json: "PINHOLE" ..
std::optional<CameraModel> cameraModelFromName(const std::string& name);

/// Lens and sensor, without a pose.
struct Intrinsics {
  CameraModel model = CameraModel::pinhole;
  int width = 0, height = 0;  ///< pixels
  double fl_x = 0, fl_y = 0;  ///< focal lengths in pixels; ORTHOGRAPHIC: pixels per unit
  double cx = 0, cy = 0;      ///< principal point in pixels
  double skew = 0;            ///< pixels per unit of y/z (k12 of a calibration matrix)
  double k1 = 0, k2 = 0, k3 = 0, k4 = 0, p1 = 0,
         p2 = 0;  ///< SIMPLE_RADIAL uses k1; OPENCV k1 k2 p1 p2 k3; FISHEYE k1..k4
  friend bool operator==(const Intrinsics&, const Intrinsics&) = default;

  bool isOrthographic() const { return model == CameraModel::orthographic; }
  /// Pixel of a point in camera space, or nothing where it lies behind the camera or beyond the distortion's range
  /// (where the radial polynomial stops growing: it would fold back into the image).
  std::optional<Vec2> project(const Point<CameraSpace>& p) const;
  /// Direction in camera space through a pixel (the inverse of the distortion by Newton); orthographic: +z.
  std::optional<Direction<CameraSpace>> unproject(const Vec2& pixel) const {
    if (model != CameraModel::pinhole) return unprojectOther(pixel);
    const double y = (pixel.y - cy) / fl_y;
    return towards({(pixel.x - cx - skew * y) / fl_x, y});
  }
  bool inside(const Vec2& pixel) const { return pixel.x >= 0 && pixel.y >= 0 && pixel.x <= width && pixel.y <= height; }

 private:
  /// To q in the plane at depth 1.
  static std::optional<Direction<CameraSpace>> towards(const Vec2& q) {
    const double squared = q.x * q.x + q.y * q.y + 1;
    if (!(squared < 1e100)) return normalize(Vector<CameraSpace>(q.x, q.y, 1));
    const double inverse = 1 / std::sqrt(squared);
    return Direction<CameraSpace>::fromUnit({q.x * inverse, q.y * inverse, inverse});
  }
  std::optional<Direction<CameraSpace>> unprojectOther(const Vec2& pixel) const;
};

template <class Space>
struct Ray {
  Point<Space> origin;
  Direction<Space> direction;
};

/// A camera posed in `Space` (AcquisitionSpace for captured views, ObjectSpace for the scene's camera).
template <class Space>
struct Camera {
  Intrinsics lens;
  Rigid<Space, CameraSpace> pose;  ///< space_from_camera

  struct Projection {
    Vec2 pixel;
    double depth;  ///< along the camera's z axis
  };
  std::optional<Projection> project(const Point<Space>& p) const {
    const Point<CameraSpace> q = pose.inverseTimes(p);
    const auto pixel = lens.project(q);
    if (!pixel) return std::nullopt;
    return Projection{*pixel, q.raw().z};
  }
  const Point<Space>& center() const { return pose.origin(); }
  Direction<Space> forward() const { return pose.rotation() * Direction<CameraSpace>::fromUnit({0, 0, 1}); }
  /// Along the camera's z axis.
  double depthOf(const Point<Space>& p) const { return dot(forward(), p - center()); }
  /// From a surface point to the camera: v. Orthographic: the same everywhere.
  Direction<Space> viewDirection(const Point<Space>& p) const {
    if (lens.isOrthographic()) return -forward();
    return normalize(pose.origin() - p).value_or(-forward());
  }
  std::optional<Ray<Space>> ray(const Vec2& pixel) const {
    const auto d = lens.unproject(pixel);
    if (!d) return std::nullopt;
    if (!lens.isOrthographic()) return Ray<Space>{pose.origin(), pose.rotation() * *d};
    const double x = (pixel.x - lens.cx) / lens.fl_x, y = (pixel.y - lens.cy) / lens.fl_y;
    return Ray<Space>{pose * Point<CameraSpace>(x, y, 0), pose.rotation() * *d};
  }
  /// Size of one pixel at depth z, in units of the space.
  double pixelFootprint(double depth) const { return lens.isOrthographic() ? 1 / lens.fl_x : depth / lens.fl_x; }
};

/// The same camera in object space, which coincides with acquisition space where nothing is deformed.
inline Camera<ObjectSpace> atRest(const Camera<AcquisitionSpace>& camera) {
  return {
      camera.lens,
      {Orthogonal<ObjectSpace, CameraSpace>(camera.pose.rotation().raw()), Point<ObjectSpace>(camera.center().raw())}};
}

/// Pose of a camera at `eye` that looks at `target`, with `up` upwards in the picture. Nothing where the three are
/// degenerate.
template <class Space>
std::optional<Rigid<Space, CameraSpace>> lookAt(const Point<Space>& eye, const Point<Space>& target,
                                                const Vector<Space>& up) {
  const auto z = normalize(target - eye);
  if (!z) return std::nullopt;
  const auto x = normalize(cross(*z, up));
  if (!x || length(cross(*z, up)) < 1e-9 * length(up)) return std::nullopt;
  const Vector<Space> y = cross(*z, *x);
  return Rigid<Space, CameraSpace>(Orthogonal<Space, CameraSpace>(Mat3::fromColumns(x->raw(), y.raw(), z->raw())), eye);
}
/// Intrinsics of a pinhole with the vertical field of view `vfov_degrees` and square pixels.
Intrinsics pinholeFromFov(int width, int height, double vfov_degrees);

}  // namespace srf
