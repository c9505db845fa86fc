#include "base/camera.h"

#include <cmath>

#include "base/numeric.h"

namespace srf {
namespace {

constexpr struct {
  CameraModel model;
  const char* name;
} kNames[] = {{CameraModel::pinhole, "PINHOLE"},
              {CameraModel::simple_radial, "SIMPLE_RADIAL"},
              {CameraModel::opencv, "OPENCV"},
              {CameraModel::opencv_fisheye, "OPENCV_FISHEYE"},
              {CameraModel::orthographic, "ORTHOGRAPHIC"}};

// Radial factor of the polynomial lens.
double radial(const Intrinsics& c, double r2) {
  return 1 + r2 * (c.k1 + r2 * (c.k2 + r2 * c.k3));
}

Vec2 distort(const Intrinsics& c, const Vec2& p) {
  const double r2 = p.x * p.x + p.y * p.y, f = radial(c, r2);
  return {p.x * f + 2 * c.p1 * p.x * p.y + c.p2 * (r2 + 2 * p.x * p.x),
          p.y * f + c.p1 * (r2 + 2 * p.y * p.y) + 2 * c.p2 * p.x * p.y};
}

// Fisheye: distorted angle of the angle theta, and its derivative.
struct Fisheye {
  double angle, slope;
};
Fisheye fisheye(const Intrinsics& c, double theta) {
  const double t2 = theta * theta;
  return {theta * (1 + t2 * (c.k1 + t2 * (c.k2 + t2 * (c.k3 + t2 * c.k4)))),
          1 + t2 * (3 * c.k1 + t2 * (5 * c.k2 + t2 * (7 * c.k3 + t2 * 9 * c.k4)))};
}

Vec2 toPixel(const Intrinsics& c, const Vec2& p) {
  return {c.fl_x * p.x + c.skew * p.y + c.cx, c.fl_y * p.y + c.cy};
}

// Whether the distorted radius grows all the way from the axis to the squared radius (or angle) t: beyond a turn the
// polynomial may grow again, and its values there are other points' pixels. The same slope, 1 + 3 k1 t + 5 k2 t^2 + ..,
// serves both lenses. Looked at in 16 steps; a dip narrower than one folds by next to nothing.
bool growsUpTo(const Intrinsics& c, double t) {
  const double k4 = c.model == CameraModel::opencv_fisheye ? c.k4 : 0;
  for (int i = 1; i <= 16; ++i) {
    const double x = t * i / 16;
    if (!(1 + x * (3 * c.k1 + x * (5 * c.k2 + x * (7 * c.k3 + x * 9 * k4))) > 0)) return false;
  }
  return true;
}

bool distorts(const Intrinsics& c) {
  return (c.model == CameraModel::opencv || c.model == CameraModel::simple_radial) &&
         (c.k1 != 0 || c.k2 != 0 || c.k3 != 0 || c.p1 != 0 || c.p2 != 0);
}

}  // namespace

std::string cameraModelName(CameraModel model) {
  for (const auto& n : kNames)
    if (n.model == model) return n.name;
  return "";
}

std::optional<CameraModel> cameraModelFromName(const std::string& name) {
  for (const auto& n : kNames)
    if (n.name == name) return n.model;
  return std::nullopt;
}

std::optional<Vec2> Intrinsics::project(const Point<CameraSpace>& point) const {
  const Vec3& p = point.raw();
  if (model == CameraModel::orthographic) return toPixel(*this, {p.x, p.y});
  if (model == CameraModel::opencv_fisheye) {
    const double r = std::hypot(p.x, p.y), theta = std::atan2(r, p.z);
    const Fisheye d = fisheye(*this, theta);
    if (!growsUpTo(*this, theta * theta)) return std::nullopt;
    const double s = r > 0 ? d.angle / r : (p.z > 0 ? 1 / p.z : 0);
    if (!(r > 0) && !(p.z > 0)) return std::nullopt;
    return toPixel(*this, {p.x * s, p.y * s});
  }
  if (!(p.z > 0)) return std::nullopt;
  const Vec2 q{p.x / p.z, p.y / p.z};
  if (!distorts(*this)) return toPixel(*this, q);
  if (!growsUpTo(*this, q.x * q.x + q.y * q.y)) return std::nullopt;
  return toPixel(*this, distort(*this, q));
}

std::optional<Direction<CameraSpace>> Intrinsics::unprojectOther(const Vec2& pixel) const {
  if (model == CameraModel::orthographic) return Direction<CameraSpace>::fromUnit({0, 0, 1});
  const double y = (pixel.y - cy) / fl_y, x = (pixel.x - cx - skew * y) / fl_x;
  if (model == CameraModel::opencv_fisheye) {
    const double r = std::hypot(x, y);
    double theta = r;
    for (int i = 0; i < 50; ++i) {
      const Fisheye d = fisheye(*this, theta);
      if (!(d.slope > 0)) return std::nullopt;
      const double step = (d.angle - r) / d.slope;
      theta -= step;
      if (std::fabs(step) < 1e-14) break;
    }
    if (!(theta >= 0 && theta <= kPi) || !growsUpTo(*this, theta * theta)) return std::nullopt;
    const double s = r > 0 ? std::sin(theta) / r : 1;
    return normalize(Vector<CameraSpace>(x * s, y * s, std::cos(theta)));
  }
  Vec2 q{x, y};
  if (distorts(*this)) {
    // Newton with a numerical Jacobian; starts from the distorted point, which is near for any usable lens.
    for (int i = 0; i < 50; ++i) {
      const Vec2 d = distort(*this, q);
      const double ex = d.x - x, ey = d.y - y, h = 1e-7;
      if (std::hypot(ex, ey) < 1e-14) break;
      const Vec2 dx = distort(*this, {q.x + h, q.y}), dy = distort(*this, {q.x, q.y + h});
      const double a = (dx.x - d.x) / h, b = (dy.x - d.x) / h, c = (dx.y - d.y) / h, e = (dy.y - d.y) / h;
      const double det = a * e - b * c;
      if (!(det > 0)) return std::nullopt;
      q = {q.x - (e * ex - b * ey) / det, q.y - (a * ey - c * ex) / det};
    }
    const Vec2 back = distort(*this, q);
    if (!(std::hypot(back.x - x, back.y - y) < 1e-6) || !growsUpTo(*this, q.x * q.x + q.y * q.y)) return std::nullopt;
  }
  return towards(q);
}

Intrinsics pinholeFromFov(int width, int height, double vfov_degrees) {
  Intrinsics lens;
  lens.width = width;
  lens.height = height;
  lens.fl_x = lens.fl_y = 0.5 * height / std::tan(0.5 * radians(vfov_degrees));
  lens.cx = 0.5 * width;
  lens.cy = 0.5 * height;
  return lens;
}

}  // namespace srf
