#include "acquire/silhouette.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numeric>
#include <opencv2/imgproc.hpp>

#include "base/error.h"
#include "base/image_io.h"
#include "base/parallel.h"

namespace srf {
namespace {

constexpr int kLevels = 256;
using Histogram = std::array<double, kLevels>;

std::string sizeText(int width, int height) {
  return std::to_string(width) + " x " + std::to_string(height);
}

/// Faults that make a silhouette useless for carving; `mend` ends the sentence.
void requireObjectAndBackground(const Image8& mask, const std::string& file, const std::string& mend) {
  const auto inside = std::count_if(mask.data().begin(), mask.data().end(), [](std::uint8_t v) { return v >= 128; });
  if (inside == 0) throw badInput(file, "the silhouette is empty; " + mend);
  if (inside == static_cast<std::ptrdiff_t>(mask.data().size()))
    throw badInput(file, "the silhouette fills the whole picture; " + mend);
}

void requireSize(int width, int height, const Intrinsics& lens, const std::filesystem::path& file) {
  if (width != lens.width || height != lens.height)
    throw badInput(file.string(), "is " + sizeText(width, height) + ", its camera " +
                                      sizeText(lens.width, lens.height) + "; use the size that was calibrated");
}

/// Where the object may be: the projection of the capture's bounds, 2 pixels wider; all of the picture where they are
/// not told or reach behind the camera.
cv::Mat allowedRegion(const Capture& capture, const Camera<AcquisitionSpace>& camera) {
  const cv::Size size(camera.lens.width, camera.lens.height);
  const cv::Mat everywhere(size, CV_8U, cv::Scalar(255));
  if (!capture.bounds) return everywhere;
  // A grid over the box and not its corners alone: a lens bends the edges.
  constexpr int kSteps = 8;
  std::vector<cv::Point2f> points;
  const Vec3 low = capture.bounds->min, span = capture.bounds->max - low;
  for (int i = 0; i <= kSteps; ++i)
    for (int j = 0; j <= kSteps; ++j)
      for (int k = 0; k <= kSteps; ++k) {
        const Vec3 share = Vec3{1.0 * i, 1.0 * j, 1.0 * k} / kSteps;
        const auto p = camera.project(Point<AcquisitionSpace>(low + share * span));
        if (!p) return everywhere;
        points.emplace_back(static_cast<float>(std::clamp(p->pixel.x - 0.5, -1e5, 1e5)),
                            static_cast<float>(std::clamp(p->pixel.y - 0.5, -1e5, 1e5)));
      }
  std::vector<cv::Point2f> hull;
  cv::convexHull(points, hull);
  std::vector<cv::Point> polygon;
  for (const auto& p : hull) polygon.emplace_back(cvRound(p.x), cvRound(p.y));
  cv::Mat region = cv::Mat::zeros(size, CV_8U);
  cv::fillConvexPoly(region, polygon, 255);
  cv::dilate(region, region, cv::getStructuringElement(cv::MORPH_ELLIPSE, {5, 5}));
  return region;
}

/// Brightest channel over all photographs of a view: a shadow under one light is lit under another.
struct Brightness {
  cv::Mat linear;  ///< CV_32F
  bool is_float = false;
};

void addBrightness(Brightness& sum, const LoadedImage& image) {
  const ImageF& p = image.pixels;
  if (sum.linear.empty()) sum.linear = cv::Mat::zeros(p.height(), p.width(), CV_32F);
  sum.is_float |= image.is_float;
  const int colours = std::min(p.channels(), 3);
  for (int y = 0; y < p.height(); ++y) {
    float* to = sum.linear.ptr<float>(y);
    for (int x = 0; x < p.width(); ++x)
      for (int c = 0; c < colours; ++c) to[x] = std::fmax(to[x], p.at(x, y, c));  // fmax passes NaN by
  }
}

/// The value that 99.5 % of the region do not exceed: where a float picture has its white.
float whiteOf(const cv::Mat& value, const cv::Mat& region) {
  std::vector<float> inside;
  for (int y = 0; y < value.rows; ++y)
    for (int x = 0; x < value.cols; ++x)
      if (region.at<std::uint8_t>(y, x)) inside.push_back(value.at<float>(y, x));
  if (inside.empty()) return 1;
  const auto nth = inside.begin() + static_cast<std::ptrdiff_t>(0.995 * static_cast<double>(inside.size() - 1));
  std::nth_element(inside.begin(), nth, inside.end());
  return *nth > 0 && std::isfinite(*nth) ? *nth : 1;
}

/// Brightness in the 256 steps of sRGB; for a given threshold 255 where above it, else 0.
cv::Mat levelsOf(const Brightness& bright, const cv::Mat& region, Transfer transfer, std::optional<double> threshold) {
  cv::Mat levels(bright.linear.size(), CV_8U);
  const bool decoded = !bright.is_float && transfer == Transfer::srgb;
  const float white = bright.is_float && !threshold ? whiteOf(bright.linear, region) : 1;
  for (int y = 0; y < levels.rows; ++y)
    for (int x = 0; x < levels.cols; ++x) {
      const float v = bright.linear.at<float>(y, x);
      auto& level = levels.at<std::uint8_t>(y, x);
      if (threshold)
        level = (decoded ? srgbFromLinear(v) : v) > *threshold ? 255 : 0;
      else
        level = static_cast<std::uint8_t>(std::lround(255 * srgbFromLinear(std::min(1.f, v / white))));
    }
  return levels;
}

void addLevels(Histogram& counts, const cv::Mat& levels, const cv::Mat& region) {
  for (int y = 0; y < levels.rows; ++y)
    for (int x = 0; x < levels.cols; ++x)
      if (region.at<std::uint8_t>(y, x)) counts[levels.at<std::uint8_t>(y, x)] += 1;
}

/// Smoothed so that single levels do not make valleys.
Histogram smoothed(const Histogram& counts) {
  constexpr int kReach = 6;
  constexpr double kSigma = 2;  // levels
  Histogram out{};
  for (int i = 0; i < kLevels; ++i) {
    double sum = 0, weights = 0;
    for (int j = std::max(0, i - kReach); j <= std::min(kLevels - 1, i + kReach); ++j) {
      const double w = std::exp(-0.5 * (i - j) * (i - j) / (kSigma * kSigma));
      sum += w * counts[j];
      weights += w;
    }
    out[i] = sum / weights;
  }
  return out;
}

constexpr int kDark = kLevels / 3;  // a plain dark background lies below

/// The fullest level in [first, end).
int modeOf(const Histogram& h, int first, int end) {
  return static_cast<int>(std::max_element(h.begin() + first, h.begin() + end) - h.begin());
}

int medianOf(const Histogram& h) {
  double total = 0, below = 0;
  for (const double c : h) total += c;
  int level = 0;
  while (level + 1 < kLevels && (below += h[level]) < 0.5 * total) ++level;
  return level;
}

/// The level that best splits a histogram into two classes (Otsu 1979).
int otsu(const Histogram& h) {
  double total = 0, moment = 0;
  for (int i = 0; i < kLevels; ++i) total += h[i], moment += i * h[i];
  double below = 0, moment_below = 0, best = -1;
  int level = 0;
  for (int i = 0; i + 1 < kLevels; ++i) {
    below += h[i];
    moment_below += i * h[i];
    if (!(below > 0) || !(total - below > 0)) continue;
    const double d = moment_below / below - (moment - moment_below) / (total - below);
    if (const double between = below * (total - below) * d * d; between > best) best = between, level = i;
  }
  return level;
}

/// The foot of the background's peak in the histogram of the region that may hold the object: the darkest level beyond
/// the peak whose count has come down to a quarter above the floor of the valley before the object's peak. Otsu's level
/// lies half way up and takes the object's shadows away; the floor itself is flat and so a matter of chance.
int footOfBackground(const Histogram& region, const Histogram& background) {
  const Histogram h = smoothed(region);
  const int dark = modeOf(smoothed(background), 0, kDark);
  const int bright = modeOf(h, std::min(std::max(otsu(region), dark) + 1, kLevels - 1), kLevels);
  const double floor = *std::min_element(h.begin() + dark, h.begin() + bright + 1);
  double total = 0;
  for (const double c : region) total += c;
  int level = dark;
  while (level < bright && h[level] > 1.25 * floor + 1e-5 * total) ++level;
  return level;
}

/// Fills holes so small that they are specks of shadow; a carved ray through the object would be the worse mistake.
void fillSpecks(cv::Mat& mask, int largest) {
  cv::Mat outside = mask == 0, labels, stats, centers;
  cv::connectedComponentsWithStats(outside, labels, stats, centers, 4);
  for (int y = 0; y < mask.rows; ++y)
    for (int x = 0; x < mask.cols; ++x) {
      const int l = labels.at<int>(y, x);
      if (l == 0 || stats.at<int>(l, cv::CC_STAT_AREA) > largest) continue;
      const int left = stats.at<int>(l, cv::CC_STAT_LEFT), top = stats.at<int>(l, cv::CC_STAT_TOP);
      const bool at_border = left == 0 || top == 0 || left + stats.at<int>(l, cv::CC_STAT_WIDTH) == mask.cols ||
                             top + stats.at<int>(l, cv::CC_STAT_HEIGHT) == mask.rows;
      if (!at_border) mask.at<std::uint8_t>(y, x) = 255;
    }
}

void keepLargestComponent(cv::Mat& mask) {
  cv::Mat labels, stats, centers;
  const int count = cv::connectedComponentsWithStats(mask, labels, stats, centers, 8);
  int largest = 0, area = 0;
  for (int l = 1; l < count; ++l)
    if (stats.at<int>(l, cv::CC_STAT_AREA) > area) area = stats.at<int>(l, cv::CC_STAT_AREA), largest = l;
  mask = labels == largest;
  if (largest == 0) mask = 0;
  fillSpecks(mask, area / 200);
}

Image8 imageOf(const cv::Mat& mask) {
  Image8 image(mask.cols, mask.rows, 1);
  for (int y = 0; y < mask.rows; ++y) std::copy_n(mask.ptr<std::uint8_t>(y), mask.cols, image.row(y));
  return image;
}

/// What is surely background: beyond the bounds, or, where they tell nothing, the rim of the picture.
cv::Mat surelyBackground(const cv::Mat& region) {
  cv::Mat background = region == 0;
  if (cv::countNonZero(background) >= 100) return background;
  background = 255;
  const int rim = std::max(1, std::min(region.cols, region.rows) / 50);
  if (region.cols > 2 * rim && region.rows > 2 * rim)
    background(cv::Rect(rim, rim, region.cols - 2 * rim, region.rows - 2 * rim)) = 0;
  return background;
}

/// A view on its way: a finished mask, or the levels that are still to be split into object and background.
struct Draft {
  Image8 mask;
  cv::Mat levels, region;
};

Draft openView(const Capture& capture, const CaptureView& view, const SilhouetteOptions& options) {
  const Intrinsics& lens = view.camera.lens;
  Draft draft;
  if (!view.mask_file.empty()) {
    draft.mask = readMask(view.mask_file);
    requireSize(draft.mask.width(), draft.mask.height(), lens, view.mask_file);
    requireObjectAndBackground(draft.mask, view.mask_file.string(),
                               "draw the mask anew: white is the object, black the background");
    return draft;
  }
  if (view.photos.empty())
    throw badInput(capture.folder.string(), "view " + view.name + " has neither mask nor photograph; add one");
  Brightness bright;
  for (const Photo& photo : view.photos) {
    const LoadedImage image = readImage(photo.file, capture.integer_transfer);
    const ImageF& p = image.pixels;
    requireSize(p.width(), p.height(), lens, photo.file);
    if (image.has_alpha && bright.linear.empty()) {
      Image8 mask(p.width(), p.height(), 1);
      for (std::size_t i = 0; i < mask.data().size(); ++i)
        mask.data()[i] =
            static_cast<std::uint8_t>(std::lround(255 * std::fmin(1.f, std::fmax(0.f, p.data()[4 * i + 3]))));
      // Alpha of one value everywhere was never meant as a silhouette.
      const auto [low, high] = std::minmax_element(mask.data().begin(), mask.data().end());
      if (*low < 128 && *high >= 128) {
        draft.mask = std::move(mask);
        return draft;
      }
    }
    addBrightness(bright, image);
  }
  draft.region = allowedRegion(capture, view.camera);
  if (cv::countNonZero(draft.region) == 0)
    throw badInput(view.photos.front().file.string(),
                   "the capture's bounds lie outside the picture; mend the bounds or the view's pose");
  draft.levels = levelsOf(bright, draft.region, capture.integer_transfer, options.background_threshold);
  return draft;
}

/// The level above which the drafts are object; one for all views, whose light and background are the same.
int commonLevel(const std::vector<Draft>& drafts, const Capture& capture) {
  Histogram inside{}, outside{};
  for (const Draft& draft : drafts) {
    if (draft.levels.empty()) continue;
    addLevels(inside, draft.levels, draft.region);
    addLevels(outside, draft.levels, surelyBackground(draft.region));
  }
  if (medianOf(outside) >= kDark)
    throw badInput(capture.folder.string(),
                   "the background of its photographs is not dark; give masks, or photograph the object before black");
  return footOfBackground(inside, outside);
}

/// Segmentation against a plain dark background.
Image8 segment(const Draft& draft, int level, const CaptureView& view) {
  cv::Mat mask = draft.levels > level;
  mask &= draft.region;
  cv::morphologyEx(mask, mask, cv::MORPH_CLOSE, cv::getStructuringElement(cv::MORPH_RECT, {3, 3}));
  mask &= draft.region;
  keepLargestComponent(mask);
  Image8 image = imageOf(mask);
  requireObjectAndBackground(image, view.photos.front().file.string(),
                             "give a mask, or another threshold for the background");
  return image;
}

/// Masks of the views in `which`, in that order.
std::vector<Image8> makeSilhouettes(const Capture& capture, const std::vector<std::size_t>& which,
                                    const SilhouetteOptions& options, Reporter& reporter) {
  std::vector<Draft> drafts(which.size());
  Reporter::Stage stage(reporter, "silhouettes", which.size());
  parallelFor(which.size(), 1, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) {
      drafts[i] = openView(capture, capture.views[which[i]], options);
      stage.advance();
    }
  });
  const bool plain = std::any_of(drafts.begin(), drafts.end(), [](const Draft& d) { return !d.levels.empty(); });
  if (plain && !capture.bounds)
    reporter.warn(capture.folder.string() +
                  ": neither masks nor a bounding box: what stands out of the whole picture is " +
                  "taken as the object; give masks where it is wrong");
  int level = 128;
  if (plain && !options.background_threshold) {
    level = commonLevel(drafts, capture);
    reporter.figure("silhouette.threshold", level / (kLevels - 1.0));
  }
  parallelFor(drafts.size(), 1, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i)
      if (!drafts[i].levels.empty()) drafts[i].mask = segment(drafts[i], level, capture.views[which[i]]);
  });
  std::vector<Image8> masks;
  for (Draft& draft : drafts) masks.push_back(std::move(draft.mask));
  return masks;
}

}  // namespace

Image8 silhouette(const Capture& capture, ViewId view, const SilhouetteOptions& options, Reporter& reporter) {
  return makeSilhouettes(capture, {view.value}, options, reporter).front();
}

std::vector<SilhouetteView> silhouettes(const Capture& capture, const SilhouetteOptions& options, Reporter& reporter) {
  std::vector<std::size_t> all(capture.views.size());
  std::iota(all.begin(), all.end(), std::size_t{0});
  auto masks = makeSilhouettes(capture, all, options, reporter);
  std::vector<SilhouetteView> views;
  for (const std::size_t i : all)
    views.push_back({capture.views[i].name, capture.views[i].camera, std::move(masks[i])});
  return views;
}

}  // namespace srf
