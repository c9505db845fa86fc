#include "acquire/pose_adjustment.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <opencv2/core.hpp>

#include "acquire/signed_silhouette.h"
#include "acquire/silhouette_agreement.h"
#include "base/error.h"
#include "base/numeric.h"
#include "base/parallel.h"
#include "base/ray_scene.h"
#include "base/text.h"

namespace srf {
namespace {

using Space = AcquisitionSpace;
using Scene = RayScene<Space>;

constexpr int kRounds = 6, kSteps = 4;
constexpr int kCells = 96;
constexpr int kAcross = 200;         // pixels of the picture in which outlines are looked for
constexpr double kOutlier = 3;       // pixels: residuals beyond count less and less
constexpr double kIndependent = 60;  // points that an outline's many neighbours are worth
constexpr double kLoose = 0.03;      // weight of places where the hull is merely too large
constexpr double kStill = 0.03;      // pixels: the end of the rounds

// Rotation about the object's middle (radians) and translation, in camera space.
using Motion = std::array<double, 6>;

struct ViewFit {
  Camera<Space> original;
  SignedSilhouette silhouette;
  Point<CameraSpace> middle;  // of the object
  Motion unit{};              // what moves the outline by about a pixel
  Motion motion{};
};

Mat3 rotationOf(const Motion& m) {
  const Vec3 w{m[0], m[1], m[2]};
  const double angle = length(w);
  return angle > 0 ? rotationAbout(w / angle, angle) : Mat3{};
}

// Where a point of camera space is seen once the camera has moved.
std::optional<Vec2> seen(const ViewFit& view, const Motion& m, const Mat3& turn, const Point<CameraSpace>& p) {
  const Vec3 q = turn * (p - view.middle).raw() + view.middle.raw() + Vec3{m[3], m[4], m[5]};
  return view.original.lens.project(Point<CameraSpace>(q));
}

// The camera that sees a still object as `original` sees the moved one.
Camera<Space> movedCamera(const ViewFit& view) {
  const Mat3 turn = rotationOf(view.motion);
  // x_new = turn (x_old - middle) + middle + t, so x_old = turn^T (x_new - middle - t) + middle.
  const Mat3 back = turn.transposed();
  const Vec3 t{view.motion[3], view.motion[4], view.motion[5]};
  const Vec3 origin = back * (-1.0 * (view.middle.raw() + t)) + view.middle.raw();
  Camera<Space> camera = view.original;
  const Mat3 rotation = view.original.pose.rotation().raw() * back;
  camera.pose = Rigid<Space, CameraSpace>(Orthogonal<Space, CameraSpace>(rotation),
                                          view.original.pose * Point<CameraSpace>(origin));
  return camera;
}

// Points of the mesh on its outline as the camera sees it.
std::vector<Point<Space>> outline(const Scene& scene, const AcquisitionMesh& mesh, const Camera<Space>& camera) {
  const double scale = std::min(1.0, double(kAcross) / std::max(camera.lens.width, camera.lens.height));
  const int width = std::max(2, static_cast<int>(std::lround(camera.lens.width * scale))),
            height = std::max(2, static_cast<int>(std::lround(camera.lens.height * scale)));
  const Camera<Space> small{resized(camera.lens, width, height), camera.pose};
  const auto meet = [&](const Vec2& pixel) -> std::optional<Point<Space>> {
    const auto ray = small.ray(pixel);
    if (!ray) return std::nullopt;
    const TriangleHit hit = scene.intersect(*ray);
    if (!hit.hit()) return std::nullopt;
    const Triangle& t = mesh.triangles[hit.triangle];
    const auto& a = mesh.positions[t[0]];
    return a + hit.b1 * (mesh.positions[t[1]] - a) + hit.b2 * (mesh.positions[t[2]] - a);
  };
  std::vector<std::uint8_t> hit(static_cast<std::size_t>(width) * height);
  std::vector<Ray<Space>> rays;
  std::vector<std::size_t> pixel_of;
  for (int y = 0; y < height; ++y)
    for (int x = 0; x < width; ++x)
      if (const auto ray = small.ray({x + 0.5, y + 0.5})) {
        rays.push_back(*ray);
        pixel_of.push_back(static_cast<std::size_t>(y) * width + x);
      }
  std::vector<TriangleHit> hits(rays.size());
  scene.intersect(rays, hits);
  for (std::size_t i = 0; i < hits.size(); ++i) hit[pixel_of[i]] = hits[i].hit();
  std::vector<Point<Space>> points;
  for (int y = 1; y + 1 < height; ++y)
    for (int x = 1; x + 1 < width; ++x) {
      if (!hit[static_cast<std::size_t>(y) * width + x]) continue;
      for (const auto& [dx, dy] : {std::pair{1, 0}, {-1, 0}, {0, 1}, {0, -1}}) {
        if (hit[static_cast<std::size_t>(y + dy) * width + x + dx]) continue;
        double inside = 0, outside = 1;
        std::optional<Point<Space>> last = meet({x + 0.5, y + 0.5});
        for (int k = 0; k < 5; ++k) {
          const double middle = 0.5 * (inside + outside);
          if (const auto p = meet({x + 0.5 + middle * dx, y + 0.5 + middle * dy}))
            last = p, inside = middle;
          else
            outside = middle;
        }
        if (last) points.push_back(*last);
      }
    }
  return points;
}

// Signed distances of the outline from the silhouette, pixels; NaN where it is not seen in the picture.
std::vector<double> distances(const ViewFit& view, const Motion& motion,
                              const std::vector<Point<CameraSpace>>& points) {
  const Mat3 turn = rotationOf(motion);
  std::vector<double> out;
  out.reserve(points.size());
  for (const auto& p : points) {
    const auto pixel = seen(view, motion, turn, p);
    out.push_back(pixel && view.original.lens.inside(*pixel) ? view.silhouette.at(pixel->x, pixel->y) : NAN);
  }
  return out;
}

// How far the hull's outline lies within the silhouette, root mean square over all of it.
double eaten(const std::vector<double>& d) {
  double squares = 0, count = 0;
  for (const double x : d)
    if (std::isfinite(x)) squares += square(std::min(x, 0.0)), ++count;
  return count > 0 ? std::sqrt(squares / count) : 0;
}

// Gauss-Newton on the motion. The hull holds the object, so where its outline lies within the silhouette the pose is
// wrong; where it lies outside, the hull is loose, which says little.
void fit(ViewFit& view, const std::vector<Point<Space>>& outline_points, double uncertainty) {
  std::vector<Point<CameraSpace>> points;
  for (const auto& p : outline_points) points.push_back(view.original.pose.inverseTimes(p));
  if (points.size() < 12) return;
  for (int step = 0; step < kSteps; ++step) {
    const auto here = distances(view, view.motion, points);
    std::vector<std::vector<double>> ahead, behind;
    constexpr double kApart = 0.5;  // pixels
    for (int k = 0; k < 6; ++k) {
      Motion a = view.motion, b = view.motion;
      a[k] += kApart * view.unit[k], b[k] -= kApart * view.unit[k];
      ahead.push_back(distances(view, a, points));
      behind.push_back(distances(view, b, points));
    }
    cv::Matx<double, 6, 6> normal = cv::Matx<double, 6, 6>::zeros();
    cv::Vec<double, 6> right = cv::Vec<double, 6>::all(0);
    const double share = std::min(1.0, kIndependent / static_cast<double>(points.size()));
    for (std::size_t i = 0; i < points.size(); ++i) {
      cv::Vec<double, 6> row;
      bool usable = std::isfinite(here[i]);
      for (int k = 0; k < 6; ++k) {
        row[k] = (ahead[k][i] - behind[k][i]) / (2 * kApart);
        usable = usable && std::isfinite(row[k]);
      }
      if (!usable) continue;
      const double one_sided = here[i] < 0 ? 1 : kLoose;
      const double weight = share * one_sided / (1 + square(here[i] / kOutlier));  // Cauchy
      for (int a = 0; a < 6; ++a) {
        right[a] -= weight * row[a] * here[i];
        for (int b = 0; b < 6; ++b) normal(a, b) += weight * row[a] * row[b];
      }
    }
    const double prior = 1 / square(uncertainty);
    for (int k = 0; k < 6; ++k) {
      normal(k, k) += prior;
      right[k] -= prior * view.motion[k] / view.unit[k];
    }
    cv::Vec<double, 6> change;
    if (!cv::solve(normal, right, change, cv::DECOMP_CHOLESKY)) return;
    for (int k = 0; k < 6; ++k) view.motion[k] += change[k] * view.unit[k];
  }
}

AcquisitionMesh looseHull(const std::vector<SilhouetteView>& views, const std::optional<Box<Space>>& bounds,
                          int tolerance) {
  HullOptions options;
  options.resolution = kCells;
  options.tolerance = tolerance;
  options.exclude_outliers = false;
  options.bounds = bounds;
  return carveVisualHull(views, options, Reporter::silent()).mesh;
}

}  // namespace

PoseAdjustment adjustPoses(std::vector<SilhouetteView>& views, const PoseAdjustmentOptions& options,
                           Reporter& reporter) {
  if (!(options.uncertainty > 0) || !std::isfinite(options.uncertainty))
    throw Error(ErrorKind::usage, "the poses' uncertainty is not above 0; give pixels", "pose adjustment");
  PoseAdjustment result;
  for (const SilhouetteView& view : views) result.views.push_back({view.name});
  if (views.size() < 4) return result;
  const int tolerance = std::clamp(static_cast<int>(views.size()) / 12, 1, 4);
  Reporter::Stage stage(reporter, "adjust poses", kRounds + 2);

  // A hull that is eaten to nothing agrees with no view.
  const auto agreement = [&](const std::vector<SilhouetteView>& with) {
    try {
      return silhouetteConsistency(looseHull(with, options.bounds, 0), with);
    } catch (const Error& error) {
      if (error.kind() != ErrorKind::bad_input) throw;
      return std::vector<ViewConsistency>(with.size());
    }
  };
  const auto before = agreement(views);
  stage.advance();

  std::vector<SilhouetteView> moved = views;
  std::vector<ViewFit> fits;
  for (int round = 0; round < kRounds; ++round) {
    const AcquisitionMesh hull = looseHull(moved, options.bounds, tolerance);
    const Scene scene = Scene::ofTriangles(hull.positions, hull.triangles);
    if (fits.empty()) {
      const auto box = hull.bounds();
      const double radius = 0.35 * box.diameter();
      for (const SilhouetteView& view : views) {
        ViewFit f{view.camera, SignedSilhouette(view.mask), view.camera.pose.inverseTimes(box.center())};
        const double depth = f.middle.raw().z, pixel = view.camera.pixelFootprint(depth);
        if (!(pixel > 0)) throw badInput(view.name, "its camera looks away from the object; check its pose");
        f.unit = {pixel / radius, pixel / radius, pixel / radius, pixel, pixel, pixel * std::fabs(depth) / radius};
        fits.push_back(std::move(f));
      }
    }
    std::vector<double> change(views.size(), 0);
    parallelFor(views.size(), 1, [&](std::size_t i, std::size_t) {
      const auto points = outline(scene, hull, moved[i].camera);
      const Motion was = fits[i].motion;
      std::vector<Point<CameraSpace>> local;
      for (const auto& p : points) local.push_back(fits[i].original.pose.inverseTimes(p));
      if (round == 0) result.views[i].before = eaten(distances(fits[i], was, local));
      fit(fits[i], points, options.uncertainty);
      result.views[i].after = eaten(distances(fits[i], fits[i].motion, local));
      for (int k = 0; k < 6; ++k) change[i] += square((fits[i].motion[k] - was[k]) / fits[i].unit[k]);
      moved[i].camera = movedCamera(fits[i]);
    });
    stage.advance();
    double sum = 0;
    for (const double c : change) sum += std::sqrt(c);
    if (sum < kStill * static_cast<double>(views.size())) break;
  }

  const auto after = agreement(moved);
  for (std::size_t i = 0; i < views.size(); ++i) {
    AdjustedView& v = result.views[i];
    v.iou_before = before[i].iou, v.iou_after = after[i].iou;
    v.turned = degrees(length(Vec3{fits[i].motion[0], fits[i].motion[1], fits[i].motion[2]}));
    v.moved = distance(moved[i].camera.center(), views[i].camera.center());
    result.iou_before += before[i].iou / static_cast<double>(views.size());
    result.iou_after += after[i].iou / static_cast<double>(views.size());
  }
  result.kept = result.iou_after > result.iou_before;
  reporter.figure("adjust.iou.before", result.iou_before);
  reporter.figure("adjust.iou.after", result.iou_after);
  if (result.kept) {
    views = std::move(moved);
  } else {
    reporter.warn("the poses are as they were: moved within " + shortNumber(options.uncertainty) +
                  " pixels, the silhouettes agree no better with their hull");
  }
  return result;
}

}  // namespace srf
