#include "acquire/acquire_field.h"

#include <algorithm>
#include <atomic>
#include <set>

#include "acquire/mask_pictures.h"
#include "acquire/registration.h"
#include "base/error.h"
#include "base/files.h"
#include "base/memory.h"
#include "base/mesh_io.h"
#include "base/parallel.h"
#include "base/text.h"

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
  reporter.result("poses adjusted: silhouettes agree with the hull of all by " + fixedNumber(adjustment.iou_after, 4) +
                  " in the mean, before by " + fixedNumber(adjustment.iou_before, 4));
  for (const AdjustedView& v : adjustment.views)
    reporter.result("  " + v.name + ": turned by " + fixedNumber(v.turned, 3) + " degrees, moved by " +
                    shortNumber(v.moved, 4) + " " + capture.units + "; outline off by " + fixedNumber(v.after, 2) +
                    " pixels, before by " + fixedNumber(v.before, 2) + "; agreement " + fixedNumber(v.iou_after, 4) +
                    ", before " + fixedNumber(v.iou_before, 4));
}

// Views become stores, as many at a time as have room for twice what reading takes; the rest of the memory is theirs
// to keep photographs in.
std::vector<StoredView> registerViews(const Capture& capture, const std::vector<SilhouetteView>& masks,
                                      const fs::path& folder, const AcquireOptions& options, Reporter& reporter) {
  std::size_t photo_count = 0, least = 1;
  for (const CaptureView& view : capture.views) {
    photo_count +=
        std::count_if(view.photos.begin(), view.photos.end(), [](const Photo& p) { return p.light.has_value(); });
    least = std::max(least, leastRegistrationMemory(view));
  }
  const std::size_t left = memoryLeft(options.memory_bytes);
  const std::size_t lanes = std::clamp<std::size_t>(left / (2 * least), 1, static_cast<std::size_t>(threadCount()));
  const RegistrationOptions registration{options.coding, left / lanes};
  Reporter::Stage stage(reporter, "register views", photo_count);
  std::vector<StoredView> stored(capture.views.size());
  std::atomic<std::size_t> next{0};
  parallelFor(lanes, 1, [&](std::size_t, std::size_t) {
    for (std::size_t i; (i = next++) < stored.size();)
      stored[i] = registerView(capture, ViewId{static_cast<std::uint32_t>(i)}, masks[i].mask, folder, registration,
                               stage, reporter);
  });
  return stored;
}

}  // namespace

StoredFile storeHull(const AcquisitionMesh& mesh, const fs::path& folder) {
  const fs::path fresh = folder / "shape" / "hull.ply";
  writePly(fresh, mesh);
  const auto bytes = readBinaryFile(fresh);
  const std::uint64_t hash = contentHash(bytes.data(), bytes.size());
  const std::string name = "shape/hull-" + hexHash(hash) + ".ply";
  fs::rename(fresh, folder / name);
  return {"hull", "shape", name, hash};
}

SrfManifest acquireField(const Capture& given, const fs::path& out, const AcquireOptions& options, Reporter& reporter) {
  std::optional<Capture> adjusted;
  const fs::path folder = out.has_filename() ? out : out.parent_path();
  OutputFolder output(folder);
  checkAllPhotographs(given, reporter);
  SilhouetteOptions silhouette_options = options.silhouette;
  silhouette_options.memory_bytes = memoryLeft(options.memory_bytes);
  std::vector<SilhouetteView> masks = silhouettes(given, silhouette_options, reporter);
  if (options.adjust_poses) {
    PoseAdjustmentOptions adjustment = *options.adjust_poses;
    if (!adjustment.bounds) adjustment.bounds = options.hull.bounds ? options.hull.bounds : given.bounds;
    adjusted = given;
    adjustCapture(*adjusted, masks, adjustment, reporter);
  }
  const Capture& capture = adjusted ? *adjusted : given;

  SrfManifest manifest;
  manifest.units = capture.units;
  manifest.color_space = capture.color_space;
  manifest.lights = capture.lights;
  manifest.source = fs::absolute(capture.folder / "").lexically_normal().parent_path().filename().string();
  manifest.command = options.command;

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
  manifest.views = registerViews(capture, masks, folder, options, reporter);
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
