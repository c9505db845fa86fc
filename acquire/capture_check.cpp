#include "acquire/capture_check.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <map>
#include <set>

#include "acquire/camera_import.h"
#include "acquire/silhouette.h"
#include "acquire/visual_hull.h"
#include "base/error.h"
#include "base/image_io.h"
#include "base/numeric.h"
#include "base/parallel.h"
#include "field/reflectance_store.h"

namespace srf {
namespace {

constexpr std::size_t kShown = 8;    // rows of one kind before the rest is summed up
constexpr int kHullResolution = 64;  // cells: enough to tell a wrong view
constexpr double kWideGap = 45;      // degrees without any view or light
constexpr double kGood = 0.9;        // IoU in the middle below which many silhouettes lack something
constexpr double kAgree = 0.8;       // IoU of silhouettes that belong together, at this resolution

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
    if (++rows_[{verdict, mend}] <= kShown) report_.items.push_back({verdict, item_, file, found, mend});
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
    for (const auto& [kind, row] : rows_)
      if (row > kShown)
        report_.items.push_back(
            {kind.first, item_, "", std::to_string(row - kShown) + " more of the same", kind.second});
    if (clean_) report_.items.push_back({Verdict::ok, item_, "", good, ""});
  }

 private:
  CheckReport& report_;
  std::string item_;
  bool clean_ = true;
  std::map<std::pair<Verdict, std::string>, std::size_t> rows_;  // how many of each verdict and mend
};

// ---- Photographs

struct PhotoFacts {
  std::string fault;  // empty: it can be used
  std::size_t not_finite = 0, negative = 0, clipped = 0, pixels = 0;
  bool black = false;
};

PhotoFacts lookAtPhoto(const Capture& capture, const CaptureView& view, const Photo& photo) {
  PhotoFacts facts;
  try {
    const LoadedImage image = readImage(photo.file, capture.integer_transfer);
    const ImageF& p = image.pixels;
    if (p.width() != view.camera.lens.width || p.height() != view.camera.lens.height)
      facts.fault = "is " + sizeText(p.width(), p.height()) + ", its camera " +
                    sizeText(view.camera.lens.width, view.camera.lens.height);
    const int colours = std::min(p.channels(), 3);
    facts.pixels = static_cast<std::size_t>(p.width()) * p.height();
    float brightest = 0;
    for (std::size_t i = 0; i < facts.pixels; ++i) {
      bool finite = true, negative = false, full = false;
      for (int c = 0; c < colours; ++c) {
        const float v = p.data()[i * p.channels() + c];
        finite &= std::isfinite(v);
        negative |= v < 0;
        full |= v >= 1;
        if (std::isfinite(v)) brightest = std::max(brightest, v);
      }
      facts.not_finite += !finite;
      facts.negative += finite && negative;
      facts.clipped += !image.is_float && full;
    }
    facts.black = !(brightest > 0);
  } catch (const Error& e) {
    if (e.kind() == ErrorKind::interrupted) throw;
    facts.fault = without(photo.file.string(), e);
  }
  return facts;
}

using AllPhotoFacts = std::vector<std::vector<PhotoFacts>>;  // [view][photograph]

void reportFiles(const Capture& capture, const AllPhotoFacts& facts, CheckReport& report) {
  Section section(report, "photographs");
  std::size_t files = 0;
  for (std::size_t v = 0; v < facts.size(); ++v)
    for (std::size_t p = 0; p < facts[v].size(); ++p, ++files)
      if (!facts[v][p].fault.empty())
        section.fault(capture.views[v].photos[p].file.string(), facts[v][p].fault,
                      "put the whole photograph there, at the size that was calibrated");
  section.finish(counted(files, "file") + ", whole and of the cameras' size");
}

void reportValues(const Capture& capture, const AllPhotoFacts& facts, CheckReport& report) {
  Section section(report, "pixel values");
  std::vector<std::size_t> black_of(capture.lights.size()), photos_of(capture.lights.size());
  std::size_t black = 0;
  for (std::size_t v = 0; v < facts.size(); ++v)
    for (std::size_t p = 0; p < facts[v].size(); ++p) {
      const PhotoFacts& f = facts[v][p];
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
  for (std::size_t l = 0; l < capture.lights.size(); ++l)
    if (photos_of[l] > 0 && black_of[l] == photos_of[l])
      section.warn(
          "", "all " + counted(photos_of[l], "photograph") + " under light '" + capture.lights[l].name + "' are black",
          "see whether the light was on; remove it from the capture if not");
  section.finish("finite, none negative, none clipped" +
                 (black > 0 ? ", " + counted(black, "photograph") + " black (lit from behind)" : ""));
}

AllPhotoFacts checkPhotos(const Capture& capture, CheckReport& report, Reporter& reporter) {
  std::vector<std::pair<std::size_t, std::size_t>> all;
  AllPhotoFacts facts(capture.views.size());
  for (std::size_t v = 0; v < capture.views.size(); ++v) {
    facts[v].resize(capture.views[v].photos.size());
    for (std::size_t p = 0; p < facts[v].size(); ++p) all.emplace_back(v, p);
  }
  {
    Reporter::Stage stage(reporter, "photographs", all.size());
    parallelFor(all.size(), 1, [&](std::size_t begin, std::size_t end) {
      for (std::size_t i = begin; i < end; ++i) {
        const auto [v, p] = all[i];
        facts[v][p] = lookAtPhoto(capture, capture.views[v], capture.views[v].photos[p]);
        stage.advance();
      }
    });
  }
  reportFiles(capture, facts, report);
  reportValues(capture, facts, report);
  return facts;
}

// ---- Masks

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

/// Faults of a mask file as the silhouette reader sees them, and those it cannot know. `capture` has one view.
bool checkMask(const Capture& capture, Section& section) {
  const std::string file = capture.views.front().mask_file.string();
  try {
    const double border = whiteBorder(silhouette(capture, ViewId{0}, {}, Reporter::silent()));
    if (border <= 0.8) return true;
    section.fault(file, text("%.0f %% of the picture's border is white", 100 * border),
                  "invert it: white is the object, black the background");
  } catch (const Error& e) {
    if (e.kind() == ErrorKind::interrupted) throw;
    section.fault(file, without(file, e), "");
  }
  return false;
}

void checkMasks(const Capture& capture, CheckReport& report, std::vector<char>& usable) {
  Section section(report, "masks");
  std::vector<std::size_t> with, without;
  for (std::size_t v = 0; v < capture.views.size(); ++v)
    (capture.views[v].mask_file.empty() ? without : with).push_back(v);
  for (const std::size_t v : with) {
    Capture one;
    one.views = {capture.views[v]};
    usable[v] = checkMask(one, section);
  }
  if (!with.empty())
    for (const std::size_t v : without)
      section.warn(capture.views[v].name, "has no mask, while other views have one",
                   "add its mask; until then alpha or the dark background tells the silhouette");
  section.finish(with.empty() ? "none: alpha, or a plain dark background, tells the silhouettes"
                              : counted(with.size(), "mask") + " of their cameras' size, neither empty nor full");
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
}

// ---- Silhouettes against each other

double median(std::vector<double> v) {
  if (v.empty()) return 0;
  std::nth_element(v.begin(), v.begin() + static_cast<std::ptrdiff_t>(v.size() / 2), v.end());
  return v[v.size() / 2];
}

/// IoU of each view with the hull of all; nothing where no hull remains.
std::optional<std::vector<ViewConsistency>> agreement(const std::vector<SilhouetteView>& views,
                                                      const std::optional<Box<AcquisitionSpace>>& bounds,
                                                      bool exclude_outliers, std::string& why_not) {
  HullOptions options;
  options.resolution = kHullResolution;
  options.exclude_outliers = exclude_outliers;
  options.bounds = bounds;
  try {
    return carveVisualHull(views, options, Reporter::silent()).views;
  } catch (const Error& e) {
    if (e.kind() == ErrorKind::interrupted) throw;
    why_not = e.what();
    return std::nullopt;
  }
}

double medianIou(const std::optional<std::vector<ViewConsistency>>& views) {
  std::vector<double> iou;
  if (views)
    for (const ViewConsistency& v : *views) iou.push_back(v.iou);
  return median(iou);
}

/// Where no silhouette fits another, the poses are often in another convention: tries the usual ones.
std::string conventionHint(const std::vector<SilhouetteView>& views) {
  const Mat3 flip{{Vec3{1, 0, 0}, Vec3{0, -1, 0}, Vec3{0, 0, -1}}};
  const auto flipped = [&](const Rigid<AcquisitionSpace, CameraSpace>& pose) {
    return Rigid<AcquisitionSpace, CameraSpace>(Orthogonal<AcquisitionSpace, CameraSpace>(pose.rotation().raw() * flip),
                                                pose.origin());
  };
  const auto inverted = [&](const Rigid<AcquisitionSpace, CameraSpace>& pose) {
    const Mat3 turned = pose.rotation().raw().transposed();
    return Rigid<AcquisitionSpace, CameraSpace>(Orthogonal<AcquisitionSpace, CameraSpace>(turned),
                                                Point<AcquisitionSpace>(-(turned * pose.origin().raw())));
  };
  struct Way {
    const char* hint;
    bool invert, flip_before, flip_after;
  };
  // A reader has already turned OpenGL's camera; an inverse has to be taken of what stood in the file.
  for (const Way& way :
       {Way{"they fit with the camera's y and z axes turned: the file has the OpenCV camera (y down, z forward); "
            "negate the second and third column of transform_matrix",
            false, true, false},
        Way{"they fit with the poses inverted: the file has world-to-camera; store the inverse", true, true, true},
        Way{"they fit with the poses inverted and the axes turned: the file has world-to-camera of the OpenCV camera; "
            "store the inverse with the second and third column negated",
            true, true, false}}) {
    std::vector<SilhouetteView> tried = views;
    for (SilhouetteView& view : tried) {
      if (way.flip_before) view.camera.pose = flipped(view.camera.pose);
      if (way.invert) view.camera.pose = inverted(view.camera.pose);
      if (way.flip_after) view.camera.pose = flipped(view.camera.pose);
    }
    std::string unused;
    if (medianIou(agreement(tried, std::nullopt, false, unused)) > kAgree) return way.hint;
  }
  return "";
}

void checkAgreement(const Capture& capture, const std::vector<SilhouetteView>& views, CheckReport& report) {
  Section section(report, "silhouettes agree");
  if (views.size() < 2) {
    section.warn("", "only " + counted(views.size(), "view") + " can be used: nothing to compare",
                 "mend the faults above, or add views");
    section.finish("");
    return;
  }
  std::string why_not;
  const auto found = agreement(views, capture.bounds, true, why_not);
  const double middle = medianIou(found);
  if (!found || middle < kAgree) {
    const std::string hint = conventionHint(views);
    const std::string mend = hint.empty() ? "see whether poses, masks and photographs belong together" : hint;
    if (!found)
      section.fault(capture.folder.string(), why_not, mend);
    else
      section.warn(capture.folder.string(),
                   text("the hull of all silhouettes fits them by an IoU of %.2f only", middle), mend);
    section.finish("");
    return;
  }
  double least = 1;
  std::vector<double> spread;
  for (const ViewConsistency& v : *found) spread.push_back(std::fabs(v.iou - middle));
  const double low = middle - std::max(0.08, 6 * median(spread));
  for (const ViewConsistency& v : *found) {
    least = std::min(least, v.iou);
    if (v.excluded || v.iou < low)
      section.warn(v.name, text("IoU with the hull of the others is %.2f, theirs %.2f", v.iou, middle),
                   "look at its silhouette and pose; acquire leaves it out or tolerates it");
  }
  if (middle < kGood)
    section.warn(capture.folder.string(),
                 text("IoU with their hull is %.2f in the middle and %.2f at least", middle, least),
                 "shadows may be cut out of the silhouettes: look at them, or let acquire keep what most views agree "
                 "on (--tolerance 2)");
  section.finish(text("IoU with their hull %.3f in the middle, %.3f at least (at 64 cells)", middle, least));
}

// ---- What an SRF of it will need

void forecast(const Capture& capture, const std::vector<SilhouetteView>& silhouettes, const std::filesystem::path& out,
              CheckReport& report) {
  double disk = 0, largest = 0;
  for (const SilhouetteView& s : silhouettes) {
    const auto view = std::find_if(capture.views.begin(), capture.views.end(),
                                   [&](const CaptureView& v) { return v.name == s.name; });
    StoreGeometry geometry;
    geometry.light_count = static_cast<int>(
        std::count_if(view->photos.begin(), view->photos.end(), [](const Photo& p) { return p.light.has_value(); }));
    std::size_t tiles = 0;
    for (int ty = 0; ty < s.mask.height(); ty += kTile)
      for (int tx = 0; tx < s.mask.width(); tx += kTile) {
        bool covered = false;
        for (int y = ty; y < std::min(ty + kTile, s.mask.height()) && !covered; ++y)
          covered = std::any_of(s.mask.row(y) + tx, s.mask.row(y) + std::min(tx + kTile, s.mask.width()),
                                [](std::uint8_t m) { return m > 0; });
        tiles += covered;
      }
    const double bytes = static_cast<double>(tiles) * static_cast<double>(geometry.blockBytes());
    disk += bytes;
    largest = std::max(largest, bytes);
  }
  Section section(report, "forecast");
  std::error_code code;
  std::filesystem::path place = std::filesystem::absolute(out, code);
  while (!std::filesystem::exists(place, code) && place.has_relative_path()) place = place.parent_path();
  const auto space = std::filesystem::space(place, code);
  const std::string found =
      "at most " + bytesText(disk) + " on disk before compression, " + bytesText(largest) + " for the largest view";
  if (!code && disk > static_cast<double>(space.available))
    section.warn(place.string(), found + "; " + bytesText(static_cast<double>(space.available)) + " are free",
                 "make room or choose another place");
  section.finish(found);
}

}  // namespace

std::string verdictName(Verdict verdict) {
  return verdict == Verdict::ok ? "ok" : verdict == Verdict::warning ? "warning" : "fault";
}

std::size_t CheckReport::count(Verdict verdict) const {
  return static_cast<std::size_t>(
      std::count_if(items.begin(), items.end(), [&](const CheckItem& i) { return i.verdict == verdict; }));
}

CheckReport checkCapture(const std::filesystem::path& folder, const std::filesystem::path& out, Reporter& reporter) {
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
  const auto photos = checkPhotos(capture, report, reporter);
  std::vector<char> usable(capture.views.size(), true);
  checkMasks(capture, report, usable);
  checkCells(capture, report);
  checkLightsAndCoverage(capture, report);

  Capture whole = capture;
  whole.views.clear();
  for (std::size_t v = 0; v < capture.views.size(); ++v) {
    const bool needs_photos = capture.views[v].mask_file.empty();
    if (needs_photos &&
        std::any_of(photos[v].begin(), photos[v].end(), [](const PhotoFacts& f) { return !f.fault.empty(); }))
      continue;
    if (usable[v]) whole.views.push_back(capture.views[v]);
  }
  try {
    Reporter segmenting(ProgressMode::none, LogLevel::error);
    const auto views = silhouettes(whole, {}, segmenting);
    if (!segmenting.warnings().empty()) {
      Section section(report, "silhouettes");
      for (const std::string& warning : segmenting.warnings()) section.warn("", warning, "");
    }
    checkAgreement(capture, views, report);
    forecast(capture, views, out, report);
  } catch (const Error& e) {
    if (e.kind() == ErrorKind::interrupted) throw;
    Section(report, "silhouettes").fault(e);
  }
  return report;
}

}  // namespace srf
