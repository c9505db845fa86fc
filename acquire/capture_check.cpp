#include "acquire/capture_check.h"

#include <algorithm>
#include <cmath>
#include <set>

#include "acquire/camera_import.h"
#include "acquire/capture_drawing.h"
#include "acquire/capture_pictures.h"
#include "acquire/check_lights.h"
#include "acquire/check_masks.h"
#include "acquire/check_photographs.h"
#include "acquire/check_photometry.h"
#include "acquire/check_section.h"
#include "acquire/check_silhouettes.h"
#include "base/error.h"
#include "base/image_io.h"
#include "base/text.h"
#include "field/capture_file.h"
#include "field/reflectance_store.h"

namespace srf {
namespace {

constexpr std::size_t kPictured = 24;  // views drawn against the hull

// ---- What an SRF of it will need

std::string bytesText(double bytes) {
  const char* units[] = {"bytes", "KiB", "MiB", "GiB", "TiB"};
  int u = 0;
  for (; bytes >= 1024 && u < 4; ++u) bytes /= 1024;
  return fixedNumber(bytes, u > 0) + " " + units[u];
}

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
  section.finish(found + "; " + bytesText(memory) + " of memory for " +
                 (6 * pixels > largest ? "the silhouettes" : "that view") + "; reading its " + fixedNumber(photos, 0) +
                 " photographs took " + fixedNumber(report.seconds_reading, 1) + " s here, acquire does it again");
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
  if (options.pictures) report.drawing = captureDrawing(capture, CameraAxes::opencv);
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
