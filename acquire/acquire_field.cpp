#include "acquire/acquire_field.h"

#include <algorithm>
#include <cstdio>
#include <set>

#include "acquire/mask_pictures.h"
#include "acquire/registration.h"
#include "base/error.h"
#include "base/files.h"
#include "base/mesh_io.h"
#include "base/parallel.h"

namespace srf {
namespace {

namespace fs = std::filesystem;

// What an acquisition leaves before it has a manifest: store files of views/ and shape/, nothing else.
bool isUnfinished(const fs::path& folder) {
  for (const auto& entry : fs::recursive_directory_iterator(folder)) {
    const fs::path inside = entry.path().lexically_relative(folder);
    if (entry.is_directory() ? inside == "views" || inside == "shape"
                             : inside.parent_path() == "views" || inside.parent_path() == "shape") {
      const std::string name = inside.filename().string();
      if (entry.is_directory() || name.find(".blk") != std::string::npos || name.find(".ply") != std::string::npos)
        continue;
    }
    return false;
  }
  return true;
}

// The folder that is written to. Where the work fails, what it made is taken away again; where the user stopped it,
// finished views stay for the next run.
class OutputFolder {
 public:
  explicit OutputFolder(fs::path folder) : folder_(std::move(folder)) {
    std::error_code code;
    if (fs::exists(folder_, code)) {
      if (!fs::is_directory(folder_) || !(isSrfFolder(folder_) || isUnfinished(folder_)))
        throw Error(ErrorKind::usage, "exists and is not an SRF; name another output or remove it", folder_.string());
      for (const auto& entry : fs::recursive_directory_iterator(folder_)) before_.insert(entry.path());
    }
    for (fs::path f = fs::absolute(folder_).lexically_normal(); !fs::exists(f, code) && f.has_relative_path();
         f = f.parent_path())
      made_.push_back(f);
    for (const char* part : {"views", "shape"}) {
      fs::create_directories(folder_ / part, code);
      if (code) {
        cleanUp();
        throw Error(code == std::errc::no_space_on_device ? ErrorKind::out_of_budget : ErrorKind::failed,
                    "could not be made: " + code.message() + "; choose another place", (folder_ / part).string());
      }
    }
  }
  ~OutputFolder() {
    if (!whole_) cleanUp();
  }
  void setWhole() { whole_ = true; }

 private:
  void cleanUp() const {
    std::error_code code;
    for (const char* part : {"views", "shape"}) {
      std::vector<fs::path> files;
      for (const auto& entry : fs::directory_iterator(folder_ / part, code)) files.push_back(entry.path());
      for (const fs::path& file : files)
        if (!before_.contains(file) && !interruptRequested()) fs::remove(file, code);
      if (!before_.contains(folder_ / part)) fs::remove(folder_ / part, code);  // where it is empty
    }
    for (const fs::path& made : made_) fs::remove(made, code);
  }
  fs::path folder_;
  std::set<fs::path> before_;
  std::vector<fs::path> made_;
  bool whole_ = false;
};

void checkAllPhotographs(const Capture& capture, Reporter& reporter) {
  Reporter::Stage stage(reporter, "check photographs", capture.views.size());
  parallelFor(capture.views.size(), 1, [&](std::size_t begin, std::size_t) {
    checkPhotographs(capture, ViewId{static_cast<std::uint32_t>(begin)});
    stage.advance();
  });
}

StoredFile storeHull(const AcquisitionMesh& mesh, const fs::path& folder) {
  const fs::path fresh = folder / "shape" / "hull.ply";
  writePly(fresh, mesh);
  const auto bytes = readBinaryFile(fresh);
  const std::uint64_t hash = contentHash(bytes.data(), bytes.size());
  const std::string name = "shape/hull-" + hexHash(hash) + ".ply";
  fs::rename(fresh, folder / name);
  return {"hull", "shape", name, hash};
}

void recordHull(const VisualHull& hull, Reporter& reporter) {
  reporter.figure("hull.volume", meshVolume(hull.mesh));
  reporter.figure("hull.cell", hull.cell);
  double sum = 0, least = 1;
  for (const ViewConsistency& v : hull.views) {
    sum += v.iou;
    least = std::min(least, v.iou);
  }
  reporter.figure("hull.iou.mean", sum / static_cast<double>(hull.views.size()));
  reporter.figure("hull.iou.least", least);
}

// The report of an adjustment: figures for all, and each view by name.
void adjustCapture(Capture& capture, std::vector<SilhouetteView>& masks, const PoseAdjustmentOptions& options,
                   Reporter& reporter) {
  const PoseAdjustment adjustment = adjustPoses(masks, options, reporter);
  if (!adjustment.kept) return;
  for (std::size_t i = 0; i < masks.size(); ++i) capture.views[i].camera = masks[i].camera;
  const auto number = [](const char* format, double value) {
    char text[32];
    std::snprintf(text, sizeof text, format, value);
    return std::string(text);
  };
  reporter.result("poses adjusted: silhouettes agree with the hull of all by " + number("%.4f", adjustment.iou_after) +
                  " in the mean, before by " + number("%.4f", adjustment.iou_before));
  for (const AdjustedView& v : adjustment.views)
    reporter.result("  " + v.name + ": turned by " + number("%.3f", v.turned) + " degrees, moved by " +
                    number("%.4g", v.moved) + " " + capture.units + "; outline off by " + number("%.2f", v.after) +
                    " pixels, before by " + number("%.2f", v.before) + "; agreement " + number("%.4f", v.iou_after) +
                    ", before " + number("%.4f", v.iou_before));
}

}  // namespace

SrfManifest acquireField(const Capture& given, const fs::path& out, const AcquireOptions& options, Reporter& reporter) {
  Capture capture = given;  // its poses may be adjusted
  const fs::path folder = out.has_filename() ? out : out.parent_path();
  OutputFolder output(folder);
  checkAllPhotographs(capture, reporter);
  SilhouetteOptions silhouette_options = options.silhouette;
  silhouette_options.memory_bytes = options.memory_bytes;
  std::vector<SilhouetteView> masks = silhouettes(capture, silhouette_options, reporter);
  if (options.adjust_poses) {
    PoseAdjustmentOptions adjustment = *options.adjust_poses;
    if (!adjustment.bounds) adjustment.bounds = options.hull.bounds ? options.hull.bounds : capture.bounds;
    adjustCapture(capture, masks, adjustment, reporter);
  }

  SrfManifest manifest;
  manifest.units = capture.units;
  manifest.color_space = capture.color_space;
  manifest.lights = capture.lights;
  manifest.source = fs::absolute(capture.folder / "").lexically_normal().parent_path().filename().string();
  manifest.command = options.command;
  manifest.views.resize(capture.views.size());

  std::optional<VisualHull> hull;
  if (options.make_hull) {
    HullOptions hull_options = options.hull;
    if (!hull_options.bounds) hull_options.bounds = capture.bounds;
    hull = carveVisualHull(masks, hull_options, reporter);
    if (options.refine_hull) hull = options.refine_hull(masks, *hull, reporter);
    recordHull(*hull, reporter);
  }
  if (!options.mask_pictures.empty())
    writeMaskPictures(capture, masks, hull ? &hull->mesh : nullptr, options.mask_pictures, reporter);
  {
    std::size_t photo_count = 0;
    for (const CaptureView& view : capture.views)
      photo_count +=
          std::count_if(view.photos.begin(), view.photos.end(), [](const Photo& p) { return p.light.has_value(); });
    Reporter::Stage stage(reporter, "register views", photo_count);
    const RegistrationOptions registration{options.coding, options.memory_bytes / threadCount()};
    parallelFor(capture.views.size(), 1, [&](std::size_t i, std::size_t) {
      manifest.views[i] = registerView(capture, ViewId{static_cast<std::uint32_t>(i)}, masks[i].mask, folder,
                                       registration, stage, reporter);
    });
  }
  if (hull) {
    manifest.shapes.push_back(storeHull(hull->mesh, folder));
    for (const ViewConsistency& v : hull->views)
      for (StoredView& view : manifest.views)
        if (view.name == v.name) view.silhouette_iou = v.iou;
  }
  writeManifest(folder, manifest);
  output.setWhole();
  return manifest;
}

}  // namespace srf
