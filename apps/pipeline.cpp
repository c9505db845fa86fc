// `srf pipeline`: photographs to animation. Reads like Fig. 1 of the patent; each stage is the function that its own
// command calls. Steps whose input has not changed since the last run are kept.
#include <algorithm>
#include <nlohmann/json.hpp>

#include "acquire/acquire_field.h"
#include "acquire/camera_import.h"
#include "apps/contact_sheet.h"
#include "apps/frame_lines.h"
#include "apps/make_model.h"
#include "apps/program.h"
#include "apps/report.h"
#include "apps/video.h"
#include "base/files.h"
#include "base/image_io.h"
#include "base/mesh_io.h"
#include "render/animation.h"

namespace fs = std::filesystem;

namespace srf {
namespace {

struct PipelineOptions {
  std::string capture, scene, output, kind = "mesh", shape = "hull", fit = "auto", frames;
  int tolerance = 0;
  std::vector<std::string> overrides;
  std::string command;
  std::size_t memory_bytes = 0;
};

// Names, sizes and times of the files that a step reads: equal stamps mean equal input, as for make.
class Stamp {
 public:
  explicit Stamp(const std::string& settings) { add(settings); }
  void add(const std::string& text) { hash_ = contentHash(text.data(), text.size(), hash_); }
  void addFile(const fs::path& file) {
    std::error_code code;
    add(file.string() + " " + std::to_string(fs::file_size(file, code)) + " " +
        std::to_string(fs::last_write_time(file, code).time_since_epoch().count()));
  }
  std::string text() const { return hexHash(hash_); }

 private:
  std::uint64_t hash_ = 0;
};

std::string captureStamp(const Capture& capture, const fs::path& own_output) {
  std::vector<fs::path> files;
  for (auto it = fs::recursive_directory_iterator(capture.folder); it != fs::recursive_directory_iterator(); ++it) {
    std::error_code code;
    if (it->is_directory() && fs::equivalent(it->path(), own_output, code)) it.disable_recursion_pending();
    if (it->is_regular_file()) files.push_back(it->path());
  }
  for (const CaptureView& view : capture.views) {
    if (!view.mask_file.empty()) files.push_back(view.mask_file);
    for (const Photo& photo : view.photos) files.push_back(photo.file);
  }
  std::sort(files.begin(), files.end());
  Stamp stamp(projectVersion());
  for (const fs::path& file : files) stamp.addFile(file);
  return stamp.text();
}

// What earlier steps said, kept in DIR/pipeline.json so that the report of a second run is as whole as the first one's.
class Journal {
 public:
  Journal(const fs::path& file, Reporter& reporter) : file_(file), reporter_(reporter) {
    std::error_code code;
    if (!fs::exists(file, code)) return;
    try {
      steps_ = readJsonFile(file).raw();
    } catch (const Error&) {
      reporter.warn(file.string() + " is damaged: every step is done again");
    }
  }

  /// Runs `work` unless the last run did the same on the same input and its result is still there.
  void step(const std::string& name, const std::string& stamp, bool result_exists, const std::function<void()>& work) {
    if (result_exists && steps_.is_object() && steps_.contains(name) && steps_[name].value("inputs", "") == stamp) {
      past_ = steps_[name];
      reporter_.info(name + ": kept from an earlier run");
      return;
    }
    work();
    steps_[name] = soFar();
    steps_[name]["inputs"] = stamp;
    writeJsonFile(file_, steps_);
  }

  void fill(PipelineReport& report) const {
    const Json all = soFar();
    for (const auto& [name, stage] : all["stages"].items())
      report.stages.push_back({name, stage["seconds"], stage["steps"]});
    report.warnings = all["warnings"].get<std::vector<std::string>>();
    report.counters = all["counters"].get<std::map<std::string, std::uint64_t>>();
    report.figures = all["figures"].get<std::map<std::string, double>>();
  }

 private:
  // Of the steps that were kept, and of this run. A stage of both is one that found its work done: the first time
  // counts.
  Json soFar() const {
    Json all = past_;
    for (const auto& s : reporter_.stageTimes())
      if (!all["stages"].contains(s.name) || all["stages"][s.name]["seconds"] < s.seconds)
        all["stages"][s.name] = {{"seconds", s.seconds}, {"steps", s.steps}};
    for (const std::string& text : reporter_.warnings()) {
      Json& known = all["warnings"];
      if (std::find(known.begin(), known.end(), text) == known.end()) known.push_back(text);
    }
    for (const auto& [name, count] : reporter_.counters()) all["counters"][name] = count;
    for (const auto& [name, value] : reporter_.figures()) all["figures"][name] = value;
    return all;
  }

  fs::path file_;
  Reporter& reporter_;
  Json steps_ = Json::object();
  Json past_{{"stages", Json::object()},
             {"warnings", Json::array()},
             {"counters", Json::object()},
             {"figures", Json::object()}};
};

// Every frame, or `most` of them spread evenly from first to last.
std::vector<RenderedFrame> spread(const std::vector<RenderedFrame>& frames, std::size_t most) {
  if (frames.size() <= most) return frames;
  std::vector<RenderedFrame> some;
  for (std::size_t i = 0; i < most; ++i) some.push_back(frames[i * (frames.size() - 1) / (most - 1)]);
  return some;
}

void writeVideo(const fs::path& file, const std::vector<RenderedFrame>& frames, double fps, double exposure,
                Reporter& reporter) {
  Reporter::Stage stage(reporter, "video", frames.size());
  const ImageSize size = readImageSize(frames.front().file);
  VideoWriter video(file, size.width, size.height, fps);
  for (const RenderedFrame& frame : frames) {
    video.write(displayImage(overBlack(readImage(frame.file).pixels), exposure));
    stage.advance();
  }
  video.commit();
}

void runPipeline(const PipelineOptions& options, Reporter& reporter) {
  const fs::path out = options.output, field_folder = out / "field.srf";
  Scene scene = readScene(options.scene, options.overrides, reporter);
  const Capture capture = openCapture(options.capture, reporter);
  fs::create_directories(out);
  Journal journal(out / "pipeline.json", reporter);

  // Acquire the reflectance field 110: silhouettes, hull 111, reflectance images 112.
  const std::string capture_stamp = captureStamp(capture, out) + " " + std::to_string(options.tolerance);
  journal.step("acquire", capture_stamp, fs::exists(field_folder / "manifest.json"), [&] {
    AcquireOptions acquire;
    acquire.memory_bytes = options.memory_bytes;
    acquire.hull.tolerance = options.tolerance;
    acquire.command = options.command;
    acquireField(capture, field_folder, acquire, reporter);
  });

  // The deformable model with its local parameterization.
  Stamp model_stamp(capture_stamp + options.kind + options.fit + std::to_string(kFitVersion));
  model_stamp.addFile(options.shape);
  const bool has_model = fs::exists(field_folder) && !readManifest(field_folder).active_model.empty();
  journal.step("model", model_stamp.text(), has_model, [&] {
    ModelOptions model;
    model.kind = options.kind == "surfels" ? ModelKind::surfels : ModelKind::mesh;
    std::optional<FitOptions> fit;
    if (options.fit == "auto") fit = FitOptions{options.memory_bytes};
    makeModel(field_folder, options.shape, model, fit, reporter);
  });

  // Deform 120, look up 130, shade 140: the images 104.
  AnimationOptions animation;
  animation.srf = field_folder;
  animation.output = (out / "frames" / "frame.####.exr").string();
  if (!options.frames.empty()) animation.frames = parseFrames(options.frames, "--frames");
  animation.resume = true;
  animation.support = true;
  animation.memory_bytes = options.memory_bytes;
  animation.command = options.command;
  animation.finished = FrameLines(reporter);
  const std::vector<RenderedFrame> frames = renderAnimation(scene, animation, reporter);

  // What people look at.
  PipelineReport report;
  const std::vector<RenderedFrame> sheet = spread(frames, 12);
  std::vector<ImageF> pictures;
  for (const RenderedFrame& frame : sheet) {
    pictures.push_back(readImage(frame.file).pixels);
    report.sheet_frames.push_back(frame.frame);
  }
  report.exposure = displayExposure(pictures);
  report.contact_sheet = out / "contact_sheet.png";
  writePng(report.contact_sheet, contactSheet(pictures, 4, 256, report.exposure));

  const fs::path video = out / "animation.mp4";
  Stamp video_stamp(std::to_string(scene.fps));
  for (const RenderedFrame& frame : frames) video_stamp.addFile(frame.file);
  try {
    journal.step("video", video_stamp.text(), fs::exists(video),
                 [&] { writeVideo(video, frames, scene.fps, report.exposure, reporter); });
    report.video = video;
  } catch (const Error& e) {
    throwIfInterrupted();  // Ctrl-C ends ffmpeg too
    reporter.warn(std::string("no video: ") + e.what());
  }

  const SrfManifest field = readManifest(field_folder);
  const DeformableModel model = loadModel(field_folder, field);
  report.command = options.command;
  report.scene = options.scene;
  report.field = field;
  if (const StoredFile* hull = field.shape("hull")) report.hull = readMesh(field_folder / hull->file);
  report.model = std::to_string(model.size()) + (model.kind == ModelKind::mesh ? " points, " : " surfels, ") +
                 (model.triangles.empty() ? "" : std::to_string(model.triangles.size()) + " triangles, ") + "from " +
                 model.shape;
  report.bounds = model.bounds();
  report.frames = frames;
  journal.fill(report);
  writeTextFile(out / "report.html", reportPage(report));
}

}  // namespace
}  // namespace srf

int main(int argc, char** argv) {
  srf::Program program(
      "pipeline",
      "Photographs to animation in one go. Writes field.srf, frames/, animation.mp4, contact_sheet.png and "
      "report.html into the output folder; run again, it does only what is left to do.",
      "GPL-3.0-or-later (links CGAL)");
  srf::PipelineOptions options;
  CLI::App& app = program.app();
  app.add_option("capture", options.capture, "capture folder")->required();
  app.add_option("--scene", options.scene, "scene.json; its srf and output are not used")->required();
  app.add_option("-o,--output", options.output, "output folder")->required();
  app.add_option("--kind", options.kind, "mesh or surfels")
      ->check(CLI::IsMember({"mesh", "surfels"}))
      ->capture_default_str();
  app.add_option("--shape", options.shape, "hull, sphere, box, cylinder, plane, torus, or a mesh or point file")
      ->capture_default_str();
  app.add_option("--fit", options.fit, "auto: a reflectance model that guides interpolation is fitted; off")
      ->check(CLI::IsMember({"auto", "off"}))
      ->capture_default_str();
  app.add_option("--tolerance", options.tolerance, "views that may disagree at a point without carving it away")
      ->check(CLI::Range(0, 1000))
      ->capture_default_str();
  app.add_option("--frames", options.frames, "frames instead of the scene's, e.g. 0-10");
  app.add_option("--set", options.overrides, "/json/pointer=value: changes the scene; may be repeated")
      ->allow_extra_args(false);
  return program.run(argc, argv, [&](srf::Reporter& reporter) {
    options.command = program.commandLine();
    options.memory_bytes = program.memoryBudget();
    srf::runPipeline(options, reporter);
    std::printf("%s\n", (fs::path(options.output) / "report.html").c_str());
  });
}
