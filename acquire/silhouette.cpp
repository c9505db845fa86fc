#include "acquire/silhouette.h"

#include <algorithm>
#include <array>
#include <atomic>
#include <cmath>
#include <functional>
#include <map>
#include <numeric>
#include <opencv2/imgproc.hpp>
#include <set>

#include "acquire/silhouette_agreement.h"
#include "base/error.h"
#include "base/image_io.h"
#include "base/parallel.h"

namespace srf {
namespace {

namespace fs = std::filesystem;

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

// --- A clean plate, a screen of one colour ---------------------------------------------------------------------------

cv::Mat matOf(const ImageF& image) {
  return {image.height(), image.width(), CV_32FC(image.channels()), const_cast<float*>(image.data().data())};
}

void addPhotograph(ImageF& sum, const ImageF& p) {
  if (sum.empty()) sum = ImageF(p.width(), p.height(), 3);
  for (int y = 0; y < p.height(); ++y)
    for (int x = 0; x < p.width(); ++x)
      for (int c = 0; c < 3; ++c) {
        const float value = p.at(x, y, p.channels() < 3 ? 0 : c);
        if (std::isfinite(value)) sum.at(x, y, c) += value;
      }
}

fs::path firstThat(const std::vector<fs::path>& candidates) {
  std::error_code code;
  for (const fs::path& file : candidates)
    if (fs::is_regular_file(file, code)) return file;
  return {};
}

/// The picture of the empty place that belongs to a photograph.
fs::path plateOf(const fs::path& plates, const Capture& capture, const CaptureView& view, const Photo& photo) {
  std::error_code code;
  if (!fs::is_directory(plates, code)) return plates;
  const fs::path extension = photo.file.extension();
  const fs::path found =
      firstThat({plates / photo.file.lexically_normal().lexically_relative(capture.folder.lexically_normal()),
                 plates / photo.file.filename(), plates / (view.name + extension.string())});
  if (!found.empty()) return found;
  throw badInput(plates.string(), "holds no picture for " + photo.file.string() + "; name it " +
                                      photo.file.filename().string() + ", or give one file for all");
}

/// The mean of the plates of a view's photographs.
ImageF meanPlate(const fs::path& plates, const Capture& capture, const CaptureView& view) {
  std::vector<fs::path> files;
  for (const Photo& photo : view.photos) files.push_back(plateOf(plates, capture, view, photo));
  if (std::set<fs::path>(files.begin(), files.end()).size() == 1) files.resize(1);
  ImageF sum;
  for (const fs::path& file : files) {
    const ImageF pixels = readImage(file, capture.integer_transfer).pixels;
    requireSize(pixels.width(), pixels.height(), view.camera.lens, file);
    addPhotograph(sum, pixels);
  }
  for (float& v : sum.data()) v /= static_cast<float>(files.size());
  return sum;
}

float encoded(float linear, float white) {
  return srgbFromLinear(std::min(1.f, std::max(0.f, linear / white)));
}

/// How far two pictures lie apart, in the 256 steps of sRGB.
cv::Mat differenceLevels(const ImageF& a, const ImageF& b, float white) {
  cv::Mat levels(a.height(), a.width(), CV_8U);
  for (int y = 0; y < levels.rows; ++y)
    for (int x = 0; x < levels.cols; ++x) {
      float most = 0;
      for (int c = 0; c < 3; ++c)
        most = std::max(most, std::fabs(encoded(a.at(x, y, c), white) - encoded(b.at(x, y, c), white)));
      levels.at<std::uint8_t>(y, x) = static_cast<std::uint8_t>(std::lround(255 * most));
    }
  return levels;
}

/// The screen under more or less light than in the key: the nearest to each pixel's colour. Not down to black, or every
/// black object would be screen.
ImageF screenBehind(const ImageF& picture, const Vec3& key) {
  constexpr double kLeast = 0.35, kMost = 1.5;
  ImageF screen(picture.width(), picture.height(), 3);
  for (int y = 0; y < picture.height(); ++y)
    for (int x = 0; x < picture.width(); ++x) {
      const Vec3 colour{picture.at(x, y, 0), picture.at(x, y, 1), picture.at(x, y, 2)};
      const double light = std::clamp(dot(colour, key) / dot(key, key), kLeast, kMost);
      for (int c = 0; c < 3; ++c) screen.at(x, y, c) = static_cast<float>(light * key[c]);
    }
  return screen;
}

/// The median colour of what is surely background, linear.
Vec3 keyOf(const ImageF& picture, const cv::Mat& background, const CaptureView& view) {
  Vec3 key;
  for (int c = 0; c < 3; ++c) {
    std::vector<float> values;
    for (int y = 0; y < picture.height(); ++y)
      for (int x = 0; x < picture.width(); ++x)
        if (background.at<std::uint8_t>(y, x)) values.push_back(picture.at(x, y, c));
    const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
    std::nth_element(values.begin(), middle, values.end());
    key[c] = *middle;
  }
  if (!(maxComponent(key) > 0) || minComponent(key) > 0.6 * maxComponent(key))
    throw badInput(
        view.photos.front().file.string(),
        "what surrounds the object is no screen of a strong colour; name it (--chroma-key '#00b140'), or give "
        "masks");
  return key;
}

/// A view on its way: a finished mask, or the levels that are still to be split into object and background.
struct Draft {
  Image8 mask;
  cv::Mat levels, region;
  std::string note;  ///< what is odd about its mask file
};

/// The photograph and what lies behind the object in it.
struct Backed {
  ImageF picture, behind;
};
Backed backedPicture(const Capture& capture, const CaptureView& view, const cv::Mat& region,
                     const SilhouetteOptions& options) {
  Backed out{meanPhotograph(capture, view), {}};
  if (options.source == SilhouetteSource::clean_plate) {
    out.behind = meanPlate(options.clean_plate, capture, view);
  } else {
    Vec3 key = options.key.value_or(Vec3{});
    for (int c = 0; c < 3; ++c) key[c] = linearFromSrgb(static_cast<float>(key[c]));
    if (!options.key) key = keyOf(out.picture, surelyBackground(region), view);
    out.behind = screenBehind(out.picture, key);
  }
  return out;
}

Draft openBackedView(const Capture& capture, const CaptureView& view, const SilhouetteOptions& options) {
  Draft draft;
  draft.region = allowedRegion(capture, view.camera);
  const Backed backed = backedPicture(capture, view, draft.region, options);
  ImageF brightest(backed.picture.width(), backed.picture.height(), 1);
  for (std::size_t i = 0; i < brightest.data().size(); ++i)
    for (int c = 0; c < 3; ++c) brightest.data()[i] = std::max(brightest.data()[i], backed.picture.data()[3 * i + c]);
  const float white = whiteOf(matOf(brightest), cv::Mat(brightest.height(), brightest.width(), CV_8U, cv::Scalar(255)));
  draft.levels = differenceLevels(backed.picture, backed.behind, white);
  if (options.background_threshold)
    draft.levels = (draft.levels > static_cast<int>(255 * *options.background_threshold));
  return draft;
}

Draft openView(const Capture& capture, const CaptureView& view, const SilhouetteOptions& options) {
  const Intrinsics& lens = view.camera.lens;
  Draft draft;
  if (options.source != SilhouetteSource::automatic) return openBackedView(capture, view, options);
  if (!view.mask_file.empty()) {
    draft.mask = readMaskFile(view.mask_file, options.polarity, draft.note);
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
int commonLevel(const std::vector<Draft>& drafts, const Capture& capture, const SilhouetteOptions& options) {
  Histogram inside{}, outside{};
  for (const Draft& draft : drafts) {
    if (draft.levels.empty()) continue;
    addLevels(inside, draft.levels, draft.region);
    addLevels(outside, draft.levels, surelyBackground(draft.region));
  }
  if (medianOf(outside) >= kDark && options.source == SilhouetteSource::clean_plate)
    throw badInput(options.clean_plate.string(),
                   "differs from the photographs where the object is not; take it with the same camera, exposure and "
                   "lights");
  if (medianOf(outside) >= kDark && options.source == SilhouetteSource::chroma_key)
    throw badInput(capture.folder.string(),
                   "the photographs' surroundings have not the colour of the key; give another, or masks");
  if (medianOf(outside) >= kDark)
    throw badInput(capture.folder.string(),
                   "the background of its photographs is not dark; give masks, or photograph the object before black");
  return footOfBackground(inside, outside);
}

/// Segmentation against a plain dark background, or against a known one: the levels then tell the difference.
Image8 segment(const Draft& draft, int level, const Capture& capture, const CaptureView& view,
               const SilhouetteOptions& options) {
  cv::Mat mask = draft.levels > level;
  mask &= draft.region;
  cv::morphologyEx(mask, mask, cv::MORPH_CLOSE, cv::getStructuringElement(cv::MORPH_RECT, {3, 3}));
  mask &= draft.region;
  keepLargestComponent(mask);
  Image8 image = imageOf(mask);
  requireObjectAndBackground(image, view.photos.front().file.string(),
                             "give a mask, or another threshold for the background");
  if (options.source == SilhouetteSource::automatic) return image;
  const Backed backed = backedPicture(capture, view, draft.region, options);
  return softEdges(image, backed.picture, &backed.behind);
}

/// Runs body(i) for each view, with no more photographs open at a time than fit into the memory.
void forEachView(const Capture& capture, const std::vector<std::size_t>& which, const SilhouetteOptions& options,
                 const std::function<void(std::size_t)>& body) {
  // Of a photograph: as it is read, as floats, its mean, its brightness and what is made of them.
  constexpr std::size_t kBytesPerPixel = 64;
  std::size_t pixels = 1;
  for (const std::size_t i : which)
    pixels = std::max(pixels, static_cast<std::size_t>(capture.views[i].camera.lens.width) *
                                  static_cast<std::size_t>(capture.views[i].camera.lens.height));
  const std::size_t together = std::max<std::size_t>(1, options.memory_bytes / (kBytesPerPixel * pixels));
  const std::size_t lanes = std::min<std::size_t>(together, static_cast<std::size_t>(threadCount()));
  std::atomic<std::size_t> next{0};
  parallelFor(lanes, 1, [&](std::size_t, std::size_t) {
    for (std::size_t i; (i = next++) < which.size();) body(i);
  });
}

/// Mask files that are not what everybody expects, in one sentence.
void tellNotes(const Capture& capture, const std::vector<std::size_t>& which, const std::vector<Draft>& drafts,
               Reporter& reporter) {
  std::map<std::string, std::pair<std::size_t, std::string>> notes;  // note: how many, the first file
  for (std::size_t i = 0; i < which.size(); ++i) {
    if (drafts[i].note.empty()) continue;
    auto& [count, first] = notes[drafts[i].note];
    if (count++ == 0) first = capture.views[which[i]].mask_file.string();
  }
  for (const auto& [note, of] : notes) {
    reporter.count("masks.reinterpreted", of.first);
    reporter.warn(of.second + (of.first > 1 ? " and " + std::to_string(of.first - 1) + " masks more: each " : ": ") +
                  note + " (--mask-polarity to say otherwise)");
  }
}

/// Masks of the views in `which`, in that order.
std::vector<Image8> makeSilhouettes(const Capture& capture, const std::vector<std::size_t>& which,
                                    const SilhouetteOptions& options, Reporter& reporter) {
  std::vector<Draft> drafts(which.size());
  Reporter::Stage stage(reporter, "silhouettes", which.size());
  forEachView(capture, which, options, [&](std::size_t i) {
    drafts[i] = openView(capture, capture.views[which[i]], options);
    stage.advance();
  });
  tellNotes(capture, which, drafts, reporter);
  const bool plain = std::any_of(drafts.begin(), drafts.end(), [](const Draft& d) { return !d.levels.empty(); });
  if (plain && !capture.bounds)
    reporter.warn(capture.folder.string() +
                  ": neither masks nor a bounding box: what stands out of the whole picture is " +
                  "taken as the object; give masks where it is wrong");
  int level = 128;
  if (plain && !options.background_threshold) {
    level = commonLevel(drafts, capture, options);
    reporter.figure("silhouette.threshold", level / (kLevels - 1.0));
  }
  forEachView(capture, which, options, [&](std::size_t i) {
    if (drafts[i].levels.empty()) return;
    drafts[i].mask = segment(drafts[i], level, capture, capture.views[which[i]], options);
    drafts[i].levels = drafts[i].region = cv::Mat();
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
  if (options.source == SilhouetteSource::grab_cut) return grabCutSilhouettes(capture, reporter);
  std::vector<std::size_t> all(capture.views.size());
  std::iota(all.begin(), all.end(), std::size_t{0});
  auto masks = makeSilhouettes(capture, all, options, reporter);
  std::vector<SilhouetteView> views;
  for (const std::size_t i : all)
    views.push_back({capture.views[i].name, capture.views[i].camera, std::move(masks[i])});
  if (options.mend) mendSilhouettes(views, capture.bounds, reporter);
  return views;
}

Image8 boundsRegion(const Capture& capture, const Camera<AcquisitionSpace>& camera) {
  return imageOf(allowedRegion(capture, camera));
}

ImageF meanPhotograph(const Capture& capture, const CaptureView& view) {
  if (view.photos.empty())
    throw badInput(capture.folder.string(),
                   "view " + view.name + " has no photograph to find its silhouette in; add one");
  ImageF sum;
  for (const Photo& photo : view.photos) {
    const ImageF pixels = readImage(photo.file, capture.integer_transfer).pixels;
    requireSize(pixels.width(), pixels.height(), view.camera.lens, photo.file);
    addPhotograph(sum, pixels);
  }
  for (float& v : sum.data()) v /= static_cast<float>(view.photos.size());
  return sum;
}

Image8 largestPart(const Image8& mask) {
  cv::Mat part(mask.height(), mask.width(), CV_8U, const_cast<std::uint8_t*>(mask.data().data()));
  part = part >= 128;
  keepLargestComponent(part);
  return imageOf(part);
}

Image8 softEdges(const Image8& mask, const ImageF& photograph, const ImageF* plate) {
  constexpr int kBand = 2, kBeside = 9;  // pixels: half width of the edge; window in which colours are taken
  const cv::Mat hard(mask.height(), mask.width(), CV_8U, const_cast<std::uint8_t*>(mask.data().data()));
  const cv::Mat picture = matOf(photograph),
                around = cv::getStructuringElement(cv::MORPH_ELLIPSE, {2 * kBand + 1, 2 * kBand + 1});
  cv::Mat inner, outer, object = hard >= 128;
  cv::erode(object, inner, around);
  cv::dilate(object, outer, around);
  outer = ~outer;
  // Mean colours of what is surely inside or outside, within the window.
  const auto meanOver = [&](const cv::Mat& where, cv::Mat& weight) {
    cv::Mat share, colours;
    where.convertTo(share, CV_32F, 1.0 / 255);
    cv::boxFilter(share, weight, CV_32F, {kBeside, kBeside}, {-1, -1}, false);
    cv::Mat three;
    cv::merge(std::vector<cv::Mat>{share, share, share}, three);
    cv::boxFilter(picture.mul(three), colours, CV_32F, {kBeside, kBeside}, {-1, -1}, false);
    return colours;
  };
  cv::Mat inner_weight, outer_weight;
  const cv::Mat inner_sum = meanOver(inner, inner_weight), outer_sum = meanOver(outer, outer_weight);
  Image8 out = mask;
  for (int y = 0; y < mask.height(); ++y)
    for (int x = 0; x < mask.width(); ++x) {
      if (inner.at<std::uint8_t>(y, x) || outer.at<std::uint8_t>(y, x)) continue;
      const float w_in = inner_weight.at<float>(y, x), w_out = outer_weight.at<float>(y, x);
      if (!(w_in > 0) || !(plate || w_out > 0)) continue;  // thinner than the band: as it was
      const cv::Vec3f &in = inner_sum.at<cv::Vec3f>(y, x), &beside = outer_sum.at<cv::Vec3f>(y, x);
      Vec3 from, along, colour;
      for (int c = 0; c < 3; ++c) {
        from[c] = plate ? plate->at(x, y, c) : beside[c] / w_out;
        along[c] = in[c] / w_in - from[c];
        colour[c] = photograph.at(x, y, c) - from[c];
      }
      const double length2 = dot(along, along), brightness2 = dot(from, from) + dot(along + from, along + from);
      if (!(length2 > 1e-3 * brightness2)) continue;  // object and background of one colour
      const double share = std::clamp(dot(colour, along) / length2, 0.0, 1.0);
      if (std::isfinite(share)) out.at(x, y) = static_cast<std::uint8_t>(std::lround(255 * share));
    }
  return out;
}

}  // namespace srf
