#include "acquire/silhouette_agreement.h"

#include <algorithm>
#include <cmath>
#include <opencv2/imgproc.hpp>

#include "base/error.h"
#include "base/image_io.h"
#include "base/parallel.h"
#include "base/ray_scene.h"
#include "base/text.h"

namespace srf {
namespace {

using Scene = RayScene<AcquisitionSpace>;

constexpr int kHullCells = 96;

cv::Mat matOf(const Image8& image) {
  return {image.height(), image.width(), CV_8UC(image.channels()), const_cast<std::uint8_t*>(image.data().data())};
}
Image8 imageOf(const cv::Mat& mat) {
  Image8 image(mat.cols, mat.rows, mat.channels());
  for (int y = 0; y < mat.rows; ++y)
    std::copy_n(mat.ptr<std::uint8_t>(y), static_cast<std::size_t>(mat.cols) * mat.channels(), image.row(y));
  return image;
}

Image8 project(const Scene& scene, const Camera<AcquisitionSpace>& camera) {
  Image8 out(camera.lens.width, camera.lens.height, 1);
  std::vector<Ray<AcquisitionSpace>> rays;
  std::vector<int> columns;
  std::vector<TriangleHit> hits;
  for (int y = 0; y < out.height(); ++y) {
    rays.clear(), columns.clear();
    for (int x = 0; x < out.width(); ++x)
      if (const auto ray = camera.ray({x + 0.5, y + 0.5})) rays.push_back(*ray), columns.push_back(x);
    hits.resize(rays.size());
    scene.intersect(rays, hits);
    for (std::size_t i = 0; i < hits.size(); ++i) out.at(columns[i], y) = hits[i].hit() ? 255 : 0;
  }
  return out;
}

Camera<AcquisitionSpace> reduced(const Camera<AcquisitionSpace>& camera, int longest) {
  const double scale = std::min(1.0, double(longest) / std::max(camera.lens.width, camera.lens.height));
  const auto side = [&](int pixels) { return std::max(1, static_cast<int>(std::lround(pixels * scale))); };
  return {resized(camera.lens, side(camera.lens.width), side(camera.lens.height)), camera.pose};
}

cv::Mat disc(int radius) {
  return cv::getStructuringElement(cv::MORPH_ELLIPSE, {2 * radius + 1, 2 * radius + 1});
}

// The hull that a few views may be overruled in: what the others allow.
AcquisitionMesh hullOfOthers(const std::vector<SilhouetteView>& views, int overruled,
                             const std::optional<Box<AcquisitionSpace>>& bounds) {
  HullOptions options;
  options.resolution = kHullCells;
  options.tolerance = std::clamp(overruled, 1, std::max(1, std::min<int>(15, static_cast<int>(views.size()) / 3)));
  options.exclude_outliers = false;
  options.bounds = bounds;
  return carveVisualHull(views, options, Reporter::silent()).mesh;
}

std::string percent(double share) {
  return fixedNumber(100 * share, 1) + " %";
}

// The share of a mask up to which views differ from the hull as most of them do.
double usualBelow(std::vector<double> shares) {
  constexpr double kLeast = 0.01, kSpreads = 2;
  const auto median = [](std::vector<double>& values) {
    std::nth_element(values.begin(), values.begin() + values.size() / 2, values.end());
    return values[values.size() / 2];
  };
  const double usual = median(shares);
  for (double& s : shares) s = std::fabs(s - usual);
  return usual + std::max(kLeast, kSpreads * 1.4826 * median(shares));
}

double agreement(const Image8& a, const Image8& b) {
  std::size_t both = 0, either = 0;
  for (std::size_t i = 0; i < a.data().size(); ++i) {
    const bool x = a.data()[i] >= 128, y = b.data()[i] >= 128;
    both += x && y, either += x || y;
  }
  return either ? double(both) / double(either) : 1;
}

}  // namespace

Intrinsics resized(const Intrinsics& lens, int width, int height) {
  Intrinsics out = lens;
  const double sx = double(width) / lens.width, sy = double(height) / lens.height;
  out.width = width, out.height = height;
  out.fl_x *= sx, out.cx *= sx, out.skew *= sx;
  out.fl_y *= sy, out.cy *= sy;
  return out;
}

Image8 projectedMesh(const AcquisitionMesh& mesh, const Camera<AcquisitionSpace>& camera) {
  return project(Scene::ofTriangles(mesh.positions, mesh.triangles), camera);
}

std::vector<MendedView> mendSilhouettes(std::vector<SilhouetteView>& views,
                                        const std::optional<Box<AcquisitionSpace>>& bounds, Reporter& reporter) {
  constexpr int kLongest = 640, kRounds = 5;
  constexpr int kGap = 2, kLoose = 2;            // pixels: half width of the least gap; of the hull's looseness
  constexpr double kStill = 5e-4, kTold = 0.02;  // shares of a mask: the end of the rounds, and what is told
  std::vector<MendedView> mended(views.size());
  std::vector<double> before(views.size());
  for (std::size_t i = 0; i < views.size(); ++i) {
    mended[i].name = views[i].name;
    before[i] = cv::countNonZero(matOf(views[i].mask) >= 128);
  }
  if (views.size() < 4) return mended;  // too few to overrule one
  Reporter::Stage stage(reporter, "mend silhouettes", kRounds);
  for (int round = 0; round < kRounds; ++round) {
    const AcquisitionMesh hull = hullOfOthers(views, std::max<int>(1, static_cast<int>(views.size()) / 24), bounds);
    const Scene scene = Scene::ofTriangles(hull.positions, hull.triangles);
    struct Faults {
      cv::Mat gap, excess;  // 255 where the mask and the hull disagree
      double missing = 0, beside = 0;
    };
    std::vector<Faults> faults(views.size());
    parallelFor(views.size(), 1, [&](std::size_t i, std::size_t) {
      const Camera<AcquisitionSpace> camera = reduced(views[i].camera, kLongest);
      const Image8 image = project(scene, camera);
      const cv::Mat others = matOf(image);
      cv::Mat own, deep, wide;
      cv::resize(matOf(views[i].mask), own, others.size(), 0, 0, cv::INTER_AREA);
      own = own >= 128;
      Faults& f = faults[i];
      f.gap = others & ~own;
      cv::morphologyEx(f.gap, deep, cv::MORPH_OPEN, disc(kGap));
      cv::dilate(deep, deep, disc(kGap + 1));
      f.gap &= deep;
      cv::dilate(others, wide, disc(kLoose));
      f.excess = own & ~wide;
      cv::morphologyEx(f.excess, f.excess, cv::MORPH_OPEN, disc(1));
      const double area = std::max(1, cv::countNonZero(own));
      f.missing = cv::countNonZero(f.gap) / area;
      f.beside = cv::countNonZero(f.excess) / area;
    });
    // The hull is loose by as much as most views say; only what stands out is a fault of the mask.
    std::vector<double> missing, beside, changed(views.size(), 0);
    for (const Faults& f : faults) missing.push_back(f.missing), beside.push_back(f.beside);
    const double most_missing = usualBelow(missing), most_beside = usualBelow(beside);
    parallelFor(views.size(), 1, [&](std::size_t i, std::size_t) {
      Image8& mask = views[i].mask;
      Faults& f = faults[i];
      const auto change = [&](const cv::Mat& where, std::uint8_t value) {
        cv::Mat whole;
        cv::resize(where, whole, {mask.width(), mask.height()}, 0, 0, cv::INTER_NEAREST);
        double count = 0;
        for (int y = 0; y < mask.height(); ++y)
          for (int x = 0; x < mask.width(); ++x)
            if (whole.at<std::uint8_t>(y, x) && mask.at(x, y) != value) {
              count += (mask.at(x, y) >= 128) != (value >= 128);
              mask.at(x, y) = value;
            }
        return count / std::max(1.0, before[i]);
      };
      if (f.missing > most_missing) mended[i].filled += changed[i] = change(f.gap, 255);
      if (f.beside > most_beside) {
        const double removed = change(f.excess, 0);
        mended[i].removed += removed, changed[i] += removed;
      }
    });
    stage.advance();
    if (*std::max_element(changed.begin(), changed.end()) < kStill) break;
  }
  for (const MendedView& m : mended) {
    if (m.filled > kTold)
      reporter.warn("view " + m.name + ": " + percent(m.filled) +
                    " of its silhouette was missing where the other views have the object, and is filled; look at its "
                    "mask, it may be shadow as dark as the background");
    if (m.removed > kTold)
      reporter.warn("view " + m.name + ": " + percent(m.removed) +
                    " of its silhouette lies where the other views have nothing, and is taken away; look at its mask");
    reporter.count("silhouettes.mended", m.filled > kTold || m.removed > kTold);
  }
  return mended;
}

std::vector<SilhouetteView> grabCutSilhouettes(const Capture& capture, Reporter& reporter) {
  constexpr int kLongest = 512, kRounds = 6, kFirst = 4, kLater = 2;
  constexpr int kWide = 3, kDeep = 5;  // pixels about the other views' hull: surely background; probably object
  constexpr double kAgreed = 0.998;
  const std::size_t count = capture.views.size();
  struct Work {
    cv::Mat picture, labels;
  };
  std::vector<Work> work(count);
  std::vector<SilhouetteView> views(count);

  const auto cut = [&](std::size_t i, int iterations) {
    Work& w = work[i];
    const cv::Mat object = (w.labels == cv::GC_FGD) | (w.labels == cv::GC_PR_FGD);
    const std::string& file = capture.views[i].photos.front().file.string();
    const int inside = cv::countNonZero(object);
    if (inside == 0) throw badInput(file, "GrabCut finds no object; give a mask, or bounds that fit the object");
    if (inside == object.rows * object.cols)
      throw badInput(file, "the bounds fill the whole picture, so GrabCut sees no background; give a mask");
    cv::setRNGSeed(1);  // of the colour clusters: the same masks every time
    cv::Mat background, foreground;
    cv::grabCut(w.picture, w.labels, cv::Rect(), background, foreground, iterations, cv::GC_INIT_WITH_MASK);
    cv::Mat mask = ((w.labels & 1) * 255);
    const Intrinsics& lens = capture.views[i].camera.lens;
    cv::resize(mask, mask, {lens.width, lens.height}, 0, 0, cv::INTER_LINEAR);
    mask = mask >= 128;
    Image8 out = largestPart(imageOf(mask));
    if (std::all_of(out.data().begin(), out.data().end(), [](std::uint8_t v) { return v == 0; }))
      throw badInput(file, "GrabCut finds no object; give a mask, or bounds that fit the object");
    return out;
  };

  Reporter::Stage stage(reporter, "grab-cut silhouettes", count * (kRounds + 1));
  parallelFor(count, 1, [&](std::size_t i, std::size_t) {
    const CaptureView& view = capture.views[i];
    const Camera<AcquisitionSpace> small = reduced(view.camera, kLongest);
    const cv::Size size(small.lens.width, small.lens.height);
    cv::resize(matOf(displayImage(meanPhotograph(capture, view))), work[i].picture, size, 0, 0, cv::INTER_AREA);
    cv::Mat region;
    if (capture.bounds) {
      cv::resize(matOf(boundsRegion(capture, view.camera)), region, size, 0, 0, cv::INTER_NEAREST);
    } else {
      region = cv::Mat::zeros(size, CV_8U);
      const int rim_x = size.width / 10, rim_y = size.height / 10;
      region(cv::Rect(rim_x, rim_y, size.width - 2 * rim_x, size.height - 2 * rim_y)) = 255;
    }
    work[i].labels = cv::Mat(size, CV_8U, cv::Scalar(cv::GC_BGD));
    work[i].labels.setTo(cv::GC_PR_FGD, region);
    views[i] = {view.name, view.camera, cut(i, kFirst)};
    stage.advance();
  });
  int rounds = 0;
  for (; rounds < kRounds && count >= 4; ++rounds) {
    const AcquisitionMesh hull = hullOfOthers(views, std::max<int>(1, static_cast<int>(count) / 8), capture.bounds);
    const Scene scene = Scene::ofTriangles(hull.positions, hull.triangles);
    std::vector<double> agreed(count);
    parallelFor(count, 1, [&](std::size_t i, std::size_t) {
      const Image8 image = project(scene, reduced(views[i].camera, kLongest));
      cv::Mat wide, deep;
      cv::dilate(matOf(image), wide, disc(kWide));
      cv::erode(matOf(image), deep, disc(kDeep));
      cv::Mat& labels = work[i].labels;
      labels.setTo(cv::GC_BGD, ~wide);
      // What was surely background only because of the last hull may be object now.
      cv::Mat open = wide & (labels == cv::GC_BGD);
      labels.setTo(cv::GC_PR_BGD, open);
      labels.setTo(cv::GC_PR_FGD, deep);
      if (cv::countNonZero(deep) == 0) labels.setTo(cv::GC_PR_FGD, matOf(image));
      Image8 mask = cut(i, kLater);
      agreed[i] = agreement(mask, views[i].mask);
      views[i].mask = std::move(mask);
      stage.advance();
    });
    double sum = 0;
    for (const double a : agreed) sum += a;
    if (sum >= kAgreed * static_cast<double>(count)) break;
  }
  reporter.figure("silhouette.grabcut_rounds", rounds);
  parallelFor(count, 1, [&](std::size_t i, std::size_t) {
    views[i].mask = softEdges(views[i].mask, meanPhotograph(capture, capture.views[i]), nullptr);
  });
  return views;
}

}  // namespace srf
