#include "acquire/check_photographs.h"

#include <algorithm>
#include <bit>
#include <chrono>
#include <cmath>
#include <semaphore>

#include "acquire/check_section.h"
#include "base/error.h"
#include "base/image_io.h"
#include "base/parallel.h"
#include "base/text.h"

namespace srf {
namespace {

std::string sizeText(int width, int height) {
  return std::to_string(width) + " x " + std::to_string(height);
}

constexpr std::size_t kFewestAtCeiling = 16;  // pixels of one value

std::int32_t bitsOf(float v) {
  return std::bit_cast<std::int32_t>(v);
}

/// Of each pixel of a row the sum of its colours and the brightest; what is no number counts nothing.
void sumColours(const float* from, int width, int channels, float* sums, float* tops, PhotoFacts& facts) {
  const int colours = std::min(channels, 3);
  std::uint32_t largest = 0;  // as bits: below infinity's where all are finite and none has a minus
  for (int i = 0; i < width * channels; ++i) largest = std::max(largest, std::bit_cast<std::uint32_t>(from[i]));
  if (largest < 0x7f800000) {
    if (channels == 3) {
      for (int x = 0; x < width; ++x) {
        const float r = from[3 * x], g = from[3 * x + 1], b = from[3 * x + 2];
        sums[x] = r + g + b;
        tops[x] = std::max(std::max(r, g), b);
      }
      return;
    }
    for (int x = 0; x < width; ++x, from += channels) {
      sums[x] = tops[x] = from[0];
      for (int c = 1; c < colours; ++c) sums[x] += from[c], tops[x] = std::max(tops[x], from[c]);
    }
    return;
  }
  for (int x = 0; x < width; ++x, from += channels) {
    bool finite = true, negative = false;
    sums[x] = tops[x] = 0;
    for (int c = 0; c < colours; ++c) {
      const float v = from[c];
      finite &= std::isfinite(v);
      negative |= v < 0;
      if (!std::isfinite(v)) continue;
      tops[x] = std::max(tops[x], v);
      sums[x] += v;
    }
    facts.not_finite += !finite;
    facts.negative += finite && negative;
  }
}

/// Whether the brightest value is one that was cut off: many lit pixels hold exactly it, few lie just below, and the
/// picture grows towards it. A smooth maximum has more just below; a flat face in even light has a jump at its edge.
void findCeiling(const ImageF& photo, float most, PhotoFacts& facts) {
  ImageF brightest(photo.width(), photo.height(), 1);
  std::vector<float> sums(static_cast<std::size_t>(photo.width()));
  PhotoFacts counted_already;
  for (int y = 0; y < photo.height(); ++y)
    sumColours(photo.row(y), photo.width(), photo.channels(), sums.data(), brightest.row(y), counted_already);
  const float dark = 0.02f * most;
  // None is negative: their bits are in the order of their values, and compared many at a time.
  const std::int32_t top = bitsOf(most), nearly = bitsOf(0.99f * most), faint = bitsOf(dark);
  std::int32_t at = 0, just_below = 0, lit = 0;
  for (const float v : brightest.data()) {
    const std::int32_t bits = bitsOf(v);
    at += bits == top;
    just_below += bits >= nearly;
    lit += bits >= faint;
  }
  just_below -= at;
  if (100 * std::size_t(at) < std::size_t(lit) || 2 * just_below > at) return;
  std::size_t border = 0, bright_border = 0;
  for (int y = 0; y < brightest.height(); ++y) {
    const float* row = brightest.row(y);
    const float* next = y + 1 < brightest.height() ? brightest.row(y + 1) : row;
    for (int x = 0; x < brightest.width(); ++x) {
      const float v = row[x];
      if (v < dark) continue;
      for (const float w : {x + 1 < brightest.width() ? row[x + 1] : v, next[x]}) {
        if ((v == most) == (w == most) || w < dark) continue;
        ++border;
        bright_border += std::min(v, w) > 0.8f * most;
      }
    }
  }
  if (border < 8 || 2 * bright_border < border) return;
  facts.ceiling = most;
  facts.at_ceiling = static_cast<double>(at) / static_cast<double>(lit);
}

/// One look at a photograph: its faults, and itself in small.
PhotoFacts lookAtPhoto(const Capture& capture, const CaptureView& view, const Photo& photo, int step,
                       SmallPhoto& small) {
  PhotoFacts facts;
  try {
    const LoadedImage image = readImage(photo.file, capture.integer_transfer);
    const ImageF& p = image.pixels;
    const Intrinsics& lens = view.camera.lens;
    if (p.width() != lens.width || p.height() != lens.height) {
      facts.fault = "is " + sizeText(p.width(), p.height()) + ", its camera " + sizeText(lens.width, lens.height);
      if (p.width() == lens.height && p.height() == lens.width) facts.fault += ": it may be turned by 90 degrees";
    }
    const int colours = std::min(p.channels(), 3);
    facts.pixels = static_cast<std::size_t>(p.width()) * p.height();
    small = {(p.width() + step - 1) / step, (p.height() + step - 1) / step, step, {}};
    small.luminance.assign(static_cast<std::size_t>(small.width) * small.height, 0);
    // Row by row while it is in the cache: the sums of the rows of a block, and how many pixels are as bright as any.
    const auto width = static_cast<std::size_t>(p.width());
    std::vector<float> sums(width), tops(width), rows(width, 0.f);
    std::int32_t most_bits = 0;
    std::size_t at_most = 0;
    for (int y = 0; y < p.height(); ++y) {
      sumColours(p.row(y), p.width(), p.channels(), sums.data(), tops.data(), facts);
      for (std::size_t x = 0; x < width; ++x) rows[x] += sums[x];
      std::int32_t top = 0;
      for (const float v : tops) top = std::max(top, bitsOf(v));
      if (top > most_bits) most_bits = top, at_most = 0;
      if (top == most_bits)
        at_most += static_cast<std::size_t>(std::count(tops.begin(), tops.end(), std::bit_cast<float>(top)));
      if (!image.is_float)
        facts.clipped +=
            static_cast<std::size_t>(std::count_if(tops.begin(), tops.end(), [](float v) { return v >= 1; }));
      if ((y + 1) % step != 0 && y + 1 < p.height()) continue;
      float* block = small.luminance.data() + static_cast<std::size_t>(y / step) * small.width;
      for (int x0 = 0; x0 < p.width(); x0 += step, ++block)
        for (int x = x0; x < std::min(x0 + step, p.width()); ++x) *block += rows[static_cast<std::size_t>(x)];
      std::fill(rows.begin(), rows.end(), 0.f);
    }
    const float most = std::bit_cast<float>(most_bits);
    for (int y = 0; y < small.height; ++y)
      for (int x = 0; x < small.width; ++x)
        small.luminance[static_cast<std::size_t>(y) * small.width + x] /=
            static_cast<float>(colours * std::min(step, p.width() - x * step) * std::min(step, p.height() - y * step));
    facts.black = !(most > 0);
    if (image.is_float && most > 0 && at_most >= kFewestAtCeiling) findCeiling(p, most, facts);
    if (!facts.fault.empty()) small = {};
  } catch (const Error& e) {
    if (e.kind() == ErrorKind::interrupted) throw;
    facts.fault = wordsWithout(photo.file.string(), e);
  }
  return facts;
}

void reportFiles(const Capture& capture, const AllPhotos& photos, CheckReport& report) {
  Section section(report, "photographs");
  std::size_t files = 0;
  for (std::size_t v = 0; v < photos.facts.size(); ++v)
    for (std::size_t p = 0; p < photos.facts[v].size(); ++p, ++files)
      if (!photos.facts[v][p].fault.empty())
        section.fault(capture.views[v].photos[p].file.string(),
                      withPlace(photos.facts[v][p].fault, capture.views[v].photos[p].place),
                      "put the whole photograph there, at the size that was calibrated");
  section.finish(counted(files, "file") + ", whole and of the cameras' size");
}

/// Photographs of one light that stop at a value: one row for a light that does so everywhere, else one a file.
void reportCeilings(const Capture& capture, const AllPhotos& photos, Section& section) {
  const std::string mend = "expose less under it, or merge exposures to EXR; clipped highlights come out too dark";
  std::vector<std::vector<std::pair<std::size_t, std::size_t>>> of_light(capture.lights.size());
  std::vector<std::size_t> lit(capture.lights.size());
  for (std::size_t v = 0; v < photos.facts.size(); ++v)
    for (std::size_t p = 0; p < photos.facts[v].size(); ++p) {
      const PhotoFacts& f = photos.facts[v][p];
      const auto& light = capture.views[v].photos[p].light;
      if (!f.fault.empty() || f.black || !light) continue;
      ++lit[light->value];
      if (f.ceiling > 0) of_light[light->value].push_back({v, p});
    }
  for (std::size_t l = 0; l < of_light.size(); ++l) {
    const auto& list = of_light[l];
    const auto fileOf = [&](const auto& at) { return capture.views[at.first].photos[at.second].file.string(); };
    const auto factsOf = [&](const auto& at) -> const PhotoFacts& { return photos.facts[at.first][at.second]; };
    if (list.size() >= 3 && 3 * list.size() >= lit[l]) {
      double most = 0;
      for (const auto& at : list) most = std::max(most, factsOf(at).at_ceiling);
      section.warn(fileOf(list[0]),
                   "and " + counted(list.size() - 1, "other photograph") + " of " + std::to_string(lit[l]) +
                       " under light '" + capture.lights[l].name + "' are clipped: up to " +
                       fixedNumber(100 * most, 0) + " % of the lit pixels stop at exactly " +
                       shortNumber(factsOf(list[0]).ceiling, 4),
                   mend);
      continue;
    }
    for (const auto& at : list)
      section.warn(fileOf(at),
                   "is clipped: " + fixedNumber(100 * factsOf(at).at_ceiling, 0) +
                       " % of the lit pixels stop at exactly " + shortNumber(factsOf(at).ceiling, 4),
                   mend);
  }
}

void reportValues(const Capture& capture, const AllPhotos& photos, CheckReport& report) {
  Section section(report, "pixel values");
  std::vector<std::size_t> black_of(capture.lights.size()), photos_of(capture.lights.size());
  std::size_t black = 0;
  for (std::size_t v = 0; v < photos.facts.size(); ++v)
    for (std::size_t p = 0; p < photos.facts[v].size(); ++p) {
      const PhotoFacts& f = photos.facts[v][p];
      if (!f.fault.empty()) continue;
      const Photo& photo = capture.views[v].photos[p];
      const std::string file = photo.file.string();
      const double clipped = 100 * static_cast<double>(f.clipped) / static_cast<double>(f.pixels);
      if (f.not_finite > 0)
        section.warn(file, counted(f.not_finite, "pixel") + " NaN or infinite",
                     "they are masked when the field is made; merge the exposures again if they matter");
      if (f.negative > 0)
        section.warn(file, counted(f.negative, "pixel") + " negative", "subtract less of the dark frame");
      if (clipped > 1)
        section.warn(file, fixedNumber(clipped, 1) + " % of the pixels are clipped at white",
                     "expose less, or merge exposures to EXR; clipped highlights come out too dark");
      black += f.black;
      if (!photo.light) continue;
      ++photos_of[photo.light->value];
      black_of[photo.light->value] += f.black;
    }
  reportCeilings(capture, photos, section);
  for (std::size_t l = 0; l < capture.lights.size(); ++l)
    if (photos_of[l] > 0 && black_of[l] == photos_of[l])
      section.warn(
          "", "all " + counted(photos_of[l], "photograph") + " under light '" + capture.lights[l].name + "' are black",
          "see whether the light was on; remove it from the capture if not");
  section.finish("finite, none negative, none clipped" +
                 (black > 0 ? ", " + counted(black, "photograph") + " black (lit from behind)" : ""));
}

/// How many pixels of a photograph one value of its small copy stands for, along a side: as few as the memory allows,
/// between 16 and 64 values along the longer side.
int smallStep(const Capture& capture, std::size_t photo_count, std::size_t memory) {
  int longest = 1;
  for (const CaptureView& view : capture.views)
    longest = std::max({longest, view.camera.lens.width, view.camera.lens.height});
  const double side =
      std::sqrt(0.25 * static_cast<double>(memory) / (sizeof(float) * static_cast<double>(photo_count)));
  return static_cast<int>(std::ceil(longest / std::clamp(side, 16.0, 64.0)));
}

}  // namespace

AllPhotos checkPhotos(const Capture& capture, const CheckOptions& options, CheckReport& report, Reporter& reporter) {
  std::vector<std::pair<std::size_t, std::size_t>> all;
  AllPhotos photos;
  photos.facts.resize(capture.views.size());
  photos.small.resize(capture.views.size());
  double pixels = 1;
  for (std::size_t v = 0; v < capture.views.size(); ++v) {
    const CaptureView& view = capture.views[v];
    photos.facts[v].resize(view.photos.size());
    photos.small[v].resize(view.photos.size());
    pixels = std::max(pixels, static_cast<double>(view.camera.lens.width) * view.camera.lens.height);
    for (std::size_t p = 0; p < view.photos.size(); ++p) all.emplace_back(v, p);
  }
  const int step = smallStep(capture, all.size(), options.memory);
  // Four channels of floats, what the decoder holds, and where values stop short the brightest channel.
  constexpr double kBytesOfPixel = 36;
  const double at_once = std::floor(0.5 * static_cast<double>(options.memory) / (kBytesOfPixel * pixels));
  std::counting_semaphore<1024> places(static_cast<std::ptrdiff_t>(std::clamp(at_once, 1.0, 1024.0)));
  const auto start = std::chrono::steady_clock::now();
  {
    Reporter::Stage stage(reporter, "photographs", all.size());
    parallelFor(all.size(), 1, [&](std::size_t begin, std::size_t end) {
      for (std::size_t i = begin; i < end; ++i) {
        const auto [v, p] = all[i];
        const CaptureView& view = capture.views[v];
        places.acquire();
        photos.facts[v][p] = lookAtPhoto(capture, view, view.photos[p], step, photos.small[v][p]);
        places.release();
        stage.advance();
      }
    });
  }
  report.seconds_reading = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  reportFiles(capture, photos, report);
  reportValues(capture, photos, report);
  return photos;
}

}  // namespace srf
