// `srf study`: what accuracy costs in time, on the user's own scene (M18).
#include <algorithm>
#include <chrono>
#include <nlohmann/json.hpp>

#include "apps/capture_page.h"
#include "apps/field_variants.h"
#include "apps/program.h"
#include "apps/study_file.h"
#include "apps/study_page.h"
#include "apps/study_plan.h"
#include "base/error.h"
#include "base/files.h"
#include "base/image_io.h"
#include "base/numeric.h"
#include "base/text.h"
#include "field/srf_folder.h"
#include "render/animation.h"

namespace srf {
namespace {

namespace fs = std::filesystem;

constexpr int kPasses = 2;              // of a setting over the frames
constexpr int kLeastPicture = 96;       // pixels a side that a study's pictures keep
constexpr double kOneAtATime = 18;      // settings of about the exact one's cost, besides fields; a planning figure
constexpr double kMakingAField = 0.05;  // of the budget, at most
// Of the budget: where one knob at a time should end, and where the search does, for the front's promises to follow.
constexpr double kKnobsEnd = 0.45, kSearchEnd = 0.75;
constexpr std::size_t kFurther = 2;  // frames for a promise, besides each studied one

/// Of `candidates` up to `count` that are not in `studied`, each as far as it goes from these and from those before it:
/// the ends of the animation soon, for motion is often largest there.
std::vector<int> framesApart(const std::vector<int>& candidates, const std::vector<int>& studied, std::size_t count) {
  std::vector<std::size_t> taken;
  for (std::size_t i = 0; i < candidates.size(); ++i)
    if (std::find(studied.begin(), studied.end(), candidates[i]) != studied.end()) taken.push_back(i);
  std::vector<int> frames;
  count = std::min(count, candidates.size() - taken.size());
  while (frames.size() < count) {
    std::size_t farthest = 0, most = 0;
    for (std::size_t i = 0; i < candidates.size(); ++i) {
      std::size_t nearest = candidates.size();
      for (const std::size_t t : taken) nearest = std::min(nearest, i > t ? i - t : t - i);
      if (nearest > most) farthest = i, most = nearest;
    }
    taken.push_back(farthest);
    frames.push_back(candidates[farthest]);
  }
  return frames;
}

/// "90", "90s", "10m", "1.5h" to seconds.
double parseBudget(const std::string& text) {
  std::size_t used = 0;
  double value = 0;
  try {
    value = std::stod(text, &used);
  } catch (const std::exception&) {
    used = 0;
  }
  const std::map<std::string, double> units{{"", 1}, {"s", 1}, {"m", 60}, {"h", 3600}};
  const auto unit = units.find(text.substr(used));
  if (used == 0 || unit == units.end() || !(value > 0 && value < 1e6))
    throw Error(ErrorKind::usage, "found '" + text + "', expected a time such as 90s, 10m or 1h", "--budget");
  return value * unit->second;
}

std::string shortText(const SceneKeys& keys) {
  std::string out;
  for (const auto& [key, value] : keys)
    out += (out.empty() ? "" : " ") + key.substr(key.rfind('/') + 1) + "=" +
           (key == kFieldKey ? pathOf(value).filename().string() : value);
  return out;
}

struct Options {
  std::string scene, output, reference;
  fs::path srf;
  double budget = 600;
  int frames = 3;
  bool other_fields = true;  ///< makes fields to try too
  std::size_t memory_bytes = 0;
};

class Studying {
 public:
  Studying(const Options& options, Reporter& reporter) : options_(options), reporter_(reporter) {}

  void run() {
    const Scene scene = readScene(options_.scene, {}, reporter_);
    open(scene);
    if (options_.other_fields)
      field_knobs_ =
          fieldKnobs(study_.field, scene.deformation.movesVertices(), kMakingAField * options_.budget, reporter_);
    if (study_.exact.empty()) plan(scene);
    if (!study_.exact.contains(kFieldKey)) field_knobs_.clear();
    study_.knobs = knobsOf(study_.exact, study_.own, options_.memory_bytes, field_knobs_, folder_ / "fields");
    measureExact(scene);
    const bool whole = measureAll();
    study_.complete = whole;
    save();
    keepTheFront();
    writeTextFile(folder_ / "study.csv", studyTable(study_));
    writeTextFile(folder_ / "study.html", studyPage(study_, [&](const MeasuredSetting& m) { return picture(m); }));
    reporter_.result((folder_ / "study.html").string() +
                     format("  %zu settings, %zu measured now%s", study_.measured.size(), rendered_,
                            whole ? "" : "; the budget ended it: run again to go on"));
  }

 private:
  double elapsed() const { return std::chrono::duration<double>(std::chrono::steady_clock::now() - start_).count(); }
  std::string pattern(const SceneKeys& keys, std::size_t memory = 0) const {
    if (keys == study_.exact && !memory) return (folder_ / "frames" / "exact.####.exr").string();
    std::string text = std::to_string(memory);
    for (const std::string& set : overridesOf(keys)) text += " " + set;
    return (folder_ / "frames" / (hexHash(contentHash(text.data(), text.size())) + ".####.exr")).string();
  }
  int middleFrame() const { return study_.frames[study_.frames.size() / 2]; }
  ImageF picture(const MeasuredSetting& m) const {
    const fs::path file = frameFile(pattern(m.keys, m.memory_bytes), middleFrame());
    return fs::exists(file) ? readImage(file).pixels : ImageF();
  }
  MeasuredSetting& changeable(const MeasuredSetting& of_the_study) {
    return study_.measured[static_cast<std::size_t>(&of_the_study - study_.measured.data())];
  }
  void save() const { writeStudy(folder_ / "study.json", study_); }

  /// The frames to look at, and what an earlier run has measured of the same input.
  void open(const Scene& scene) {
    const fs::path srf = options_.srf.empty() ? scene.srf : options_.srf;
    if (srf.empty()) throw badInput(scene.file.string(), "names no field; add \"srf\" to it or give --srf X.srf");
    std::vector<int> candidates = scene.frames;
    if (!options_.reference.empty()) {
      std::erase_if(candidates, [&](int frame) { return !fs::exists(frameFile(options_.reference, frame)); });
      if (candidates.empty())
        throw Error(ErrorKind::bad_input, "no frame of the scene has a file '" + options_.reference + "'",
                    "--reference");
    }
    std::sort(candidates.begin(), candidates.end());
    candidates.erase(std::unique(candidates.begin(), candidates.end()), candidates.end());
    const std::size_t count = std::min<std::size_t>(candidates.size(), static_cast<std::size_t>(options_.frames));
    std::vector<int> frames;
    for (std::size_t i = 0; i < count; ++i) frames.push_back(candidates[(2 * i + 1) * candidates.size() / (2 * count)]);
    const std::vector<int> further = framesApart(candidates, frames, kFurther * count);
    std::vector<int> all = frames;
    all.insert(all.end(), further.begin(), further.end());

    std::string input = hexHash(scene.content_hash);
    const auto mix = [&](const fs::path& file) {
      const auto bytes = readBinaryFile(file);
      input += hexHash(contentHash(bytes.data(), bytes.size()));
    };
    mix(srf / "manifest.json");
    if (scene.deformation.movesVertices()) {
      // Where the files of a skin or a mesh sequence put the vertices at the moments that are looked at.
      const auto motion =
          scene.deformation.vertexMotion(loadModel(srf, readManifest(srf)).restMesh(), scene.fps, reporter_);
      for (const int frame : all)
        for (const double moment : momentsOf(scene.effects, frame)) {
          const auto& positions = motion->at(moment).positions;
          input += hexHash(contentHash(positions.data(), positions.size() * sizeof positions[0]));
        }
    }
    for (const SceneLight& light : scene.lights)
      if (const auto* environment = std::get_if<EnvironmentLight>(&light)) mix(environment->map);
    for (const int frame : all) {
      input += "," + std::to_string(frame);
      if (!options_.reference.empty()) mix(frameFile(options_.reference, frame));
    }
    folder_ = options_.output;
    const std::string hash = hexHash(contentHash(input.data(), input.size()));
    if (fs::exists(folder_ / "study.json")) {
      study_ = readStudy(folder_ / "study.json");
      if (study_.input_hash != hash) {
        reporter_.warn((folder_ / "study.json").string() +
                       ": is of another scene, field or frames; the study begins anew");
        fs::remove_all(folder_ / "frames");
        fs::remove_all(folder_ / "fields");
        study_ = {};
      }
    }
    study_.scene = options_.scene;
    study_.field = srf.string();
    study_.reference = options_.reference;
    study_.input_hash = hash;
    study_.scene_hash = hexHash(scene.content_hash);
    study_.frames = frames;
    study_.further_frames = further;
    study_.passes = kPasses;
  }

  /// Renders one frame to learn what the scene uses and what it costs, and settles what "exact" is within the budget.
  void plan(const Scene& scene) {
    Reporter quiet(ProgressMode::none, LogLevel::error);
    AnimationOptions options = animationOptions({});
    options.output = (folder_ / "frames" / "probe.####.exr").string();
    options.frames = {middleFrame(), middleFrame()};
    // As exact as exactSetting would have it, but for samples and lights: their cost is told by their number.
    const Scene bare = readScene(
        options_.scene, {"/samples=1", "/accuracy/light_sharing=0", "/accuracy/shadow_rays=1000000"}, reporter_);
    SceneProbe probe;
    probe.seconds = renderAnimation(bare, options, quiet).back().seconds;
    fs::remove(frameFile(options.output, middleFrame()));
    for (const std::string& warning : quiet.warnings()) reporter_.warn(warning);
    const auto counters = quiet.counters();
    probe.shadow_rays = counters.contains("shadow_rays");
    probe.guided = counters.contains("model_values") && scene.interpolation != Interpolation::plain;
    const double a_frame =
        kKnobsEnd * options_.budget / (plannedSettings() * kPasses * static_cast<double>(study_.frames.size()));
    study_.own = ownSetting(scene, probe);
    study_.exact = exactSetting(scene, probe, a_frame);
    study_.own[kFieldKey] = study_.exact[kFieldKey] = pathText(study_.field);
    choosePictureSize(scene, exactSeconds(scene, probe, study_.exact), a_frame);
  }

  /// One knob at a time, in settings of about the exact one's cost.
  double plannedSettings() const {
    double settings = kOneAtATime;
    for (const FieldKnob& knob : field_knobs_) settings += static_cast<double>(knob.variants.size());
    return settings;
  }

  /// Where an exact frame takes longer than the time allows, the study's pictures are smaller than the scene's.
  void choosePictureSize(const Scene& scene, double seconds, double a_frame) {
    const auto* look_at = std::get_if<LookAtCamera>(&scene.camera);
    if (!look_at || !options_.reference.empty()) return;
    const int least = std::min(look_at->width, look_at->height);
    const int before = study_.divisor;
    while (seconds * square(static_cast<double>(before) / study_.divisor) > a_frame &&
           least / (study_.divisor + 1) >= kLeastPicture)
      ++study_.divisor;
  }
  std::vector<std::string> overrides(const Scene& scene, const SceneKeys& keys) const {
    std::vector<std::string> out = overridesOf(keys);
    if (study_.divisor > 1) {
      const auto& look_at = std::get<LookAtCamera>(scene.camera);
      out.push_back("/camera/w=" + std::to_string(look_at.width / study_.divisor));
      out.push_back("/camera/h=" + std::to_string(look_at.height / study_.divisor));
    }
    return out;
  }
  /// Seconds of a warm frame of full size.
  double fullSizeSeconds(const SceneKeys& keys) const {
    Reporter quiet(ProgressMode::none, LogLevel::error);
    AnimationOptions options = animationOptions(keys);
    options.output = (folder_ / "frames" / "full.####.exr").string();
    options.frames.assign(kPasses, middleFrame());
    const auto frames = renderAnimation(readScene(options_.scene, overridesOf(keys), quiet), options, quiet);
    fs::remove(frameFile(options.output, middleFrame()));
    return frames.back().seconds;
  }
  /// Times of the study's own pictures become those of full size: measured, or as many times longer as there are more
  /// pixels, which is too long rather than too short.
  void toFullSize(MeasuredSetting& m, bool measured) const {
    const double before = m.full_size;
    const double small = m.seconds[study_.frames.size() / 2] / before;
    m.full_size = measured ? fullSizeSeconds(m.keys) / small : square(study_.divisor);
    m.full_size_measured = measured || study_.divisor == 1;
    const double change = m.full_size / before;
    for (double& seconds : m.seconds) seconds *= change;
    m.spread *= change, m.cold *= change;
  }

  AnimationOptions animationOptions(const SceneKeys& keys) const {
    AnimationOptions options;
    const auto field = keys.find(kFieldKey);
    options.srf = field == keys.end() ? fs::path(study_.field) : pathOf(field->second);
    options.memory_bytes = options_.memory_bytes;
    return options;
  }
  fs::path fieldOf(const FieldVariant& variant) const { return folder_ / "fields" / variant.name; }
  /// Where the setting's field is one of the study's own and not there yet.
  void makeField(const SceneKeys& keys) const {
    for (const FieldKnob& knob : field_knobs_)
      for (const FieldVariant& variant : knob.variants)
        if (const fs::path field = fieldOf(variant); keys.at(kFieldKey) == pathText(field) && !isSrfFolder(field)) {
          Reporter quiet(ProgressMode::none, LogLevel::error);
          makeVariant(study_.field, variant, field, options_.memory_bytes, quiet);
        }
  }

  /// The all-exact pictures; smaller ones than planned where they turn out to take too long.
  void measureExact(const Scene& scene) {
    if (!study_.find(study_.exact) || !exactPicturesOf(study_.frames)) {
      std::erase_if(study_.measured,
                    [&](const MeasuredSetting& m) { return m.keys == study_.exact && !m.memory_bytes; });
      measure(study_.exact, 0);
      const int planned = study_.divisor;
      const double renderings = kPasses * static_cast<double>(study_.frames.size());
      if (study_.measured.size() == 1)
        choosePictureSize(scene, last_seconds_ / renderings,
                          (kKnobsEnd * options_.budget - elapsed()) / (plannedSettings() * renderings));
      if (study_.divisor != planned) {
        study_.measured.clear();
        measure(study_.exact, 0);
      }
    }
  }

  /// False where the budget ended it.
  bool measureAll() {
    std::vector<std::pair<SceneKeys, std::size_t>> todo{{study_.own, 0}};
    for (const Knob& knob : study_.knobs)
      for (std::size_t i = 0; i < knob.values.size(); ++i)
        todo.emplace_back(knob.values[i], knob.memory.empty() ? 0 : knob.memory[i]);
    if (!measureList("one knob at a time", todo, options_.budget)) return false;
    todo.clear();
    if (!study_.complete)  // times at full size would have it search on
      for (const SceneKeys& keys : worthTrying(study_)) todo.emplace_back(keys, 0);
    const bool searched = measureList("search", todo, kSearchEnd * options_.budget);
    const bool timed = measureFrontAtFullSize();
    return checkTheFront() && timed && searched;
  }

  /// What srf render chooses from; the fastest first, for a time that becomes shorter can push others off the front.
  bool measureFrontAtFullSize() {
    for (;;) {
      const auto front = study_.front();
      const auto next = std::find_if(front.begin(), front.end(), [](const auto* m) { return !m->full_size_measured; });
      if (next == front.end()) return true;
      if (elapsed() + kPasses * (*next)->worstSeconds() > options_.budget) return false;
      toFullSize(changeable(**next), true);
      save();
    }
  }

  /// The further frames of the front, as many of them as the time left allows; false where these are not all.
  bool checkTheFront() {
    const std::size_t all = study_.further_frames.size();
    std::vector<MeasuredSetting*> todo;
    double a_frame = 0;
    for (const MeasuredSetting* m : study_.front())
      if (m->further.size() < all) {
        todo.push_back(&changeable(*m));
        a_frame += m->worstSeconds() / m->full_size;
      }
    if (todo.empty()) return true;
    const auto fitting = std::max(0.0, (options_.budget - elapsed()) / a_frame - 1);  // one for opening files
    const std::size_t count = std::min(all, static_cast<std::size_t>(fitting));
    std::erase_if(todo, [&](const MeasuredSetting* m) { return m->further.size() >= count; });
    if (todo.empty()) return false;
    const std::vector<int> frames(study_.further_frames.begin(),
                                  study_.further_frames.begin() + static_cast<std::ptrdiff_t>(count));
    const bool exact_kept = exactPicturesOf(frames);
    Reporter::Stage stage(reporter_, "promises of the front", todo.size() + !exact_kept);
    if (!exact_kept) {
      renderSetting(study_.exact, 0, frames);
      stage.advance();
    }
    for (MeasuredSetting* m : todo) {
      m->further.clear();
      if (m->keys != study_.exact) renderSetting(m->keys, 0, frames);
      for (const int frame : frames) {
        const fs::path file = frameFile(pattern(m->keys), frame);
        m->further.push_back(frameError(readImage(file).pixels, exactPicture(frame)));
        if (m->keys != study_.exact) fs::remove(file);
      }
      save();
      stage.advance();
    }
    return count == all;
  }

  bool measureList(const std::string& name, std::vector<std::pair<SceneKeys, std::size_t>> todo, double end) {
    std::erase_if(todo, [&](const auto& entry) { return study_.find(entry.first, entry.second) != nullptr; });
    if (todo.empty()) return true;
    Reporter::Stage stage(reporter_, name, todo.size());
    for (const auto& [keys, memory] : todo) {
      if (elapsed() + last_seconds_ > end) return false;
      if (!study_.find(keys, memory)) measure(keys, memory);
      stage.advance();
    }
    return true;
  }

  /// The frames, and the figures that they ended with. Makes the field where it is not there.
  std::pair<std::vector<RenderedFrame>, std::map<std::string, double>> renderSetting(
      const SceneKeys& keys, std::size_t memory, const std::vector<int>& frames) const {
    Reporter quiet(ProgressMode::none, LogLevel::error);
    makeField(keys);
    const Scene scene = readScene(options_.scene, overrides(readScene(options_.scene, {}, quiet), keys), quiet);
    AnimationOptions options = animationOptions(keys);
    options.output = pattern(keys, memory);
    if (memory) options.memory_bytes = memory;
    options.frames = frames;
    auto rendered = renderAnimation(scene, options, quiet);
    return {std::move(rendered), quiet.figures()};
  }
  bool exactPicturesOf(const std::vector<int>& frames) const {
    return std::all_of(frames.begin(), frames.end(),
                       [&](int frame) { return fs::exists(frameFile(pattern(study_.exact), frame)); });
  }
  ImageF exactPicture(int frame) const { return readImage(frameFile(pattern(study_.exact), frame)).pixels; }

  void measure(const SceneKeys& keys, std::size_t memory) {
    const double start = elapsed();
    std::vector<int> passes;
    for (int pass = 0; pass < kPasses; ++pass) passes.insert(passes.end(), study_.frames.begin(), study_.frames.end());
    const auto [frames, figures] = renderSetting(keys, memory, passes);
    MeasuredSetting m;
    m.keys = keys;
    m.memory_bytes = memory;
    m.cold = frames.front().seconds;
    const std::size_t count = study_.frames.size();
    for (std::size_t f = 0; f < count; ++f) {
      std::vector<double> repeats;
      for (std::size_t i = f; i < frames.size(); i += count)
        if (i > 0) repeats.push_back(frames[i].seconds);
      m.seconds.push_back(median(repeats));
      const auto [least, most] = std::minmax_element(repeats.begin(), repeats.end());
      m.spread += (*most - *least) / static_cast<double>(count);
      const ImageF image = readImage(frames[f].file).pixels;
      m.exact.push_back(frameError(image, exactPicture(study_.frames[f])));
      if (!options_.reference.empty())
        m.truth.push_back(frameError(image, readImage(frameFile(options_.reference, study_.frames[f])).pixels));
      if (keys != study_.exact && study_.frames[f] != middleFrame()) fs::remove(frames[f].file);
    }
    if (memory) fs::remove(frameFile(pattern(keys, memory), middleFrame()));
    toFullSize(m, study_.divisor > 1 && keys == study_.own && !memory);
    const auto figure = [&figures = figures](const char* name) {
      return figures.contains(name) ? figures.at(name) : 0;
    };
    m.bytes_read = figure("cache.bytes_read");
    m.peak_bytes = figure("cache.peak_bytes");
    m.field_bytes = static_cast<double>(bytesInFolder(animationOptions(keys).srf));
    study_.measured.push_back(m);
    save();
    ++rendered_;
    reporter_.count("study.settings_rendered");
    reporter_.result(shortText(keys) +
                     format("  %.3f s a frame, error %.3f %%", m.worstSeconds(), 100 * m.worstError()));
    last_seconds_ = elapsed() - start;
  }

  /// A setting that another one beats stays beaten: its picture is not shown again, nor its field used.
  void keepTheFront() const {
    const auto front = study_.front();
    for (const FieldKnob& knob : field_knobs_)
      for (const FieldVariant& variant : knob.variants) {
        const std::string text = pathText(fieldOf(variant));
        const auto uses = [&](const MeasuredSetting* m) { return m->keys.at(kFieldKey) == text; };
        if (study_.complete && std::none_of(front.begin(), front.end(), uses)) fs::remove_all(fieldOf(variant));
      }
    for (const MeasuredSetting& m : study_.measured)
      if (m.keys != study_.exact && m.keys != study_.own && std::find(front.begin(), front.end(), &m) == front.end())
        fs::remove(frameFile(pattern(m.keys, m.memory_bytes), middleFrame()));
  }

  const Options& options_;
  Reporter& reporter_;
  const std::chrono::steady_clock::time_point start_ = std::chrono::steady_clock::now();
  fs::path folder_;
  std::vector<FieldKnob> field_knobs_;
  Study study_;
  std::size_t rendered_ = 0;
  double last_seconds_ = 0;
};

void runCaptureStudy(const fs::path& srf_folder, const fs::path& output, const CaptureStudyOptions& options,
                     Reporter& reporter) {
  std::vector<ShownPrediction> shown;
  const CaptureStudy study = studyCapture(srf_folder, options, shown, reporter);
  fs::create_directories(output);
  writeCaptureStudy(output / "capture.json", study);
  writeTextFile(output / "capture.csv", captureTable(study));
  writeTextFile(output / "capture.html", capturePage(study, shown));
  for (const std::string& sentence : captureSentences(study)) reporter.result(sentence);
  reporter.result((output / "capture.html").string());
}

}  // namespace
}  // namespace srf

int main(int argc, char** argv) {
  using namespace srf;
  Program program(
      "study",
      "Measures what accuracy costs in time on a scene: each knob of the renderer alone, then the best "
      "combinations. Writes study.json, study.csv and the page study.html; srf render --quality uses them. "
      "A study that was interrupted, or whose budget ended, goes on when run again. With --capture instead: "
      "how well the capture itself foretells photographs that were left out of it, and what more views or "
      "lights would bring; writes capture.json, capture.csv and capture.html.");
  Options options;
  std::string capture;
  CaptureStudyOptions capture_options;
  std::string budget = "10m";
  program.app().add_option("scene", options.scene, "scene.json");
  program.app().add_option("-o,--output", options.output, "folder of the study")->required();
  program.app().add_option("--srf", options.srf, "the field, X.srf; default: the scene's");
  program.app().add_option("--budget", budget, "time of this run: 90s, 10m, 1h")->capture_default_str();
  program.app().add_option("--reference", options.reference, "true pictures to compare with too, name.####.exr");
  program.app()
      .add_option("--frames", options.frames, "number of the scene's frames to study, spread over the animation")
      ->check(CLI::Range(1, 1000))
      ->capture_default_str();
  program.app().add_flag("!--no-other-fields", options.other_fields,
                         "turn the scene's knobs alone; else fields of other codings, hulls and surfels are made too, "
                         "in the study's folder");
  program.app().add_option("--capture", capture, "X.srf: study the capture that it holds, no scene");
  program.app()
      .add_option("--pictures", capture_options.pictures, "with --capture: photographs to foretell, of each kind")
      ->check(CLI::Range(1, 1000))
      ->capture_default_str();
  return program.run(argc, argv, [&](Reporter& reporter) {
    if (capture.empty() == options.scene.empty())
      throw Error(ErrorKind::usage, "expected a scene.json, or --capture X.srf without one", "srf study");
    if (!capture.empty()) {
      capture_options.memory_bytes = program.memoryBudget();
      runCaptureStudy(capture, options.output, capture_options, reporter);
      return;
    }
    options.budget = parseBudget(budget);
    options.memory_bytes = program.memoryBudget();
    Studying(options, reporter).run();
  });
}
