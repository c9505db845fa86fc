#include "acquire/capture_check.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <map>
#include <semaphore>
#include <set>

#include "acquire/camera_import.h"
#include "acquire/capture_pictures.h"
#include "acquire/photometric_check.h"
#include "acquire/silhouette.h"
#include "acquire/visual_hull.h"
#include "base/error.h"
#include "base/image_io.h"
#include "base/numeric.h"
#include "base/parallel.h"
#include "field/capture_file.h"
#include "field/reflectance_store.h"

namespace srf {
namespace {

constexpr std::size_t kShown = 8;                 // rows of one kind before the rest is summed up
constexpr std::size_t kNamed = 60;                // files of one kind that are named at all
constexpr int kLeastCells = 48, kMostCells = 64;  // of the hull: enough to tell a wrong view
constexpr double kWideGap = 45;                   // degrees without any view or light
constexpr double kGood = 0.9;                     // IoU in the middle below which many silhouettes lack something
constexpr double kAgree = 0.8;                    // IoU of silhouettes that belong together, at this resolution
constexpr double kWrong = 0.93;        // IoU below which a view that most others surpass is named in any case
constexpr double kRollGain = 0.005;    // of IoU, below which a camera is not said to be turned about its axis
constexpr std::size_t kHinted = 16;    // views for which it is tried out what would make them fit
constexpr std::size_t kPictured = 24;  // views drawn against the hull
constexpr double kPoorFit = 0.3;       // correlation of shading and photographs that cannot be right
constexpr double kDrift = 0.05;        // change of exposure over a capture that is told

std::string text(const char* format, double a, double b = 0, double c = 0, double d = 0) {
  char out[200];
  std::snprintf(out, sizeof out, format, a, b, c, d);
  return out;
}
std::string counted(std::size_t n, const std::string& noun) {
  return std::to_string(n) + " " + noun + (n == 1 ? "" : "s");
}
std::string bytesText(double bytes) {
  const char* units[] = {"bytes", "KiB", "MiB", "GiB", "TiB"};
  int u = 0;
  for (; bytes >= 1024 && u < 4; ++u) bytes /= 1024;
  return text(u == 0 ? "%.0f " : "%.1f ", bytes) + units[u];
}
std::string sizeText(int width, int height) {
  return std::to_string(width) + " x " + std::to_string(height);
}

/// The words of an error that names `file`, without the name.
std::string without(const std::string& file, const Error& error) {
  const std::string words = error.what();
  return words.starts_with(file + ": ") ? words.substr(file.size() + 2) : words;
}

/// The rows of one thing that was looked at; says "ok" where nothing was found.
class Section {
 public:
  Section(CheckReport& report, std::string item) : report_(report), item_(std::move(item)) {}
  void add(Verdict verdict, const std::string& file, const std::string& found, const std::string& mend) {
    clean_ = false;
    std::vector<std::string>& rows = rows_[{verdict, mend}];
    rows.push_back(file);
    if (rows.size() <= kShown) report_.items.push_back({verdict, item_, file, found, mend});
  }
  void fault(const std::string& file, const std::string& found, const std::string& mend) {
    add(Verdict::fault, file, found, mend);
  }
  void warn(const std::string& file, const std::string& found, const std::string& mend) {
    add(Verdict::warning, file, found, mend);
  }
  void fault(const Error& error) { fault("", error.what(), ""); }
  /// Ends the section with what is well about it, and with what was too much to list.
  void finish(const std::string& good) {
    for (const auto& [kind, rows] : rows_) {
      if (rows.size() <= kShown) continue;
      std::string names;
      for (std::size_t i = kShown; i < std::min(rows.size(), kNamed); ++i)
        if (!rows[i].empty()) names += (names.empty() ? ": " : ", ") + rows[i];
      if (rows.size() > kNamed) names += " ..";
      report_.items.push_back(
          {kind.first, item_, "", std::to_string(rows.size() - kShown) + " more of the same" + names, kind.second});
    }
    if (clean_) report_.items.push_back({Verdict::ok, item_, "", good, ""});
  }

 private:
  CheckReport& report_;
  std::string item_;
  bool clean_ = true;
  std::map<std::pair<Verdict, std::string>, std::vector<std::string>> rows_;  // files of each verdict and mend
};

// ---- Photographs

struct PhotoFacts {
  std::string fault;  // empty: it can be used
  std::size_t not_finite = 0, negative = 0, clipped = 0, pixels = 0;
  double ceiling = 0;     // above 0: a value that many pixels stop at, as those of a full sensor do
  double at_ceiling = 0;  // share of the lit pixels that stand there
  bool black = false;
};

/// Whether the brightest value is one that was cut off: many lit pixels hold exactly it, few lie just below, and the
/// picture grows towards it. A smooth maximum has more just below; a flat face in even light has a jump at its edge.
void findCeiling(const ImageF& brightest, float most, PhotoFacts& facts) {
  std::size_t at = 0, just_below = 0, lit = 0, border = 0, bright_border = 0;
  for (int y = 0; y < brightest.height(); ++y) {
    const float* row = brightest.row(y);
    const float* next = y + 1 < brightest.height() ? brightest.row(y + 1) : row;
    for (int x = 0; x < brightest.width(); ++x) {
      const float v = row[x];
      if (v < 0.02f * most) continue;
      ++lit;
      at += v == most;
      just_below += v < most && v >= 0.99f * most;
      for (const float w : {x + 1 < brightest.width() ? row[x + 1] : v, next[x]}) {
        if ((v == most) == (w == most) || w < 0.02f * most) continue;
        ++border;
        bright_border += std::min(v, w) > 0.8f * most;
      }
    }
  }
  if (at < 16 || 100 * at < lit || 2 * just_below > at || border < 8 || 2 * bright_border < border) return;
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
    ImageF brightest(p.width(), p.height(), 1);
    float most = 0;
    for (int y = 0; y < p.height(); ++y) {
      const float* from = p.row(y);
      float* to = brightest.row(y);
      float* block = small.luminance.data() + static_cast<std::size_t>(y / step) * small.width;
      for (int x = 0, left = step; x < p.width(); ++x, from += p.channels()) {
        bool finite = true, negative = false;
        float top = 0, sum = 0;
        for (int c = 0; c < colours; ++c) {
          const float v = from[c];
          finite &= std::isfinite(v);
          negative |= v < 0;
          if (!std::isfinite(v)) continue;
          top = std::max(top, v);
          sum += v;
        }
        facts.not_finite += !finite;
        facts.negative += finite && negative;
        to[x] = top;
        most = std::max(most, top);
        *block += sum;
        if (--left == 0) ++block, left = step;
      }
    }
    for (int y = 0; y < small.height; ++y)
      for (int x = 0; x < small.width; ++x)
        small.luminance[static_cast<std::size_t>(y) * small.width + x] /=
            static_cast<float>(colours * std::min(step, p.width() - x * step) * std::min(step, p.height() - y * step));
    facts.black = !(most > 0);
    if (!image.is_float)
      facts.clipped = static_cast<std::size_t>(
          std::count_if(brightest.data().begin(), brightest.data().end(), [](float v) { return v >= 1; }));
    else if (most > 0)
      findCeiling(brightest, most, facts);
    if (!facts.fault.empty()) small = {};
  } catch (const Error& e) {
    if (e.kind() == ErrorKind::interrupted) throw;
    facts.fault = without(photo.file.string(), e);
  }
  return facts;
}

struct AllPhotos {
  std::vector<std::vector<PhotoFacts>> facts;  // [view][photograph]
  std::vector<std::vector<SmallPhoto>> small;
};

void reportFiles(const Capture& capture, const AllPhotos& photos, CheckReport& report) {
  Section section(report, "photographs");
  std::size_t files = 0;
  for (std::size_t v = 0; v < photos.facts.size(); ++v)
    for (std::size_t p = 0; p < photos.facts[v].size(); ++p, ++files)
      if (!photos.facts[v][p].fault.empty())
        section.fault(capture.views[v].photos[p].file.string(), photos.facts[v][p].fault,
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
      section.warn(
          fileOf(list[0]),
          "and " + counted(list.size() - 1, "other photograph") + " of " + std::to_string(lit[l]) + " under light '" +
              capture.lights[l].name + "' are clipped" +
              text(": up to %.0f %% of the lit pixels stop at exactly %.4g", 100 * most, factsOf(list[0]).ceiling),
          mend);
      continue;
    }
    for (const auto& at : list)
      section.warn(fileOf(at),
                   text("is clipped: %.0f %% of the lit pixels stop at exactly %.4g", 100 * factsOf(at).at_ceiling,
                        factsOf(at).ceiling),
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
        section.warn(file, text("%.1f %% of the pixels are clipped at white", clipped),
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
  // Four channels of floats, as many again in the decoder, and the brightest channel.
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

// ---- Masks

/// What is kept of a silhouette: itself in small, and how many tiles of a field's block it touches.
struct KeptMask {
  Image8 mask;
  std::size_t tiles = 0;
  bool inverted = false;  // `mask` is the file's with black and white exchanged
  bool empty() const { return mask.empty(); }
};

/// Share of the picture's border that is white.
double whiteBorder(const Image8& mask) {
  std::size_t white = 0, all = 0;
  for (int y = 0; y < mask.height(); ++y)
    for (int x = 0; x < mask.width(); x += (y == 0 || y == mask.height() - 1) ? 1 : std::max(1, mask.width() - 1)) {
      ++all;
      white += mask.at(x, y) >= 128;
    }
  return static_cast<double>(white) / static_cast<double>(std::max<std::size_t>(1, all));
}

std::size_t tilesTouched(const Image8& mask) {
  std::size_t tiles = 0;
  for (int ty = 0; ty < mask.height(); ty += kTile)
    for (int tx = 0; tx < mask.width(); tx += kTile) {
      bool covered = false;
      for (int y = ty; y < std::min(ty + kTile, mask.height()) && !covered; ++y)
        covered = std::any_of(mask.row(y) + tx, mask.row(y) + std::min(tx + kTile, mask.width()),
                              [](std::uint8_t m) { return m > 0; });
      tiles += covered;
    }
  return tiles;
}

/// By how much masks are made smaller: at least 256 pixels along the longer side remain, and six bytes a pixel of all
/// views (the mask and the distances that carving makes of it) take no more than a quarter of the memory.
int maskFactor(const Capture& capture, std::size_t memory) {
  double pixels = 0;
  int longest = 1;
  for (const CaptureView& view : capture.views) {
    pixels += static_cast<double>(view.camera.lens.width) * view.camera.lens.height;
    longest = std::max({longest, view.camera.lens.width, view.camera.lens.height});
  }
  const int for_memory = static_cast<int>(std::ceil(std::sqrt(24 * pixels / static_cast<double>(memory))));
  return std::clamp(std::max(longest / 512, for_memory), 1, std::max(1, longest / 64));
}

struct MaskFacts {
  std::string fault, mend;
};

/// Faults of a mask file as the silhouette reader sees them, and its polarity, which that cannot know.
MaskFacts lookAtMask(const CaptureView& view, int factor, KeptMask& kept) {
  const std::string file = view.mask_file.string();
  Capture one;
  one.views = {view};
  MaskFacts facts;
  try {
    // As it is stored: acquisition would turn it about by itself, and say so.
    SilhouetteOptions as_stored;
    as_stored.polarity = MaskPolarity::white_is_object;
    Image8 mask = silhouette(one, ViewId{0}, as_stored, Reporter::silent());
    if (const double border = whiteBorder(mask); border > 0.8) {
      facts = {text("%.0f %% of the picture's border is white", 100 * border),
               "invert it: white is the object, black the background"};
      for (std::uint8_t& m : mask.data()) m = static_cast<std::uint8_t>(255 - m);
      kept.inverted = true;
    }
    kept.tiles = tilesTouched(mask);
    kept.mask = reduced(mask, factor);
  } catch (const Error& e) {
    if (e.kind() == ErrorKind::interrupted) throw;
    facts.fault = without(file, e);
  }
  return facts;
}

void checkMasks(const Capture& capture, int factor, std::vector<KeptMask>& kept, CheckReport& report) {
  Section section(report, "masks");
  std::vector<std::size_t> with, without;
  for (std::size_t v = 0; v < capture.views.size(); ++v)
    (capture.views[v].mask_file.empty() ? without : with).push_back(v);
  std::vector<MaskFacts> facts(with.size());
  parallelFor(with.size(), 1, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) facts[i] = lookAtMask(capture.views[with[i]], factor, kept[with[i]]);
  });
  for (std::size_t i = 0; i < with.size(); ++i)
    if (!facts[i].fault.empty())
      section.fault(capture.views[with[i]].mask_file.string(), facts[i].fault, facts[i].mend);
  if (!with.empty())
    for (const std::size_t v : without)
      section.warn(capture.views[v].name, "has no mask, while other views have one",
                   "add its mask; until then alpha or the dark background tells the silhouette");
  section.finish(with.empty() ? "none: alpha, or a plain dark background, tells the silhouettes"
                              : counted(with.size(), "mask") + " of their cameras' size, neither empty nor full");
}

/// Silhouettes of the views without a mask file, whose photographs can all be read.
void segmentOthers(const Capture& capture, const AllPhotos& photos, int factor, std::vector<KeptMask>& kept,
                   CheckReport& report) {
  Capture rest = capture;
  rest.views.clear();
  std::vector<std::size_t> which;
  for (std::size_t v = 0; v < capture.views.size(); ++v) {
    const auto& facts = photos.facts[v];
    if (!capture.views[v].mask_file.empty() ||
        std::any_of(facts.begin(), facts.end(), [](const PhotoFacts& f) { return !f.fault.empty(); }))
      continue;
    rest.views.push_back(capture.views[v]);
    which.push_back(v);
  }
  if (which.empty()) return;
  Section section(report, "silhouettes");
  try {
    Reporter segmenting(ProgressMode::none, LogLevel::error);
    const auto views = silhouettes(rest, {}, segmenting);
    for (const std::string& warning : segmenting.warnings()) section.warn("", warning, "");
    for (std::size_t i = 0; i < which.size(); ++i)
      kept[which[i]] = {reduced(views[i].mask, factor), tilesTouched(views[i].mask), false};
  } catch (const Error& e) {
    if (e.kind() == ErrorKind::interrupted) throw;
    section.fault(e);
  }
  section.finish(counted(which.size(), "silhouette") + " from alpha or the dark background");
}

// ---- Lights and cells

void checkCells(const Capture& capture, CheckReport& report) {
  Section section(report, "views x lights");
  if (capture.unknownIllumination()) {
    section.finish(counted(capture.views.size(), "view") + " under the one light of the photographs");
    return;
  }
  std::vector<std::set<std::uint32_t>> lights(capture.views.size());
  std::set<std::uint32_t> used;
  std::size_t most = 0, cells = 0;
  for (std::size_t v = 0; v < capture.views.size(); ++v) {
    for (const Photo& photo : capture.views[v].photos) {
      if (!photo.light) continue;
      if (!lights[v].insert(photo.light->value).second)
        section.fault(
            photo.file.string(),
            "is a second photograph of this view under light '" + capture.lights[photo.light->value].name + "'",
            "keep one of them");
      used.insert(photo.light->value);
    }
    most = std::max(most, lights[v].size());
    cells += lights[v].size();
  }
  if (cells == 0)
    section.fault(capture.folder.string(), "no photograph names a light",
                  "give the frames their lights, or remove /lights for one unknown illumination");
  // On a turntable the lights move with the views: then each has its own, and none lacks another's.
  const bool shared = used.size() < 2 * std::max<std::size_t>(most, 1);
  for (std::size_t v = 0; v < capture.views.size(); ++v) {
    if (lights[v].empty() || lights[v].size() == (shared ? used.size() : most)) continue;
    std::string missing;
    if (shared)
      for (const std::uint32_t l : used)
        if (!lights[v].contains(l)) {
          missing = ", for one '" + capture.lights[l].name + "'";
          break;
        }
    section.warn(capture.views[v].name,
                 "has " + std::to_string(lights[v].size()) + " of " + std::to_string(shared ? used.size() : most) +
                     " lights" + missing,
                 "take the missing photographs; the look-up interpolates from the others until then");
  }
  for (std::size_t l = 0; l < capture.lights.size(); ++l)
    if (!used.contains(static_cast<std::uint32_t>(l)))
      section.warn("", "light '" + capture.lights[l].name + "' has no photograph", "add its photographs or remove it");
  section.finish(counted(cells, "photograph") + ": " + counted(capture.views.size(), "view") + " with " +
                 counted(most, "light") + " each");
}

Point<AcquisitionSpace> objectCentre(const Capture& capture) {
  if (capture.bounds) return capture.bounds->center();
  // The point nearest to all optical axes: sum of (I - f f^T) (x - o) = 0.
  Mat3 a{{Vec3{}, Vec3{}, Vec3{}}};
  Vec3 b;
  for (const CaptureView& view : capture.views) {
    const Vec3 f = view.camera.forward().raw(), o = view.camera.center().raw();
    for (int i = 0; i < 3; ++i)
      for (int j = 0; j < 3; ++j) {
        const double m = (i == j) - f[i] * f[j];
        a.row[i][j] += m;
        b[i] += m * o[j];
      }
  }
  const Vec3 x = inverse(a) * b;
  return Point<AcquisitionSpace>(isFinite(x) ? x : capture.views.front().camera.center().raw());
}

/// The direction with nothing near it, and the angle to the nearest.
struct Gap {
  Vec3 direction;
  double angle = 0;  // degrees
};
Gap widestGap(const std::vector<Vec3>& directions) {
  constexpr int kSamples = 2000;  // 2.4 degrees apart
  Gap widest;
  for (int i = 0; i < kSamples; ++i) {
    const double z = 1 - (2 * i + 1.0) / kSamples, r = std::sqrt(1 - z * z), turn = i * kPi * (3 - std::sqrt(5.0));
    const Vec3 d{r * std::cos(turn), r * std::sin(turn), z};
    double nearest = kPi;
    for (const Vec3& e : directions) nearest = std::min(nearest, angleBetweenUnit(d, e));
    if (degrees(nearest) > widest.angle) widest = {d, degrees(nearest)};
  }
  return widest;
}

void reportCoverage(Section& section, const std::vector<Vec3>& directions, const std::string& noun) {
  const Gap gap = widestGap(directions);
  const std::string found = counted(directions.size(), noun + " direction") +
                            text(", the widest gap %.0f degrees about (%.2f, %.2f, %.2f)", gap.angle, gap.direction.x,
                                 gap.direction.y, gap.direction.z);
  if (gap.angle > kWideGap)
    section.warn("", found, "add " + noun + "s there if the animation shows that side; it will be extrapolated");
  section.finish(found);
}

void checkLightsAndCoverage(const Capture& capture, CheckReport& report) {
  const Point<AcquisitionSpace> centre = objectCentre(capture);
  Section views(report, "coverage by views");
  std::vector<Vec3> view_directions, light_directions;
  for (const CaptureView& view : capture.views) view_directions.push_back(view.camera.viewDirection(centre).raw());
  reportCoverage(views, view_directions, "view");
  report.view_directions = view_directions;
  if (capture.unknownIllumination()) return;

  Section lights(report, "lights");
  for (const CaptureLight& light : capture.lights) {
    light_directions.push_back(light.directionFrom(centre).raw());
    if (!isFinite(light.strength) || !(minComponent(light.strength) >= 0) || !(maxComponent(light.strength) > 0))
      lights.fault("", "light '" + light.name + "' has no strength above 0",
                   "give it the irradiance or intensity that was measured");
    if (light.kind == LightKind::point && capture.bounds &&
        distance(light.position, centre) < 0.5 * capture.bounds->diameter())
      lights.warn("", "light '" + light.name + "' lies within the object's bounds", "mend its position or its units");
  }
  // A view that sees one direction under two names: the weights of the look-up cannot tell them apart.
  std::set<std::pair<std::uint32_t, std::uint32_t>> told;
  for (const CaptureView& view : capture.views)
    for (std::size_t i = 0; i < view.photos.size(); ++i)
      for (std::size_t j = 0; j < i; ++j) {
        if (!view.photos[i].light || !view.photos[j].light) continue;
        const auto a = view.photos[j].light->value, b = view.photos[i].light->value;
        if (a == b || degrees(angleBetweenUnit(light_directions[a], light_directions[b])) > 0.1) continue;
        if (told.emplace(std::min(a, b), std::max(a, b)).second)
          lights.warn("",
                      "lights '" + capture.lights[a].name + "' and '" + capture.lights[b].name +
                          "' shine from the same direction",
                      "remove one of them");
      }
  lights.finish(counted(capture.lights.size(), "light") + ", all of different direction and of strength above 0");
  Section cover(report, "coverage by lights");
  reportCoverage(cover, light_directions, "light");
  report.light_directions = light_directions;
}

// ---- Silhouettes against each other

/// Half as many cells as pixels, within bounds.
int hullCells(const std::vector<SilhouetteView>& views) {
  int longest = 0;
  for (const SilhouetteView& view : views) longest = std::max({longest, view.mask.width(), view.mask.height()});
  return std::clamp(longest / 2, kLeastCells, kMostCells);
}

/// The hull of all views; nothing where none remains.
std::optional<VisualHull> hullOf(const std::vector<SilhouetteView>& views,
                                 const std::optional<Box<AcquisitionSpace>>& bounds, int tolerance,
                                 bool exclude_outliers, std::string& why_not) {
  HullOptions options;
  options.resolution = hullCells(views);
  options.exclude_outliers = exclude_outliers;
  options.tolerance = tolerance;
  options.bounds = bounds;
  try {
    return carveVisualHull(views, options, Reporter::silent());
  } catch (const Error& e) {
    if (e.kind() == ErrorKind::interrupted) throw;
    why_not = e.what();
    return std::nullopt;
  }
}

std::vector<double> ious(const std::vector<ViewConsistency>& views) {
  std::vector<double> iou;
  for (const ViewConsistency& v : views) iou.push_back(v.iou);
  return iou;
}
double medianIou(const std::optional<VisualHull>& hull) {
  return hull ? median(ious(hull->views)) : 0;
}

/// Another way to read the poses of the file.
struct PoseReading {
  std::string found, mend;  // what it is when the silhouettes fit so, and what to do
  Vec3 before{1, 1, 1};     // signs of the camera's axes, taken before an inversion
  bool invert = false;
  Vec3 after{1, 1, 1};

  Rigid<AcquisitionSpace, CameraSpace> operator()(const Rigid<AcquisitionSpace, CameraSpace>& pose) const {
    const auto signs = [](const Vec3& s) { return Mat3{{Vec3{s.x, 0, 0}, Vec3{0, s.y, 0}, Vec3{0, 0, s.z}}}; };
    Mat3 r = pose.rotation().raw() * signs(before);
    Vec3 o = pose.origin().raw();
    if (invert) {
      r = r.transposed();
      o = -(r * o);
    }
    return {Orthogonal<AcquisitionSpace, CameraSpace>(r * signs(after)), Point<AcquisitionSpace>(o)};
  }
};

/// The readings that files of other programs call for. A reader has already turned OpenGL's camera; an inverse has to
/// be taken of what stood in the file.
const std::vector<PoseReading>& poseReadings() {
  static const Vec3 yz{1, -1, -1}, xy{-1, -1, 1}, xz{-1, 1, -1};
  static const std::vector<PoseReading> kReadings{
      {"the file has the OpenCV camera (y down, z forward)",
       "negate the second and third column of transform_matrix",
       yz,
       false,
       {1, 1, 1}},
      {"the pictures or the camera's x and y axes are turned by 180 degrees",
       "negate the first and second column of transform_matrix",
       xy,
       false,
       {1, 1, 1}},
      {"the camera's x and z axes are turned",
       "negate the first and third column of transform_matrix",
       xz,
       false,
       {1, 1, 1}},
      {"the file has world-to-camera", "store the inverse", yz, true, yz},
      {"the file has world-to-camera of the OpenCV camera",
       "store the inverse with the second and third column negated",
       {1, 1, 1},
       true,
       yz},
  };
  return kReadings;
}

std::vector<SilhouetteView> readAs(const PoseReading& reading, std::vector<SilhouetteView> views) {
  for (SilhouetteView& view : views) view.camera.pose = reading(view.camera.pose);
  return views;
}

/// Where no silhouette fits another, the poses are often in another convention: the usual ones are tried.
const PoseReading* fittingReading(const std::vector<SilhouetteView>& views, double& fit) {
  for (const PoseReading& reading : poseReadings()) {
    std::string unused;
    fit = medianIou(hullOf(readAs(reading, views), std::nullopt, 0, false, unused));
    if (fit > kAgree) return &reading;
  }
  return nullptr;
}

/// How a view that does not fit would: its silhouette turned, or its camera.
struct ViewHint {
  double iou = 0;
  std::string text;                                          // empty: nothing helps
  std::optional<Rigid<AcquisitionSpace, CameraSpace>> pose;  // where the camera turned
};

double iouOf(const AcquisitionMesh& mesh, const SilhouetteView& view) {
  return silhouetteConsistency(mesh, {view}).front().iou;
}

Image8 turnedMask(const Image8& mask, bool swap, bool flip_x, bool flip_y) {
  Image8 out(mask.width(), mask.height(), 1);
  for (int y = 0; y < mask.height(); ++y)
    for (int x = 0; x < mask.width(); ++x) {
      int i = swap ? y : x, j = swap ? x : y;
      if (flip_x) i = mask.width() - 1 - i;
      if (flip_y) j = mask.height() - 1 - j;
      out.at(x, y) = mask.at(i, j);
    }
  return out;
}

ViewHint hintFor(const AcquisitionMesh& mesh, const SilhouetteView& view) {
  ViewHint best{iouOf(mesh, view), "", std::nullopt};
  const double before = best.iou;
  // Its camera turned about its own centre, by ever finer steps about ever the best axis.
  SilhouetteView tried = view;
  Vec3 turn;  // degrees about the camera's x, y and z
  const auto posed = [&](const Vec3& t) {
    const double angle = length(t);
    const Mat3 r = angle > 0 ? rotationAbout(t / angle, radians(angle)) : Mat3{};
    return Rigid<AcquisitionSpace, CameraSpace>(
        Orthogonal<AcquisitionSpace, CameraSpace>(view.camera.pose.rotation().raw() * r), view.camera.pose.origin());
  };
  double reached = before;
  // About x and y first: about z a round silhouette says little, and it must gain more to count.
  for (const bool roll : {false, true})
    for (double step = 2; step > 0.04; step /= 2)
      for (int round = 0; round < 4; ++round) {
        const Vec3 from = turn;
        for (int axis = roll ? 2 : 0; axis < (roll ? 3 : 2); ++axis)
          for (const double way : {-step, step}) {
            Vec3 t = turn;
            t[axis] += way;
            tried.camera.pose = posed(t);
            if (const double iou = iouOf(mesh, tried); iou > reached + (roll ? kRollGain : 0)) reached = iou, turn = t;
          }
        if (turn == from) break;
      }
  if (reached - before > 0.02)
    best = {reached,
            text("it fits (IoU %.3f) when its camera is turned by %.2f degrees about (%.2f, ", reached, length(turn),
                 turn.x / length(turn)) +
                text("%.2f, %.2f) of camera space: the camera or the object was moved; calibrate this view again",
                     turn.y / length(turn), turn.z / length(turn)),
            posed(turn)};
  struct Way {
    const char* how;
    bool swap, flip_x, flip_y;
  };
  for (const Way& way :
       {Way{"turned by 180 degrees", false, true, true}, Way{"turned by 90 degrees clockwise", true, true, false},
        Way{"turned by 90 degrees counter-clockwise", true, false, true},
        Way{"mirrored left to right", false, true, false}, Way{"mirrored top to bottom", false, false, true}}) {
    if (way.swap && view.mask.width() != view.mask.height()) continue;
    tried = view;
    tried.mask = turnedMask(view.mask, way.swap, way.flip_x, way.flip_y);
    if (const double iou = iouOf(mesh, tried); iou > best.iou + 0.03)
      best = {iou,
              text("its silhouette fits (IoU %.3f) when the picture is taken to be ", iou) + way.how +
                  "; turn picture and mask back",
              std::nullopt};
  }
  return best;
}

/// By how many pixels a border must be off, all along, for a silhouette to lose all of its IoU: area over perimeter.
double pixelsOfBorderShift(const Image8& mask) {
  double area = 0, steps = 0;
  for (int y = 0; y < mask.height(); ++y)
    for (int x = 0; x < mask.width(); ++x) {
      const bool in = mask.at(x, y) >= 128;
      area += in;
      steps += x + 1 < mask.width() && in != (mask.at(x + 1, y) >= 128);
      steps += y + 1 < mask.height() && in != (mask.at(x, y + 1) >= 128);
    }
  return area / std::max(1.0, 0.25 * kPi * steps);  // steps along rows and columns are 4 / pi too long on average
}

double cellPixels(const VisualHull& hull, const Camera<AcquisitionSpace>& camera) {
  const auto seen = camera.project(hull.mesh.bounds().center());
  return seen && seen->depth > 0 ? hull.cell / camera.pixelFootprint(seen->depth) : 1;
}

/// Views whose silhouettes the others' hull does not hold; of each its IoU with the hull of the others.
struct Agreement {
  std::optional<VisualHull> hull;  // of those that fit
  std::vector<double> iou;
  std::vector<std::size_t> apart;
  double middle = 0;
  int tolerance = 0;
};

/// A hull that two views may be overruled in holds every right silhouette whole; a wrong one stands out of it.
std::vector<bool> standOut(const std::vector<SilhouetteView>& views,
                           const std::optional<Box<AcquisitionSpace>>& bounds) {
  std::vector<bool> out(views.size(), false);
  std::string unused;
  const auto tolerant = views.size() >= 8 ? hullOf(views, bounds, 2, true, unused) : std::nullopt;
  if (!tolerant) return out;
  std::vector<double> covered, deviation;
  for (const ViewConsistency& v : tolerant->views) covered.push_back(v.covered);
  const double usual = median(covered);
  for (const double c : covered) deviation.push_back(std::fabs(c - usual));
  const double limit = usual - std::max(0.01, 6 * median(deviation));
  for (std::size_t i = 0; i < views.size(); ++i) out[i] = tolerant->views[i].excluded || covered[i] < limit;
  return out;
}

Agreement agreementOf(const std::vector<SilhouetteView>& views, const std::optional<Box<AcquisitionSpace>>& bounds,
                      std::string& why_not) {
  Agreement result;
  const auto out = standOut(views, bounds);
  std::vector<SilhouetteView> kept;
  for (std::size_t i = 0; i < views.size(); ++i)
    if (!out[i]) kept.push_back(views[i]);
  if (2 * kept.size() < views.size()) kept = views;
  result.hull = hullOf(kept, bounds, 0, /*exclude_outliers=*/views.size() < 8, why_not);
  if (!result.hull) return result;
  result.iou = ious(silhouetteConsistency(result.hull->mesh, views));
  result.middle = median(result.iou);
  // Where all silhouettes lack something here and there, the hull of all lacks it everywhere.
  if (result.middle < kGood && views.size() >= 8)
    for (const int tolerance : {1, 2, 4}) {
      std::string unused;
      const auto hull = 4 * static_cast<std::size_t>(tolerance) <= views.size()
                            ? hullOf(kept, bounds, tolerance, false, unused)
                            : std::nullopt;
      if (!hull) continue;
      const auto iou = ious(silhouetteConsistency(hull->mesh, views));
      if (median(iou) <= result.middle) continue;
      result.hull = hull;
      result.iou = iou;
      result.middle = median(iou);
      result.tolerance = tolerance;
    }
  // Told by how far the borders lie apart, not by IoU, which punishes slender silhouettes.
  std::vector<double> apart, spread;
  for (std::size_t i = 0; i < views.size(); ++i)
    apart.push_back((1 - result.iou[i]) * pixelsOfBorderShift(views[i].mask));
  const double usual = median(apart);
  for (const double a : apart) spread.push_back(std::fabs(a - usual));
  const double wide = std::max(6 * median(spread), 0.02 * usual);
  for (std::size_t i = 0; i < views.size(); ++i) {
    const double cell = std::max(1.0, cellPixels(*result.hull, views[i].camera));
    if (apart[i] > usual + std::max(wide, cell) || (out[i] && apart[i] > usual + std::max(wide, 0.75 * cell)) ||
        (result.iou[i] < std::min(kWrong, result.middle) && apart[i] > std::max(1.0, 0.4 * cell)))
      result.apart.push_back(i);
  }
  return result;
}

void tellOfPoses(const Capture& capture, const std::vector<SilhouetteView>& views, const std::string& fault,
                 double middle, Section& section, CheckReport& report) {
  double fit = 0;
  const PoseReading* reading = fittingReading(views, fit);
  std::string mend = "see whether poses, masks and photographs belong together";
  if (reading) {
    mend = text("they fit with an IoU of %.2f when ", fit) + reading->found + "; " + reading->mend;
    for (CaptureView& view : report.mended.capture.views) view.camera.pose = (*reading)(view.camera.pose);
    report.mended.what.push_back("every pose: " + reading->found + ": " + reading->mend);
  }
  const std::string place = capture.folder.string();
  if (!fault.empty())
    section.fault(place, fault, mend);
  else
    section.add(reading ? Verdict::fault : Verdict::warning, place,
                text("the hull of all silhouettes fits them by an IoU of %.2f only", middle), mend);
}

/// The hull with which the views agree; nothing where they do not.
std::optional<VisualHull> checkAgreement(const Capture& capture, std::vector<SilhouetteView>& views,
                                         const std::vector<std::size_t>& which, CheckReport& report) {
  Section section(report, "silhouettes agree");
  if (views.size() < 2) {
    section.warn("", "only " + counted(views.size(), "view") + " can be used: nothing to compare",
                 "mend the faults above, or add views");
    section.finish("");
    return std::nullopt;
  }
  std::string why_not;
  Agreement found = agreementOf(views, capture.bounds, why_not);
  if (!found.hull || found.middle < kAgree) {
    tellOfPoses(capture, views, found.hull ? "" : why_not, found.middle, section, report);
    section.finish("");
    // Mended poses go on to the lights.
    if (report.mended.what.empty()) return std::nullopt;
    for (std::size_t i = 0; i < views.size(); ++i)
      views[i].camera.pose = report.mended.capture.views[which[i]].camera.pose;
    found = agreementOf(views, std::nullopt, why_not);
    if (!found.hull) return std::nullopt;
    for (std::size_t i = 0; i < views.size(); ++i) report.view_iou[which[i]] = found.iou[i];
    return std::move(found.hull);
  }
  double least = 1;
  for (std::size_t i = 0; i < views.size(); ++i) {
    report.view_iou[which[i]] = found.iou[i];
    least = std::min(least, found.iou[i]);
  }
  for (std::size_t k = 0; k < found.apart.size(); ++k) {
    const std::size_t i = found.apart[k];
    const ViewHint hint = k < kHinted ? hintFor(found.hull->mesh, views[i]) : ViewHint{};
    const CaptureView& view = capture.views[which[i]];
    const auto& file = view.mask_file.empty() && !view.photos.empty() ? view.photos[0].file : view.mask_file;
    section.warn(
        view.name,
        text("IoU with the hull of the others is %.3f, usual is %.3f", found.iou[i], found.middle) + " (" +
            file.string() + ")",
        hint.text.empty() ? "look at its silhouette and pose; acquire leaves it out or tolerates it" : hint.text);
    if (hint.pose && hint.iou > found.middle - 0.03) {
      views[i].camera.pose = *hint.pose;
      report.mended.capture.views[which[i]].camera.pose = *hint.pose;
      report.mended.what.push_back("view '" + view.name + "': its camera turned so that its silhouette fits");
    }
  }
  if (found.middle < kGood)
    section.warn(capture.folder.string(),
                 text("IoU with their hull is %.2f in the middle and %.2f at least", found.middle, least),
                 "shadows may be cut out of the silhouettes: look at them, or let acquire keep what most views agree "
                 "on (--tolerance 2)");
  section.finish(text("IoU with their hull %.3f in the middle, %.3f at least", found.middle, least) + " (at " +
                 std::to_string(hullCells(views)) + " cells)");
  return std::move(found.hull);
}

// ---- Photographs against the light table

void reportLightTable(const Capture& capture, const PhotometricReport& found, CheckReport& report) {
  Section section(report, "light table");
  const std::string file = (capture.folder / "transforms.json").string();
  Capture& mended = report.mended.capture;
  if (!found.why_not.empty()) {
    section.finish("not looked at: " + found.why_not);
    return;
  }
  if (found.axes) {
    const std::string change = axesText(*found.axes);
    section.fault(file,
                  text("the lights do not fit the photographs (correlation %.2f with their shading); they do (%.2f) ",
                       found.fit, found.axes_fit) +
                      "with " + change,
                  "write the directions and positions of all lights with " + change);
    for (CaptureLight& light : mended.lights) {
      light.direction = Direction<AcquisitionSpace>::fromUnit(*found.axes * light.direction.raw());
      light.position = Point<AcquisitionSpace>(*found.axes * light.position.raw());
    }
    report.mended.what.push_back("all lights: " + change);
  } else if (found.fit < kPoorFit) {
    section.warn(
        file, text("the lights fit the photographs poorly: correlation %.2f with the shading of the hull", found.fit),
        "see whether lights and cameras are given in the same axes; mirrors of the table do not help");
  }
  // Where each light's photographs belong; two that belong to each other were exchanged.
  std::map<std::uint32_t, const ForeignLight*> belongs;
  for (const ForeignLight& f : found.foreign) belongs[f.light.value] = &f;
  const std::vector<CaptureLight> told = mended.lights;
  for (const ForeignLight& f : found.foreign) {
    const auto other = belongs.find(f.fits.value);
    const bool swapped = other != belongs.end() && other->second->fits == f.light;
    CaptureLight& light = mended.lights[f.light.value];
    light.direction = told[f.fits.value].direction;
    light.position = told[f.fits.value].position;
    const std::string a = "'" + told[f.light.value].name + "'", b = "'" + told[f.fits.value].name + "'";
    const auto fit = text(" (correlation %.2f there, %.2f at its own)", f.after, f.before);
    if (swapped && f.light > f.fits) continue;
    section.fault(file,
                  swapped ? "lights " + a + " and " + b + " are exchanged: the photographs of each show the other's" +
                                " shading" + fit
                          : "the photographs of light " + a + " show the shading of light " + b + fit,
                  swapped ? "exchange the two directions or positions, or the two lights' photographs"
                          : "see which light each photograph belongs to: give " + a + " the place of " + b);
    report.mended.what.push_back(swapped ? "lights " + a + " and " + b + ": places exchanged"
                                         : "light " + a + ": given the place of " + b);
  }
  for (const StrayLight& s : found.stray) {
    const Vec3 d = s.seen_from.raw();
    section.warn(file,
                 "light '" + told[s.light.value].name +
                     text("' stands %.0f degrees from where its photographs are lit from, about (%.2f, %.2f, %.2f)",
                          s.off, d.x, d.y, d.z) +
                     text(" (correlation %.2f there, %.2f as told)", s.after, s.before),
                 "measure it again, or see whether its photographs are another light's");
  }
  section.finish(text("as the photographs show it: correlation %.2f with the shading of the hull", found.fit));
}

void reportTurned(const Capture& capture, const PhotometricReport& found, CheckReport& report) {
  Section section(report, "photographs upright");
  std::vector<std::set<std::size_t>> drop(capture.views.size());
  for (const TurnedPhoto& t : found.turned) {
    section.fault(
        capture.views[t.view].photos[t.photo].file.string(),
        "is " + t.how + text(": its shading fits by %.2f when it is turned back, by %.2f as it is", t.after, t.before),
        "turn the picture back (and see whether its EXIF orientation was applied twice)");
    drop[t.view].insert(t.photo);
    report.mended.what.push_back(capture.views[t.view].photos[t.photo].file.string() + ": left out, it is " + t.how);
  }
  for (std::size_t v = 0; v < drop.size(); ++v)
    for (auto p = drop[v].rbegin(); p != drop[v].rend(); ++p)
      report.mended.capture.views[v].photos.erase(report.mended.capture.views[v].photos.begin() +
                                                  static_cast<std::ptrdiff_t>(*p));
  section.finish(found.why_not.empty() ? "none is turned or mirrored against its shading"
                                       : "not looked at: " + found.why_not);
}

void reportExposure(const Capture& capture, const PhotometricReport& found, CheckReport& report) {
  Section section(report, "exposure");
  if (found.gain.empty()) {
    section.finish("not looked at: too few points are seen by several views");
    return;
  }
  report.view_gain = found.gain;
  if (std::fabs(found.drift) > kDrift && std::fabs(found.drift) > 4 * found.drift_error)
    section.warn(capture.views.back().name,
                 std::string("the photographs grow ") + (found.drift > 0 ? "brighter" : "darker") +
                     text(" by %.0f %% (+- %.0f) from the first view to the last", 100 * std::fabs(found.drift),
                          200 * found.drift_error),
                 "see whether the lights were warm and the exposure fixed; divide each photograph by its view's gain "
                 "(in the --json and --report files)");
  section.finish(text("steady: %+.1f %% from the first view to the last", 100 * found.drift));
}

// ---- What an SRF of it will need

void forecast(const Capture& capture, const std::vector<KeptMask>& masks, const CheckOptions& options,
              CheckReport& report) {
  double disk = 0, largest = 0, photos = 0, pixels = 0;
  for (std::size_t v = 0; v < capture.views.size(); ++v) {
    const CaptureView& view = capture.views[v];
    StoreGeometry geometry;
    geometry.light_count = static_cast<int>(
        std::count_if(view.photos.begin(), view.photos.end(), [](const Photo& p) { return p.light.has_value(); }));
    const double bytes = static_cast<double>(masks[v].tiles) * static_cast<double>(geometry.blockBytes());
    disk += bytes;
    largest = std::max(largest, bytes);
    photos += static_cast<double>(view.photos.size());
    pixels += static_cast<double>(view.camera.lens.width) * view.camera.lens.height;
  }
  Section section(report, "forecast");
  std::error_code code;
  std::filesystem::path place = std::filesystem::absolute(options.out, code);
  while (!std::filesystem::exists(place, code) && place.has_relative_path()) place = place.parent_path();
  const auto space = std::filesystem::space(place, code);
  const std::string found =
      "at most " + bytesText(disk) + " on disk before compression, " + bytesText(largest) + " for the largest view";
  if (!code && disk > static_cast<double>(space.available))
    section.warn(place.string(), found + "; " + bytesText(static_cast<double>(space.available)) + " are free",
                 "make room or choose another place");
  // Masks at full size with their distances stay in memory while the hull is carved.
  const double memory = std::max(6 * pixels, largest);
  section.finish(
      found + "; " + bytesText(memory) + " of memory for " + (6 * pixels > largest ? "the silhouettes" : "that view") +
      text("; reading its %.0f photographs took %.1f s here, acquire does it again", photos, report.seconds_reading));
}

// ---- What is mended, and pictures

/// The mask of a view as its file has it, black and white exchanged.
void mendMask(std::size_t v, CheckReport& report) {
  const auto& file = report.mended.capture.views[v].mask_file;
  Image8 mask = readMask(file);
  for (std::uint8_t& m : mask.data()) m = static_cast<std::uint8_t>(255 - m);
  report.mended.masks.emplace_back(v, std::move(mask));
  report.mended.what.push_back(file.string() + ": a new mask beside the mended file, inverted");
}

/// Photographs that cannot be read stay out of the mended capture; lights and views that none is left of go with them.
void dropUnusable(const Capture& capture, const AllPhotos& photos, CheckReport& report) {
  MendedCapture& mended = report.mended;
  std::set<std::filesystem::path> unusable;
  for (std::size_t v = 0; v < photos.facts.size(); ++v)
    for (std::size_t p = 0; p < photos.facts[v].size(); ++p)
      if (!photos.facts[v][p].fault.empty()) {
        const auto& file = capture.views[v].photos[p].file;
        if (unusable.insert(file).second) mended.what.push_back(file.string() + ": left out, it cannot be used");
      }
  std::vector<std::optional<LightId>> renamed(mended.capture.lights.size());
  std::vector<bool> used(mended.capture.lights.size(), capture.unknownIllumination());
  for (CaptureView& view : mended.capture.views) {
    std::erase_if(view.photos, [&](const Photo& p) { return unusable.contains(p.file); });
    for (const Photo& photo : view.photos)
      if (photo.light) used[photo.light->value] = true;
  }
  std::vector<CaptureLight> lights;
  for (std::size_t l = 0; l < used.size(); ++l)
    if (used[l]) {
      renamed[l] = LightId{static_cast<std::uint32_t>(lights.size())};
      lights.push_back(mended.capture.lights[l]);
    }
  mended.capture.lights = std::move(lights);
  std::vector<CaptureView> views;
  std::vector<std::pair<std::size_t, Image8>> masks;
  for (std::size_t v = 0; v < mended.capture.views.size(); ++v) {
    CaptureView& view = mended.capture.views[v];
    if (view.photos.empty()) continue;
    for (Photo& photo : view.photos)
      if (photo.light) photo.light = renamed[photo.light->value];
    for (auto& [of, mask] : mended.masks)
      if (of == v) masks.emplace_back(views.size(), std::move(mask));
    views.push_back(std::move(view));
  }
  mended.capture.views = std::move(views);
  mended.masks = std::move(masks);
}

/// A display picture of about `side` pixels along the longer side (whole pixels of the photograph are left out or
/// repeated), as bright as its brightest percent allows.
Image8 pictureOf(const ImageF& pixels, int side) {
  const int longest = std::max(pixels.width(), pixels.height());
  const int less = std::max(1, (longest + side - 1) / side), more = less > 1 ? 1 : std::max(1, side / longest);
  ImageF shown((pixels.width() + less - 1) / less * more, (pixels.height() + less - 1) / less * more, 3);
  std::vector<float> values;
  for (int y = 0; y < shown.height(); ++y)
    for (int x = 0; x < shown.width(); ++x)
      for (int c = 0; c < 3; ++c) {
        const float v = pixels.at(x / more * less, y / more * less, pixels.channels() < 3 ? 0 : c);
        shown.at(x, y, c) = std::isfinite(v) ? v : 0;
        if (v > 0 && std::isfinite(v)) values.push_back(v);
      }
  if (values.empty()) return displayImage(shown);
  const auto at = values.begin() + static_cast<std::ptrdiff_t>(0.99 * static_cast<double>(values.size() - 1));
  std::nth_element(values.begin(), at, values.end());
  return displayImage(shown, 0.9 / *at);
}

void drawPictures(const Capture& capture, const AllPhotos& photos, const std::vector<SilhouetteView>& views,
                  const std::vector<std::size_t>& which, const std::optional<VisualHull>& hull, CheckReport& report) {
  const Box<AcquisitionSpace> box = hull ? hull->mesh.bounds() : capture.bounds.value_or(Box<AcquisitionSpace>{});
  const Point<AcquisitionSpace> center = box.empty() ? objectCentre(capture) : box.center();
  for (std::size_t k = 0; k < std::min<std::size_t>(4, capture.views.size()); ++k) {
    const std::size_t v = k * capture.views.size() / std::min<std::size_t>(4, capture.views.size());
    const CaptureView& view = report.mended.capture.views[v];
    // The photograph with the most light in it.
    std::size_t best = SIZE_MAX;
    double most = 0;
    for (std::size_t p = 0; p < photos.small[v].size(); ++p) {
      double sum = 0;
      for (const float l : photos.small[v][p].luminance) sum += l;
      if (sum > most) most = sum, best = p;
    }
    if (best == SIZE_MAX) continue;
    try {
      const LoadedImage image = readImage(capture.views[v].photos[best].file, capture.integer_transfer);
      const Image8 shown = pictureOf(image.pixels, 480);
      const double reach = box.empty() ? 0.3 * distance(view.camera.center(), center) : 0.6 * box.diameter();
      report.pictures.push_back({"The axes of the capture over " + capture.views[v].photos[best].file.string(),
                                 axesPicture(shown, view.camera, center, reach)});
    } catch (const Error& e) {
      if (e.kind() == ErrorKind::interrupted) throw;
    }
  }
  if (!hull || views.empty()) return;
  // The views that agree least first.
  std::vector<std::size_t> order(views.size());
  for (std::size_t i = 0; i < order.size(); ++i) order[i] = i;
  std::stable_sort(order.begin(), order.end(),
                   [&](std::size_t a, std::size_t b) { return report.view_iou[which[a]] < report.view_iou[which[b]]; });
  order.resize(std::min<std::size_t>(order.size(), kPictured));
  std::vector<SilhouetteView> shown;
  std::vector<double> iou;
  for (const std::size_t i : order) shown.push_back(views[i]), iou.push_back(report.view_iou[which[i]]);
  report.pictures.push_back(
      {"Silhouettes against the hull of all, those that agree least first: grey both, red the silhouette alone, "
       "blue the hull alone",
       agreementSheet(hull->mesh, shown, iou, 6, 150)});
}

}  // namespace

std::string verdictName(Verdict verdict) {
  return verdict == Verdict::ok ? "ok" : verdict == Verdict::warning ? "warning" : "fault";
}

std::size_t CheckReport::count(Verdict verdict) const {
  return static_cast<std::size_t>(
      std::count_if(items.begin(), items.end(), [&](const CheckItem& i) { return i.verdict == verdict; }));
}

CheckReport checkCapture(const std::filesystem::path& folder, const CheckOptions& options, Reporter& reporter) {
  CheckReport report;
  Capture capture;
  {
    Section section(report, "capture");
    // What the readers warn of belongs into the report, once.
    Reporter reading(ProgressMode::none, LogLevel::error);
    try {
      capture = openCapture(folder, reading);
    } catch (const Error& e) {
      if (e.kind() == ErrorKind::interrupted) throw;
      section.fault(e);
      section.finish("");
      return report;
    }
    for (const std::string& warning : reading.warnings()) section.warn("", warning, "");
    section.finish(
        counted(capture.views.size(), "view") + ", " +
        (capture.unknownIllumination() ? "one unknown illumination" : counted(capture.lights.size(), "light")));
  }
  report.mended.capture = capture;
  report.view_iou.assign(capture.views.size(), -1);
  const AllPhotos photos = checkPhotos(capture, options, report, reporter);
  const int factor = maskFactor(capture, options.memory);
  std::vector<KeptMask> masks(capture.views.size());
  checkMasks(capture, factor, masks, report);
  segmentOthers(capture, photos, factor, masks, report);
  checkCells(capture, report);
  checkLightsAndCoverage(capture, report);

  std::vector<SilhouetteView> views;
  std::vector<std::size_t> which;
  for (std::size_t v = 0; v < capture.views.size(); ++v) {
    if (masks[v].empty()) continue;
    Camera<AcquisitionSpace> camera = capture.views[v].camera;
    camera.lens = reduced(camera.lens, factor);
    views.push_back({capture.views[v].name, camera, masks[v].mask});
    which.push_back(v);
    if (masks[v].inverted) mendMask(v, report);
  }
  const auto hull = checkAgreement(capture, views, which, report);
  if (hull) {
    std::vector<const Image8*> of_view(capture.views.size(), nullptr);
    for (std::size_t i = 0; i < which.size(); ++i) of_view[which[i]] = &views[i].mask;
    // The poses as mended: one fault must not make another.
    Capture posed = capture;
    for (std::size_t v = 0; v < posed.views.size(); ++v)
      posed.views[v].camera.pose = report.mended.capture.views[v].camera.pose;
    const PhotometricReport found = checkPhotometry(posed, hull->mesh, photos.small, of_view);
    reportLightTable(capture, found, report);
    reportTurned(capture, found, report);
    reportExposure(capture, found, report);
  }
  forecast(capture, masks, options, report);
  if (options.pictures) drawPictures(capture, photos, views, which, hull, report);
  dropUnusable(capture, photos, report);
  return report;
}

void writeMended(const std::filesystem::path& folder, const MendedCapture& mended) {
  Capture capture = mended.capture;
  for (const auto& [v, mask] : mended.masks) {
    std::string name = capture.views[v].name;
    std::replace(name.begin(), name.end(), '/', '_');
    capture.views[v].mask_file = folder / "masks" / (name + ".png");
    writePng(capture.views[v].mask_file, mask);
  }
  writeCapture(folder, capture);
}

}  // namespace srf
