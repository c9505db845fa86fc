#include "acquire/develop.h"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <opencv2/photo.hpp>

#include "base/error.h"
#include "base/files.h"
#include "base/numeric.h"
#include "base/parallel.h"

namespace srf {
namespace {

constexpr int kCurve = 256;

void requireSize(const ImageF& image, int width, int height, const std::string& what) {
  if (image.width() != width || image.height() != height)
    throw badInput(what, "is " + std::to_string(image.width()) + " x " + std::to_string(image.height()) +
                             " pixels, expected " + std::to_string(width) + " x " + std::to_string(height) +
                             " as the photographs have");
}

bool isIgnored(const float* pixel, int channels, const IgnoredColour& ignored) {
  if (!ignored) return false;
  for (int c = 0; c < 3; ++c)
    if (std::fabs(pixel[channels < 3 ? 0 : c] - (*ignored)[c]) > 0.5f / 255) return false;
  return true;
}

// Falls from 1 to 0 over the last tenth below saturation, so that no seam shows where an exposure drops out.
double flank(double value, double saturated) {
  return 1 - smoothstep(0.9 * saturated, saturated, value);
}

// Debevec and Malik's hat over the usable range.
double hat(double value, double black, double saturated) {
  const double middle = 0.5 * (black + saturated);
  const double height = value <= middle ? value - black : saturated - value;
  return std::max(0.0, height / (middle - black));
}

}  // namespace

CameraResponse CameraResponse::linear() {
  return {};
}

CameraResponse CameraResponse::srgb() {
  CameraResponse response;
  std::vector<float> curve(4096);
  for (std::size_t i = 0; i < curve.size(); ++i)
    curve[i] = linearFromSrgb(static_cast<float>(i) / static_cast<float>(curve.size() - 1));
  response.curves_ = {curve, curve, curve};
  return response;
}

CameraResponse CameraResponse::measured(const std::array<std::vector<double>, 3>& curves) {
  CameraResponse response;
  for (int c = 0; c < 3; ++c) {
    SRF_CHECK(curves[c].size() == kCurve);
    std::vector<float>& to = response.curves_[c];
    to.resize(kCurve);
    double largest = 0;
    for (int i = 0; i < kCurve; ++i) to[i] = static_cast<float>(largest = std::max(largest, curves[c][i]));
  }
  return response;
}

void CameraResponse::write(const std::filesystem::path& file) const {
  std::string text = "# exposure for each of 256 encoded values, 0 to 1: red, green, blue\n";
  for (int i = 0; i < kCurve; ++i) {
    char line[120];
    const float value = static_cast<float>(i) / (kCurve - 1);
    std::snprintf(line, sizeof line, "%d,%.9g,%.9g,%.9g\n", i, exposure(0, value), exposure(1, value),
                  exposure(2, value));
    text += line;
  }
  writeTextFile(file, text);
}

CameraResponse measureResponse(const std::vector<Exposure>& bracket, const IgnoredColour& ignored) {
  const auto wrong = [](const std::string& what) { return badInput("camera response", what); };
  if (bracket.size() < 2) throw wrong("needs two exposures of one picture or more");
  const int w = bracket[0].pixels.width(), h = bracket[0].pixels.height(), channels = bracket[0].pixels.channels();
  double least = INFINITY, most = 0;
  for (const Exposure& e : bracket) {
    requireSize(e.pixels, w, h, "an exposure");
    if (e.is_linear) throw wrong("is that of linear files: there is nothing to measure");
    least = std::min(least, e.amount), most = std::max(most, e.amount);
  }
  if (!(most > 1.2 * least)) throw wrong("needs exposures that differ by more than a fifth");

  // Pixels that say something: within the range in half of the exposures or more, and even about them, since exposures
  // never lie on each other exactly.
  struct Candidate {
    double brightness;
    int x, y;
  };
  std::vector<Candidate> candidates;
  const int step = std::max(1, std::min(w, h) / 200);
  for (int y = 1; y + 1 < h; y += step)
    for (int x = 1; x + 1 < w; x += step) {
      double brightness = 0, uneven = 0;
      std::size_t usable = 0;
      bool any_ignored = false;
      for (const Exposure& e : bracket) {
        const float* p = &e.pixels.at(x, y);
        any_ignored = any_ignored || isIgnored(p, channels, ignored);
        double low = 1, high = 0;
        for (int c = 0; c < channels; ++c) {
          low = std::min<double>(low, p[c]), high = std::max<double>(high, p[c]);
          brightness += p[c];
          uneven = std::max<double>(uneven, std::fabs(e.pixels.at(x + 1, y, c) - e.pixels.at(x - 1, y, c)));
          uneven = std::max<double>(uneven, std::fabs(e.pixels.at(x, y + 1, c) - e.pixels.at(x, y - 1, c)));
        }
        usable += low > 0.02 && high < 0.98;
      }
      if (!any_ignored && 2 * usable >= bracket.size() && uneven < 0.1) candidates.push_back({brightness, x, y});
    }
  constexpr int kSide = 14;  // OpenCV takes a square grid of samples: a square image of just those pixels
  if (candidates.size() < kSide * kSide)
    throw wrong("has " + std::to_string(candidates.size()) + " usable pixels, expected " +
                std::to_string(kSide * kSide) + ": even parts that are neither black nor white in most exposures");
  std::stable_sort(candidates.begin(), candidates.end(),
                   [](const Candidate& a, const Candidate& b) { return a.brightness < b.brightness; });
  std::vector<cv::Mat> images;
  std::vector<float> times;
  for (const Exposure& e : bracket) {
    cv::Mat samples(kSide, kSide, CV_8UC3);
    for (int i = 0; i < kSide * kSide; ++i) {
      const Candidate& at = candidates[static_cast<std::size_t>(i) * (candidates.size() - 1) / (kSide * kSide - 1)];
      for (int c = 0; c < 3; ++c)
        samples.at<cv::Vec3b>(i / kSide, i % kSide)[c] = static_cast<std::uint8_t>(
            std::lround(255 * std::clamp(e.pixels.at(at.x, at.y, channels < 3 ? 0 : c), 0.f, 1.f)));
    }
    images.push_back(samples);
    times.push_back(static_cast<float>(e.amount / most));
  }
  cv::Mat curve;
  cv::createCalibrateDebevec(kSide * kSide, 10, false)->process(images, curve, times);
  std::array<std::vector<double>, 3> curves;
  for (int c = 0; c < 3; ++c)
    for (int i = 0; i < kCurve; ++i) curves[c].push_back(curve.at<cv::Vec3f>(i)[c]);
  return CameraResponse::measured(curves);
}

CameraResponse CameraResponse::read(const std::filesystem::path& file) {
  const std::string text = readTextFile(file);
  std::array<std::vector<double>, 3> curves;
  std::size_t at = 0;
  int line_number = 0;
  while (at < text.size()) {
    const std::size_t end = std::min(text.find('\n', at), text.size());
    const std::string line = text.substr(at, end - at);
    at = end + 1;
    ++line_number;
    if (line.empty() || line[0] == '#') continue;
    int index = -1;
    double r = 0, g = 0, b = 0;
    if (std::sscanf(line.c_str(), "%d,%lf,%lf,%lf", &index, &r, &g, &b) != 4 ||
        index != static_cast<int>(curves[0].size()) || !(r >= 0 && g >= 0 && b >= 0 && std::isfinite(r + g + b)))
      throw badInput(file.string() + ", line " + std::to_string(line_number),
                     "expected 'n,red,green,blue' with n from 0 to 255 in order and exposures not below 0");
    curves[0].push_back(r), curves[1].push_back(g), curves[2].push_back(b);
  }
  if (curves[0].size() != kCurve)
    throw badInput(file.string(), "has " + std::to_string(curves[0].size()) + " rows, expected 256");
  return measured(curves);
}

ImageF linearImage(const Exposure& exposure, const CameraResponse& response) {
  ImageF out = exposure.pixels;
  if (exposure.is_linear) return out;
  const int channels = out.channels();
  for (std::size_t i = 0; i < out.data().size(); ++i)
    out.data()[i] = response.exposure(static_cast<int>(i % channels) % 3, out.data()[i]);
  return out;
}

ImageF meanImage(const std::vector<ImageF>& images) {
  ImageF mean = images.at(0);
  for (std::size_t k = 1; k < images.size(); ++k) {
    requireSize(images[k], mean.width(), mean.height(), "an image of the mean");
    if (images[k].channels() != mean.channels()) throw badInput("an image of the mean", "has other channels");
    for (std::size_t i = 0; i < mean.data().size(); ++i) mean.data()[i] += images[k].data()[i];
  }
  for (float& v : mean.data()) v /= static_cast<float>(images.size());
  return mean;
}

Merged mergeExposures(const std::vector<Exposure>& bracket, const CameraResponse& response, const MergeOptions& options,
                      const std::vector<ImageF>& dark) {
  SRF_CHECK(!bracket.empty() && (dark.size() <= 1 || dark.size() == bracket.size()));
  const int w = bracket[0].pixels.width(), h = bracket[0].pixels.height(), channels = bracket[0].pixels.channels();
  std::size_t longest = 0;
  for (std::size_t k = 0; k < bracket.size(); ++k) {
    requireSize(bracket[k].pixels, w, h, "an exposure");
    if (bracket[k].pixels.channels() != channels) throw badInput("an exposure", "has other channels than the first");
    if (!(bracket[k].amount > 0)) throw badInput("an exposure", "gathers no light; give its time");
    if (bracket[k].amount > bracket[longest].amount) longest = k;
  }
  for (const ImageF& d : dark) {
    requireSize(d, w, h, "the dark frame");
    if (d.channels() != channels) throw badInput("the dark frame", "has other channels than the photographs");
  }

  Merged merged;
  merged.radiance = ImageF(w, h, channels);
  struct Counts {
    std::size_t saturated = 0, dark = 0, ignored = 0;
  };
  std::vector<Counts> counts(h);
  parallelFor(static_cast<std::size_t>(h), 8, [&](std::size_t begin, std::size_t end) {
    for (std::size_t row = begin; row < end; ++row) {
      const int y = static_cast<int>(row);
      for (int x = 0; x < w; ++x) {
        bool lost = false, all_dark = true, all_ignored = true;
        for (int c = 0; c < channels; ++c) {
          double sum = 0, weight = 0, logs = 0, log_weight = 0;
          double longest_value = NAN;
          bool seen = false;
          for (std::size_t k = 0; k < bracket.size(); ++k) {
            const Exposure& e = bracket[k];
            const float* p = &e.pixels.at(x, y);
            if (isIgnored(p, channels, options.ignored)) continue;
            all_ignored = false;
            const double encoded = p[c];
            if (!std::isfinite(encoded)) continue;
            if (encoded >= options.saturated) continue;
            const double off = dark.empty() ? 0 : dark[dark.size() == 1 ? 0 : k].at(x, y, c);
            const double value = (e.is_linear ? encoded : response.exposure(c % 3, static_cast<float>(encoded))) - off;
            if (!std::isfinite(value)) continue;
            if (k == longest) longest_value = value / e.amount;
            if (encoded <= options.black) continue;
            seen = true;
            if (e.is_linear || response.isLinear()) {
              const double f = flank(encoded, options.saturated);
              sum += f * value, weight += f * e.amount;
            } else if (value > 0) {
              const double f = hat(encoded, options.black, options.saturated);
              logs += f * std::log(value / e.amount), log_weight += f;
            }
          }
          // Black everywhere: as the longest exposure has it. NaN where that is saturated.
          double value = longest_value;
          if (weight > 1e-9)
            value = sum / weight;
          else if (log_weight > 1e-9)
            value = std::exp(logs / log_weight);
          all_dark = all_dark && !seen && !std::isnan(value);
          lost = lost || std::isnan(value);
          merged.radiance.at(x, y, c) = static_cast<float>(value);
        }
        if (lost)
          for (int c = 0; c < channels; ++c) merged.radiance.at(x, y, c) = NAN;
        counts[row].ignored += all_ignored;
        counts[row].saturated += lost && !all_ignored;
        counts[row].dark += all_dark && !all_ignored;
      }
    }
  });
  for (const Counts& c : counts) {
    merged.saturated_pixels += c.saturated;
    merged.dark_pixels += c.dark;
    merged.ignored_pixels += c.ignored;
  }
  return merged;
}

ImageF flatField(const ImageF& white) {
  const int w = white.width(), h = white.height(), channels = white.channels();
  const int reach = std::max(1, w / 200);
  ImageF out(w, h, channels);
  ImageF rows(w, h, channels);
  // A box mean along one axis, then along the other.
  const auto smooth = [&](const ImageF& from, ImageF& to, bool along_x) {
    for (int y = 0; y < h; ++y)
      for (int x = 0; x < w; ++x) {
        // As far on both sides, so that a slope does not become an error at the border.
        const int near = along_x ? std::min({reach, x, w - 1 - x}) : std::min({reach, y, h - 1 - y});
        for (int c = 0; c < channels; ++c) {
          double sum = 0, n = 0;
          for (int k = -near; k <= near; ++k) {
            const float v = along_x ? from.at(x + k, y, c) : from.at(x, y + k, c);
            if (std::isfinite(v)) sum += v, ++n;
          }
          to.at(x, y, c) = n > 0 ? static_cast<float>(sum / n) : NAN;
        }
      }
  };
  smooth(white, rows, true);
  smooth(rows, out, false);
  for (int c = 0; c < channels; ++c) {
    double sum = 0, n = 0;
    for (int y = h * 9 / 20; y <= h * 11 / 20 && y < h; ++y)
      for (int x = w * 9 / 20; x <= w * 11 / 20 && x < w; ++x)
        if (std::isfinite(white.at(x, y, c))) sum += white.at(x, y, c), ++n;
    if (!(n > 0) || !(sum / n > 1e-6))
      throw badInput("flat field", "is dark or saturated in the middle; photograph an even white surface");
    for (int y = 0; y < h; ++y)
      for (int x = 0; x < w; ++x) out.at(x, y, c) = static_cast<float>(out.at(x, y, c) * n / sum);
  }
  return out;
}

void divideByFlat(ImageF& image, const ImageF& flat) {
  requireSize(flat, image.width(), image.height(), "the flat field");
  for (int y = 0; y < image.height(); ++y)
    for (int x = 0; x < image.width(); ++x) {
      bool lost = false;
      for (int c = 0; c < image.channels(); ++c) {
        const float gain = flat.at(x, y, flat.channels() < 3 ? 0 : c);
        image.at(x, y, c) /= gain;
        lost = lost || !(gain > 0.02f);
      }
      if (lost)
        for (int c = 0; c < image.channels(); ++c) image.at(x, y, c) = NAN;
    }
}

namespace {

// The part of a polygon on one side of an axis-parallel line: keeps where sign * (coordinate - at) >= 0.
void clip(std::vector<Vec2>& polygon, std::vector<Vec2>& scratch, bool by_x, double at, double sign) {
  scratch.clear();
  for (std::size_t i = 0; i < polygon.size(); ++i) {
    const Vec2 a = polygon[i], b = polygon[(i + 1) % polygon.size()];
    const double da = sign * ((by_x ? a.x : a.y) - at), db = sign * ((by_x ? b.x : b.y) - at);
    if (da >= 0) scratch.push_back(a);
    if ((da >= 0) != (db >= 0)) {
      const double t = da / (da - db);
      scratch.push_back({a.x + t * (b.x - a.x), a.y + t * (b.y - a.y)});
    }
  }
  polygon.swap(scratch);
}

double areaOf(const std::vector<Vec2>& polygon) {
  double sum = 0;
  for (std::size_t i = 0; i < polygon.size(); ++i) {
    const Vec2 &a = polygon[i], &b = polygon[(i + 1) % polygon.size()];
    sum += (a.x - polygon[0].x) * (b.y - polygon[0].y) - (b.x - polygon[0].x) * (a.y - polygon[0].y);
  }
  return 0.5 * std::fabs(sum);
}

}  // namespace

Intrinsics Undistortion::pinholeOf(const Intrinsics& lens) {
  if (lens.isOrthographic()) return lens;  // has no distortion
  Intrinsics pinhole;
  pinhole.model = CameraModel::pinhole;
  pinhole.width = lens.width, pinhole.height = lens.height;
  pinhole.fl_x = lens.fl_x, pinhole.fl_y = lens.fl_y;
  pinhole.cx = lens.cx, pinhole.cy = lens.cy, pinhole.skew = lens.skew;
  return pinhole;
}

Undistortion::Undistortion(const Intrinsics& lens) : lens_(lens), pinhole_(pinholeOf(lens)) {
  const int w = lens.width, h = lens.height;
  // Where the corners of the new pixels lie in the old picture.
  std::vector<std::optional<Vec2>> corners(static_cast<std::size_t>(w + 1) * (h + 1));
  parallelFor(static_cast<std::size_t>(h) + 1, 8, [&](std::size_t begin, std::size_t end) {
    for (std::size_t y = begin; y < end; ++y)
      for (int x = 0; x <= w; ++x)
        if (const auto d = pinhole_.unproject({static_cast<double>(x), static_cast<double>(y)}))
          corners[y * (w + 1) + x] = lens_.project(Point<CameraSpace>(d->raw()));
  });
  std::vector<std::vector<Share>> rows(h);
  std::vector<std::uint32_t> counts(static_cast<std::size_t>(w) * h);
  parallelFor(static_cast<std::size_t>(h), 8, [&](std::size_t begin, std::size_t end) {
    std::vector<Vec2> row_part, cell, scratch;
    for (std::size_t y = begin; y < end; ++y)
      for (int x = 0; x < w; ++x) {
        const auto &a = corners[y * (w + 1) + x], &b = corners[y * (w + 1) + x + 1];
        const auto &c = corners[(y + 1) * (w + 1) + x + 1], &d = corners[(y + 1) * (w + 1) + x];
        if (!a || !b || !c || !d) continue;
        const std::vector<Vec2> quad{*a, *b, *c, *d};
        const double whole = areaOf(quad);
        if (!(whole > 1e-12)) continue;
        const auto [left, right] = std::minmax({a->x, b->x, c->x, d->x});
        const auto [top, bottom] = std::minmax({a->y, b->y, c->y, d->y});
        for (int v = std::max(0, static_cast<int>(std::floor(top))); v < std::min<double>(h, bottom); ++v) {
          row_part = quad;
          clip(row_part, scratch, false, v, 1);
          clip(row_part, scratch, false, v + 1, -1);
          for (int u = std::max(0, static_cast<int>(std::floor(left))); u < std::min<double>(w, right); ++u) {
            cell = row_part;
            clip(cell, scratch, true, u, 1);
            clip(cell, scratch, true, u + 1, -1);
            const double area = cell.size() < 3 ? 0 : areaOf(cell) / whole;
            if (area < 1e-9) continue;
            rows[y].push_back({static_cast<std::uint32_t>(v) * w + u, static_cast<float>(area)});
            ++counts[y * w + x];
          }
        }
      }
  });
  first_.assign(counts.size() + 1, 0);
  std::partial_sum(counts.begin(), counts.end(), first_.begin() + 1);
  shares_.reserve(first_.back());
  for (const auto& row : rows) shares_.insert(shares_.end(), row.begin(), row.end());
}

ImageF Undistortion::apply(const ImageF& image) const {
  requireSize(image, lens_.width, lens_.height, "the picture to undistort");
  const int channels = image.channels();
  ImageF out(image.width(), image.height(), channels);
  parallelFor(static_cast<std::size_t>(image.height()), 8, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin * image.width(); i < end * image.width(); ++i) {
      std::array<double, 4> sum{};
      double used = 0;
      for (std::uint32_t k = first_[i]; k < first_[i + 1]; ++k) {
        const float* from = image.data().data() + static_cast<std::size_t>(shares_[k].pixel) * channels;
        bool finite = true;
        for (int c = 0; c < channels; ++c) finite = finite && !std::isnan(from[c]);
        if (!finite) continue;
        used += shares_[k].area;
        for (int c = 0; c < channels; ++c) sum[c] += static_cast<double>(shares_[k].area) * from[c];
      }
      float* to = out.data().data() + i * channels;
      for (int c = 0; c < channels; ++c) to[c] = used < 1 - 1e-3 ? NAN : static_cast<float>(sum[c] / used);
    }
  });
  return out;
}

Image8 Undistortion::apply(const Image8& mask) const {
  if (mask.width() != lens_.width || mask.height() != lens_.height)
    throw badInput("the mask to undistort", "has another size than its camera");
  Image8 out(mask.width(), mask.height(), 1);
  for (std::size_t i = 0; i < out.data().size(); ++i) {
    double sum = 0;
    for (std::uint32_t k = first_[i]; k < first_[i + 1]; ++k) sum += shares_[k].area * mask.data()[shares_[k].pixel];
    out.data()[i] = static_cast<std::uint8_t>(std::lround(std::clamp(sum, 0.0, 255.0)));
  }
  return out;
}

}  // namespace srf
