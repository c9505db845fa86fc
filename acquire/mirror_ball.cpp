#include "acquire/mirror_ball.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <random>

#include "base/error.h"
#include "base/numeric.h"

namespace srf {
namespace {

using Ray3 = Vec3;  // unit direction (perspective) or position in units (orthography) that belongs to a pixel

std::optional<Ray3> rayOf(const Intrinsics& lens, const Vec2& pixel) {
  if (lens.isOrthographic()) return Ray3{(pixel.x - lens.cx) / lens.fl_x, (pixel.y - lens.cy) / lens.fl_y, 0};
  const auto direction = lens.unproject(pixel);
  if (!direction) return std::nullopt;
  return direction->raw();
}

// A pixel with what the outline's equation needs of it: its ray and the ray's change from pixel to pixel.
struct EdgePoint {
  Vec2 pixel;
  Ray3 ray, along_x, along_y;
  double strength = 0;
};

std::optional<EdgePoint> edgePoint(const Intrinsics& lens, const Vec2& pixel, double strength = 1) {
  const auto ray = rayOf(lens, pixel);
  const auto x0 = rayOf(lens, {pixel.x - 0.5, pixel.y}), x1 = rayOf(lens, {pixel.x + 0.5, pixel.y});
  const auto y0 = rayOf(lens, {pixel.x, pixel.y - 0.5}), y1 = rayOf(lens, {pixel.x, pixel.y + 0.5});
  if (!ray || !x0 || !x1 || !y0 || !y1) return std::nullopt;
  return EdgePoint{pixel, *ray, *x1 - *x0, *y1 - *y0, strength};
}

// The equation of an outline: positive inside, 0 on it; with its derivatives.
struct Equation {
  double value;
  Vec3 by_ray;         ///< derivative by the ray
  Vec3 by_parameters;  ///< derivative by the three numbers
};

Equation equation(const Intrinsics& lens, const OutlineParameters& outline, const Ray3& ray) {
  if (!lens.isOrthographic()) return {dot(ray, outline) - 1, outline, ray};
  const double x = ray.x - outline.x, y = ray.y - outline.y, r = std::max(std::hypot(x, y), 1e-300);
  return {outline.z - r, {-x / r, -y / r, 0}, {x / r, y / r, 1}};
}

// Signed distance of an edge from the outline in pixels (to first order), and its derivative by the three numbers.
struct Residual {
  double pixels;
  Vec3 by_parameters;
};
Residual residualOf(const Intrinsics& lens, const OutlineParameters& outline, const EdgePoint& point) {
  const Equation e = equation(lens, outline, point.ray);
  const double slope = std::max(std::hypot(dot(e.by_ray, point.along_x), dot(e.by_ray, point.along_y)), 1e-300);
  return {e.value / slope, e.by_parameters / slope};
}

bool possible(const Intrinsics& lens, const OutlineParameters& outline) {
  if (!isFinite(outline)) return false;
  return lens.isOrthographic() ? outline.z > 0 : length(outline) > 1 + 1e-12;
}

Vec2 middlePixel(const Intrinsics& lens, const OutlineParameters& outline) {
  if (lens.isOrthographic()) return {lens.cx + outline.x * lens.fl_x, lens.cy + outline.y * lens.fl_y};
  return lens.project(Point<CameraSpace>(outline)).value_or(Vec2{lens.cx, lens.cy});
}

Mat3 outer(const Vec3& a, const Vec3& b) {
  return {{a.x * b, a.y * b, a.z * b}};
}

// Least squares by Gauss-Newton over weighted points.
std::optional<OutlineParameters> refined(const Intrinsics& lens, OutlineParameters outline,
                                         std::span<const EdgePoint> points, std::span<const double> weights) {
  for (int round = 0; round < 20; ++round) {
    Mat3 normal{{Vec3{}, Vec3{}, Vec3{}}};
    Vec3 right;
    for (std::size_t i = 0; i < points.size(); ++i) {
      const Residual r = residualOf(lens, outline, points[i]);
      normal = normal + weights[i] * outer(r.by_parameters, r.by_parameters);
      right += (weights[i] * r.pixels) * r.by_parameters;
    }
    const Vec3 step = inverse(normal) * right;
    if (!isFinite(step)) return std::nullopt;
    outline -= step;
    if (!possible(lens, outline)) return std::nullopt;
    if (length(step) < 1e-12 * (1 + length(outline))) break;
  }
  return outline;
}

// The outline through three edges.
std::optional<OutlineParameters> through(const Intrinsics& lens, const Ray3& a, const Ray3& b, const Ray3& c) {
  OutlineParameters outline;
  if (lens.isOrthographic()) {
    // |p|^2 = 2 p . centre + (r^2 - |centre|^2), linear in the centre and the bracket
    const auto row = [](const Ray3& p) { return Vec3{2 * p.x, 2 * p.y, 1}; };
    const auto square_of = [](const Ray3& p) { return p.x * p.x + p.y * p.y; };
    outline = inverse(Mat3{{row(a), row(b), row(c)}}) * Vec3{square_of(a), square_of(b), square_of(c)};
    outline.z = std::sqrt(outline.z + square_of(outline));
  } else {
    outline = inverse(Mat3{{a, b, c}}) * Vec3{1, 1, 1};
  }
  if (!possible(lens, outline)) return std::nullopt;
  return outline;
}

double bilinear(const ImageF& image, double x, double y) {
  const double u = std::clamp(x - 0.5, 0.0, image.width() - 1.0), v = std::clamp(y - 0.5, 0.0, image.height() - 1.0);
  const int i = std::min(static_cast<int>(u), std::max(0, image.width() - 2));
  const int j = std::min(static_cast<int>(v), std::max(0, image.height() - 2));
  const double s = u - i, t = v - j;
  const int i1 = std::min(i + 1, image.width() - 1), j1 = std::min(j + 1, image.height() - 1);
  return (1 - t) * ((1 - s) * image.at(i, j) + s * image.at(i1, j)) +
         t * ((1 - s) * image.at(i, j1) + s * image.at(i1, j1));
}

// Edges along one ray from the middle: places where the derivative of the smoothed profile is extreme.
constexpr double kStep = 0.5;   // pixels between samples
constexpr int kReach = 6;       // samples of the derivative's kernel on each side: three of its deviations
constexpr double kSmooth = 2;   // its deviation, samples
constexpr int kMostPerRay = 6;  // strongest edges kept

struct Profile {
  Vec2 from, direction;            ///< pixel of sample 0, unit step direction
  std::vector<double> derivative;  ///< per pixel
};

Profile profileAlong(const ImageF& image, const Vec2& middle, const Vec2& direction, double first, double last) {
  static const std::array<double, 2 * kReach + 1> kKernel = [] {
    std::array<double, 2 * kReach + 1> kernel{};
    double sum = 0;
    for (int k = -kReach; k <= kReach; ++k) sum += k * (kernel[k + kReach] = k * std::exp(-0.5 * square(k / kSmooth)));
    for (double& w : kernel) w /= sum * kStep;
    return kernel;
  }();
  const int count = std::max(0, static_cast<int>((last - first) / kStep)) + 1;
  std::vector<double> value(count + 2 * kReach);
  for (int i = 0; i < static_cast<int>(value.size()); ++i) {
    const double t = first + kStep * (i - kReach);
    double sum = 0;
    for (const double aside : {-1.0, 0.0, 1.0})  // along the edge, against noise
      sum += bilinear(image, middle.x + t * direction.x - aside * direction.y,
                      middle.y + t * direction.y + aside * direction.x);
    value[i] = sum / 3;
  }
  Profile profile{
      {middle.x + first * direction.x, middle.y + first * direction.y}, direction, std::vector<double>(count)};
  for (int i = 0; i < count; ++i)
    for (int k = -kReach; k <= kReach; ++k) profile.derivative[i] += kKernel[k + kReach] * value[i + k + kReach];
  return profile;
}

double quantile(std::vector<double> values, double share) {
  if (values.empty()) return 0;
  const auto at = values.begin() + static_cast<std::ptrdiff_t>(share * static_cast<double>(values.size() - 1));
  std::nth_element(values.begin(), at, values.end());
  return *at;
}

// Candidates of every ray in the band between `inner` and `outer` (shares of the outline's distance from the middle,
// or pixels about it where `pixels` is positive).
std::vector<std::vector<EdgePoint>> edgesAbout(const ImageF& image, const Intrinsics& lens,
                                               const OutlineParameters& outline, int rays, double share,
                                               double pixels) {
  const Vec2 middle = middlePixel(lens, outline);
  const std::vector<Vec2> on_outline = outlinePixels(lens, outline, rays);
  std::vector<Profile> profiles;
  std::vector<double> slopes, beyond;
  for (const Vec2& p : on_outline) {
    const Vec2 d{p.x - middle.x, p.y - middle.y};
    const double r = std::hypot(d.x, d.y), half = pixels > 0 ? pixels : share * r;
    double last = r + half;
    const Vec2 unit{d.x / r, d.y / r};
    // The band ends at the picture's border.
    const auto inside = [&](double t) {
      const double x = middle.x + t * unit.x, y = middle.y + t * unit.y;
      return x > 1 && y > 1 && x < image.width() - 1 && y < image.height() - 1;
    };
    while (last > r - half && !inside(last)) last -= kStep;
    if (last <= r - half) continue;
    profiles.push_back(profileAlong(image, middle, unit, std::max(1.0, r - half), last));
    for (const double g : profiles.back().derivative) slopes.push_back(std::fabs(g));
    double end = last + std::max(16.0, 0.25 * r);
    while (end > last && !inside(end)) end -= kStep;
    if (end > last + 6)
      for (const double g : profileAlong(image, middle, unit, last + 3, end - 3).derivative)
        beyond.push_back(std::fabs(g));
  }
  // Most of what lies in or beyond the band is no edge: there the median slope is that of the noise. The band of a
  // small or shaded ball is all slope itself.
  const double noise = std::max(
      1.4826 * (beyond.empty() ? quantile(slopes, 0.5) : std::min(quantile(slopes, 0.5), quantile(beyond, 0.5))),
      1e-12);
  std::vector<std::vector<EdgePoint>> edges;
  for (const Profile& profile : profiles) {
    std::vector<EdgePoint> found;
    const auto& g = profile.derivative;
    for (std::size_t i = 1; i + 1 < g.size(); ++i) {
      const double a = std::fabs(g[i - 1]), b = std::fabs(g[i]), c = std::fabs(g[i + 1]);
      if (b < 4 * noise || b < a || b <= c) continue;
      const double bend = a - 2 * b + c, aside = bend < 0 ? 0.5 * (a - c) / bend : 0;  // vertex of the parabola
      const double t = kStep * (static_cast<double>(i) + aside);
      const Vec2 pixel{profile.from.x + t * profile.direction.x, profile.from.y + t * profile.direction.y};
      // Beyond a few times the noise an edge is an edge: a strong one must not outweigh many faint ones.
      if (const auto point = edgePoint(lens, pixel, std::min(1.0, b / (8 * noise)))) found.push_back(*point);
    }
    std::stable_sort(found.begin(), found.end(),
                     [](const EdgePoint& p, const EdgePoint& q) { return p.strength > q.strength; });
    if (found.size() > kMostPerRay) found.resize(kMostPerRay);
    edges.push_back(found);
  }
  return edges;
}

// How much of the edges lies within `width` pixels of the outline: at most 1 a ray.
double support(const Intrinsics& lens, const OutlineParameters& outline,
               const std::vector<std::vector<EdgePoint>>& edges, double width) {
  double sum = 0;
  for (const auto& ray : edges) {
    double best = 0;
    for (const EdgePoint& point : ray) {
      const double off = residualOf(lens, outline, point).pixels / width;
      best = std::max(best, point.strength * (1 - off * off));
    }
    sum += best;
  }
  return sum;
}

// The nearest edge of each ray within `width` pixels.
std::vector<EdgePoint> nearestEdges(const Intrinsics& lens, const OutlineParameters& outline,
                                    const std::vector<std::vector<EdgePoint>>& edges, double width) {
  std::vector<EdgePoint> near;
  for (const auto& ray : edges) {
    const EdgePoint* best = nullptr;
    double least = width;
    for (const EdgePoint& point : ray)
      if (const double off = std::fabs(residualOf(lens, outline, point).pixels); off < least)
        least = off, best = &point;
    if (best) near.push_back(*best);
  }
  return near;
}

OutlineParameters refinedRobustly(const Intrinsics& lens, OutlineParameters outline,
                                  const std::vector<std::vector<EdgePoint>>& edges, double width) {
  for (int round = 0; round < 10; ++round) {
    const std::vector<EdgePoint> near = nearestEdges(lens, outline, edges, width);
    if (near.size() < 8) return outline;
    std::vector<double> weights;
    for (const EdgePoint& point : near)  // Tukey's: 1 on the outline, 0 at the width
      weights.push_back(point.strength * square(1 - square(residualOf(lens, outline, point).pixels / width)));
    const auto next = refined(lens, outline, near, weights);
    if (!next) return outline;
    const bool done = length(*next - outline) < 1e-9 * (1 + length(outline));
    outline = *next;
    if (done) break;
  }
  return outline;
}

// Calls use(p) with the ball's outline changed by one deviation along each axis of its covariance.
template <class Use>
void forOutlineDeviations(const FittedOutline& fitted, const Use& use) {
  // A triangular root of the covariance: its columns are independent deviations (Cholesky).
  const Mat3& c = fitted.covariance;
  double root[3][3] = {};
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j <= i; ++j) {
      double sum = c.row[i][j];
      for (int k = 0; k < j; ++k) sum -= root[i][k] * root[j][k];
      root[i][j] = i == j ? std::sqrt(std::max(sum, 0.0)) : root[j][j] > 0 ? sum / root[j][j] : 0.0;
    }
  for (int k = 0; k < 3; ++k) {
    FittedOutline changed = fitted;
    changed.outline += Vec3{root[0][k], root[1][k], root[2][k]};
    use(changed);
  }
}

// The five independent deviations of a sighting: three of the outline, two of the highlight.
template <class Use>
void forDeviations(const MirrorSighting& sighting, const Use& use) {
  forOutlineDeviations(sighting.outline, [&](const FittedOutline& outline) {
    MirrorSighting changed = sighting;
    changed.outline = outline;
    use(changed);
  });
  for (const int axis : {0, 1}) {
    MirrorSighting changed = sighting;
    (axis == 0 ? changed.highlight.pixel.x : changed.highlight.pixel.y) += sighting.highlight.sigma;
    use(changed);
  }
}

struct ReflectedRay {
  Vec3 point, direction;  ///< acquisition space
  double sigma = 0;       ///< radians, one direction across
};

std::optional<ReflectedRay> rayOfSighting(const MirrorSighting& s) {
  const Ball ball = ballFromOutline(s.camera.lens, s.outline.outline, s.ball_radius);
  const auto reflection = reflectionAt(s.camera.lens, ball, s.highlight.pixel);
  if (!reflection) return std::nullopt;
  return ReflectedRay{(s.camera.pose * reflection->point).raw(), (s.camera.pose * reflection->direction).raw()};
}

std::optional<ReflectedRay> rayWithSigma(const MirrorSighting& s) {
  auto ray = rayOfSighting(s);
  if (!ray) return std::nullopt;
  double sum = 0;
  forDeviations(s, [&](const MirrorSighting& changed) {
    const auto other = rayOfSighting(changed);
    sum += other ? square(angleBetweenUnit(ray->direction, other->direction)) : 1;
  });
  ray->sigma = std::max(std::sqrt(sum / 2), 1e-9);
  return ray;
}

Mat3 across(const Vec3& u) {
  return Mat3{} + (-1.0) * outer(u, u);
}

// The point of least squares of angles, each over its sigma.
std::optional<Vec3> meetingPoint(std::span<const ReflectedRay> rays) {
  Mat3 normal{{Vec3{}, Vec3{}, Vec3{}}};
  Vec3 right, middle;
  for (const ReflectedRay& r : rays) {
    normal = normal + across(r.direction);
    right += across(r.direction) * r.point;
    middle += r.point / static_cast<double>(rays.size());
  }
  Vec3 x = inverse(normal) * right;
  if (!isFinite(x)) return std::nullopt;
  for (int round = 0; round < 50; ++round) {
    normal = {{Vec3{}, Vec3{}, Vec3{}}};
    right = {};
    for (const ReflectedRay& r : rays) {
      const double d = length(x - r.point);
      if (!(d > 0)) return std::nullopt;
      const Vec3 u = (x - r.point) / d;
      if (dot(u, r.direction) <= 0) return std::nullopt;
      const Mat3 a = across(u);
      const double w = 1 / square(r.sigma);
      normal = normal + (w / (d * d)) * a;
      right += (w / d) * (a * r.direction);
    }
    const Vec3 step = inverse(normal) * right;
    if (!isFinite(step)) return std::nullopt;
    x += step;
    if (length(step) < 1e-12 * length(x - middle)) break;
  }
  return x;
}

}  // namespace

ImageCircle circleOfMask(const Image8& mask) {
  double count = 0, x = 0, y = 0;
  for (int j = 0; j < mask.height(); ++j)
    for (int i = 0; i < mask.width(); ++i)
      if (mask.at(i, j) >= 128) ++count, x += i + 0.5, y += j + 0.5;
  if (count == 0) throw badInput("mask of a ball", "is empty; paint the ball white");
  return {{x / count, y / count}, std::sqrt(count / kPi)};
}

Ball ballFromOutline(const Intrinsics& lens, const OutlineParameters& outline, double radius) {
  if (lens.isOrthographic()) return {Point<CameraSpace>(outline.x, outline.y, 0), outline.z};
  const double w = length(outline), sine = std::sqrt(std::max((1 - 1 / w) * (1 + 1 / w), 1e-300));
  return {Point<CameraSpace>(outline * (radius / (sine * w))), radius};
}

std::optional<OutlineParameters> outlineOfBall(const Intrinsics& lens, const Ball& ball) {
  const Vec3 c = ball.center.raw();
  if (lens.isOrthographic()) return OutlineParameters{c.x, c.y, ball.radius};
  const double d = length(c);
  if (!(d > ball.radius)) return std::nullopt;
  const double cosine = std::sqrt((1 - ball.radius / d) * (1 + ball.radius / d));
  return c / (d * cosine);
}

OutlineParameters outlineFromCircle(const Intrinsics& lens, const ImageCircle& circle) {
  std::vector<EdgePoint> points;
  for (int i = 0; i < 64; ++i) {
    const double a = 2 * kPi * i / 64;
    if (const auto p = edgePoint(
            lens, {circle.center.x + circle.radius * std::cos(a), circle.center.y + circle.radius * std::sin(a)}))
      points.push_back(*p);
  }
  std::optional<OutlineParameters> outline;
  if (points.size() >= 8 && circle.radius > 0) {
    const std::size_t third = points.size() / 3;
    outline = through(lens, points[0].ray, points[third].ray, points[2 * third].ray);
    if (outline) outline = refined(lens, *outline, points, std::vector<double>(points.size(), 1.0));
  }
  if (!outline)
    throw badInput("ball at " + std::to_string(circle.center.x) + ", " + std::to_string(circle.center.y),
                   "with a radius of " + std::to_string(circle.radius) +
                       " pixels is no ball that this lens can see; give centre and radius in pixels");
  return *outline;
}

FittedOutline givenOutline(const Intrinsics& lens, const ImageCircle& circle, double sigma) {
  FittedOutline given;
  given.outline = outlineFromCircle(lens, circle);
  given.covariance = Mat3{{Vec3{}, Vec3{}, Vec3{}}};
  for (const ImageCircle& moved : {ImageCircle{{circle.center.x + sigma, circle.center.y}, circle.radius},
                                   ImageCircle{{circle.center.x, circle.center.y + sigma}, circle.radius},
                                   ImageCircle{circle.center, circle.radius + sigma}}) {
    const Vec3 change = outlineFromCircle(lens, moved) - given.outline;
    given.covariance = given.covariance + outer(change, change);
  }
  return given;
}

std::vector<Vec2> outlinePixels(const Intrinsics& lens, const OutlineParameters& outline, int count) {
  std::vector<Vec2> pixels;
  const Ball ball = ballFromOutline(lens, outline);
  const Vec3 c = ball.center.raw();
  const double d = length(c);
  for (int i = 0; i < count; ++i) {
    const double a = 2 * kPi * i / count;
    Vec3 p;
    if (lens.isOrthographic()) {
      p = c + ball.radius * Vec3{std::cos(a), std::sin(a), 0};
    } else {
      // The circle along which the cone touches the ball.
      const auto axis = Direction<CameraSpace>::fromUnit(c / d);
      const Vec3 e = anyPerpendicular(axis).raw(), f = cross(axis.raw(), e);
      const double sine = ball.radius / d, cosine = std::sqrt(1 - sine * sine);
      p = c - (ball.radius * sine) * axis.raw() + (ball.radius * cosine) * (std::cos(a) * e + std::sin(a) * f);
    }
    if (const auto pixel = lens.project(Point<CameraSpace>(p))) pixels.push_back(*pixel);
  }
  return pixels;
}

FittedOutline fitOutline(const ImageF& image, const Intrinsics& lens, const OutlineParameters& start,
                         const OutlineOptions& options) {
  auto edges = edgesAbout(image, lens, start, options.rays, options.search, 0);
  std::vector<std::size_t> usable;
  for (std::size_t i = 0; i < edges.size(); ++i)
    if (!edges[i].empty()) usable.push_back(i);
  const auto notFound = [&](double share) {
    return badInput("outline of the ball",
                    "shows an edge along " + std::to_string(static_cast<int>(std::lround(100 * share))) +
                        " % only, expected 20 % at least; give a circle nearer to it, photographs in which the ball "
                        "stands out of its background, or take the circle as it is with --keep-spheres");
  };
  if (usable.size() < static_cast<std::size_t>(options.rays) / 5)
    throw notFound(static_cast<double>(usable.size()) / options.rays);

  // Outlines through three edges, far apart; the one that most edges agree with (RANSAC with a fixed seed). Raw bits of
  // the generator: the distributions of the library are its own choice.
  std::mt19937_64 random(7);
  const Vec2 start_middle = middlePixel(lens, start);
  const double start_radius = [&] {
    double sum = 0, count = 0;
    for (const Vec2& p : outlinePixels(lens, start, 16))
      sum += std::hypot(p.x - start_middle.x, p.y - start_middle.y), ++count;
    return sum / count;
  }();
  const double width = std::max(1.0, 0.01 * start_radius);
  OutlineParameters best = start;
  double best_support = support(lens, start, edges, width);
  for (int trial = 0; trial < 1500; ++trial) {
    std::array<const EdgePoint*, 3> p{};
    std::array<std::size_t, 3> ray{};
    for (int k = 0; k < 3; ++k) {
      ray[k] = random() % usable.size();
      const auto& at = edges[usable[ray[k]]];
      p[k] = &at[random() % at.size()];
    }
    std::sort(ray.begin(), ray.end());
    if (std::min(ray[1] - ray[0], ray[2] - ray[1]) < usable.size() / 12) continue;
    const auto outline = through(lens, p[0]->ray, p[1]->ray, p[2]->ray);
    if (!outline) continue;
    const Vec2 middle = middlePixel(lens, *outline);
    if (std::hypot(middle.x - start_middle.x, middle.y - start_middle.y) > options.search * start_radius) continue;
    if (const double s = support(lens, *outline, edges, width); s > best_support) best_support = s, best = *outline;
  }
  best = refinedRobustly(lens, best, edges, 3 * width);
  // Again along rays of the outline found, near it.
  edges = edgesAbout(image, lens, best, options.rays, 0, std::max(6.0, 4 * width));
  best = refinedRobustly(lens, best, edges, 2 * width);
  const double last_width = std::min(2.0, width);
  best = refinedRobustly(lens, best, edges, last_width);

  FittedOutline fitted;
  fitted.outline = best;
  const std::vector<EdgePoint> near = nearestEdges(lens, best, edges, last_width);
  fitted.covered = static_cast<double>(near.size()) / options.rays;
  if (fitted.covered < 0.2) throw notFound(fitted.covered);
  Mat3 normal{{Vec3{}, Vec3{}, Vec3{}}};
  double squares = 0;
  for (const EdgePoint& point : near) {
    const Residual r = residualOf(lens, best, point);
    squares += square(r.pixels);
    normal = normal + outer(r.by_parameters, r.by_parameters);
  }
  fitted.rms = std::sqrt(squares / static_cast<double>(near.size()));
  // Edges nearer to each other than the kernel is wide say the same: about one in three pixels of the outline is new.
  const double independent =
      std::max(4.0, std::min(static_cast<double>(near.size()), fitted.covered * 2 * kPi * start_radius / 3));
  const double variance = squares / static_cast<double>(near.size()) * independent / (independent - 3);
  fitted.covariance = (variance * static_cast<double>(near.size()) / independent) * inverse(normal);
  return fitted;
}

std::optional<Highlight> findHighlight(const ImageF& image, const Intrinsics& lens, const OutlineParameters& outline) {
  double x0 = image.width(), x1 = 0, y0 = image.height(), y1 = 0;
  for (const Vec2& p : outlinePixels(lens, outline, 64)) {
    x0 = std::min(x0, p.x), x1 = std::max(x1, p.x);
    y0 = std::min(y0, p.y), y1 = std::max(y1, p.y);
  }
  const int left = std::max(0, static_cast<int>(x0)), right = std::min(image.width(), static_cast<int>(x1) + 1);
  const int top = std::max(0, static_cast<int>(y0)), bottom = std::min(image.height(), static_cast<int>(y1) + 1);
  if (right <= left || bottom <= top) return std::nullopt;
  const int w = right - left, h = bottom - top;
  // Values inside the ball; -1 outside.
  std::vector<float> value(static_cast<std::size_t>(w) * h, -1.f);
  std::vector<double> inside;
  float peak = 0;
  bool masked = false;
  for (int y = 0; y < h; ++y)
    for (int x = 0; x < w; ++x) {
      const auto ray = rayOf(lens, {left + x + 0.5, top + y + 0.5});
      if (!ray || equation(lens, outline, *ray).value <= 0) continue;
      float sum = 0;
      const int colours = std::min(image.channels(), 3);
      for (int c = 0; c < colours; ++c) sum += image.at(left + x, top + y, c) / static_cast<float>(colours);
      masked = masked || !std::isfinite(sum);
      if (std::isfinite(sum)) peak = std::max(peak, sum);
      value[static_cast<std::size_t>(y) * w + x] = std::isfinite(sum) ? std::max(sum, 0.f) : INFINITY;
      inside.push_back(std::isfinite(sum) ? sum : 1e300);
    }
  if (inside.empty() || !(peak > 0 || masked)) return std::nullopt;
  if (masked) peak = std::max(4 * peak, 1e-6f);  // brighter than what could be measured
  for (float& v : value)
    if (std::isinf(v)) v = peak;
  if (!masked && peak < 4 * quantile(inside, 0.5)) return std::nullopt;

  // The spot of most energy among those above half the peak.
  const float threshold = 0.5f * peak;
  std::vector<std::size_t> spot;
  double most_energy = 0;
  std::vector<char> seen(value.size());
  const auto forNeighbours = [&](std::size_t at, const auto& use) {
    const int px = static_cast<int>(at % w), py = static_cast<int>(at / w);
    for (int y = std::max(0, py - 1); y <= std::min(h - 1, py + 1); ++y)
      for (int x = std::max(0, px - 1); x <= std::min(w - 1, px + 1); ++x) use(static_cast<std::size_t>(y) * w + x);
  };
  for (std::size_t i = 0; i < value.size(); ++i) {
    if (seen[i] || value[i] < threshold) continue;
    std::vector<std::size_t> connected{i};
    seen[i] = 1;
    double energy = 0;
    for (std::size_t k = 0; k < connected.size(); ++k) {
      energy += value[connected[k]];
      forNeighbours(connected[k], [&](std::size_t q) {
        if (!seen[q] && value[q] >= threshold) seen[q] = 1, connected.push_back(q);
      });
    }
    if (energy > most_energy) most_energy = energy, spot = connected;
  }
  const double radius = std::sqrt(static_cast<double>(spot.size()) / kPi);
  if (spot.empty() || static_cast<double>(spot.size()) > 0.1 * static_cast<double>(inside.size())) return std::nullopt;

  // Its flanks hold the sub-pixel part of where it is: the centroid takes in two pixels around the spot, over the level
  // of the ring beyond them.
  std::vector<char> reached(value.size());
  for (const std::size_t at : spot) reached[at] = 1;
  std::vector<std::size_t> window = spot;
  const auto grow = [&](std::vector<std::size_t>& from) {
    std::vector<std::size_t> rim;
    for (const std::size_t at : from)
      forNeighbours(at, [&](std::size_t q) {
        if (!reached[q] && value[q] >= 0) reached[q] = 1, rim.push_back(q);
      });
    return rim;
  };
  std::vector<std::size_t> rim = window;
  for (int i = 0; i < 2; ++i) {
    rim = grow(rim);
    window.insert(window.end(), rim.begin(), rim.end());
  }
  std::vector<double> ring;
  for (const std::size_t at : grow(rim)) ring.push_back(value[at]);
  const double level = quantile(ring, 0.5);
  double weight = 0, x = 0, y = 0;
  for (const std::size_t at : window) {
    const double over = std::max(0.0, value[at] - level);
    weight += over;
    x += over * (left + static_cast<double>(at % w) + 0.5);
    y += over * (top + static_cast<double>(at / w) + 0.5);
  }
  if (!(weight > 0)) return std::nullopt;
  return Highlight{{x / weight, y / weight}, std::hypot(0.1, 0.05 * radius), radius, peak};
}

std::optional<Reflection> reflectionAt(const Intrinsics& lens, const Ball& ball, const Vec2& pixel) {
  const auto ray = rayOf(lens, pixel);
  if (!ray) return std::nullopt;
  const Vec3 origin = lens.isOrthographic() ? Vec3{ray->x, ray->y, ball.center.raw().z - 2 * ball.radius} : Vec3{};
  const Vec3 d = lens.isOrthographic() ? Vec3{0, 0, 1} : *ray;
  const Vec3 to_center = ball.center.raw() - origin;
  const double along = dot(to_center, d), off = length(cross(to_center, d));
  const double root = square(ball.radius) - square(off);
  if (root < 0 || along <= 0) return std::nullopt;
  const Vec3 point = origin + (along - std::sqrt(root)) * d;
  const Vec3 n = (point - ball.center.raw()) / ball.radius;
  const auto direction = normalize(Vector<CameraSpace>(d - 2 * dot(d, n) * n));
  if (!direction) return std::nullopt;
  return Reflection{Point<CameraSpace>(point), *direction};
}

std::optional<DistantEstimate> estimateDistant(std::span<const MirrorSighting> sightings) {
  std::vector<ReflectedRay> rays;
  for (const MirrorSighting& s : sightings)
    if (const auto ray = rayWithSigma(s)) rays.push_back(*ray);
  Vec3 sum;
  double certainty = 0;
  for (const ReflectedRay& r : rays) sum += r.direction / square(r.sigma), certainty += 1 / square(r.sigma);
  const auto mean = normalize(Vector<AcquisitionSpace>(sum));
  if (!mean) return std::nullopt;
  DistantEstimate estimate{*mean, std::sqrt(1 / certainty), 0};
  double chi2 = 0;
  for (const ReflectedRay& r : rays) {
    const double off = angleBetweenUnit(r.direction, mean->raw());
    estimate.spread = std::max(estimate.spread, off);
    chi2 += square(off / r.sigma);
  }
  if (rays.size() > 1) estimate.sigma *= std::max(1.0, std::sqrt(chi2 / (2.0 * static_cast<double>(rays.size() - 1))));
  return estimate;
}

std::optional<NearEstimate> estimateNear(std::span<const MirrorSighting> sightings) {
  std::vector<ReflectedRay> rays;
  std::vector<MirrorSighting> used;
  for (const MirrorSighting& s : sightings)
    if (const auto ray = s.camera.lens.isOrthographic() ? std::nullopt : rayWithSigma(s)) {
      rays.push_back(*ray);
      used.push_back(s);
    }
  if (rays.size() < 2) return std::nullopt;
  const auto position = meetingPoint(rays);
  if (!position) return std::nullopt;

  double chi2 = 0;
  for (const ReflectedRay& r : rays) {
    const Vec3 u = (*position - r.point) / length(*position - r.point);
    chi2 += square(angleBetweenUnit(u, r.direction) / r.sigma);
  }
  NearEstimate estimate{Point<AcquisitionSpace>(*position), Mat3{{Vec3{}, Vec3{}, Vec3{}}},
                        std::sqrt(chi2 / (2.0 * static_cast<double>(rays.size()) - 3))};
  // Each input moved by one deviation moves the answer; their outer products add up.
  for (std::size_t i = 0; i < rays.size(); ++i) {
    bool lost = false;
    forDeviations(used[i], [&](const MirrorSighting& changed) {
      std::vector<ReflectedRay> moved(rays);
      const auto ray = rayOfSighting(changed);
      if (ray) moved[i].point = ray->point, moved[i].direction = ray->direction;
      const auto other = ray ? meetingPoint(moved) : std::nullopt;
      if (!other) {
        lost = true;
        return;
      }
      estimate.covariance = estimate.covariance + outer(*other - *position, *other - *position);
    });
    if (lost) return std::nullopt;
  }
  estimate.covariance = std::max(1.0, square(estimate.miss)) * estimate.covariance;
  // As uncertain as it is far away: as good as at infinity.
  const double away = length(*position - rays[0].point);
  const auto& c = estimate.covariance;
  if (std::sqrt(c.row[0].x + c.row[1].y + c.row[2].z) > 0.5 * away) return std::nullopt;
  return estimate;
}

}  // namespace srf
