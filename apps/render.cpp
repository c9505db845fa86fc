// `srf render`: a scene to frames.
#include <cstdio>

#include "apps/frame_lines.h"
#include "apps/program.h"
#include "apps/study_file.h"
#include "base/error.h"
#include "base/files.h"
#include "render/animation.h"

namespace {

/// The keys of the study's setting that keeps the targets, before the user's own.
std::vector<std::string> withQuality(const std::string& file, std::optional<double> error,
                                     std::optional<double> seconds, const std::string& scene_file,
                                     const std::string& srf_folder, const std::vector<std::string>& own,
                                     srf::Reporter& reporter) {
  using namespace srf;
  const Study study = readStudy(file);
  if (hexHash(readScene(scene_file, {}, reporter).content_hash) != study.scene_hash)
    reporter.warn(file + ": is the study of another scene (" + study.scene +
                  "), or of this one before it was changed: " + "its promises may not hold");
  const SceneKeys& chosen = chooseSetting(study, error, seconds, file).keys;
  if (const auto field = chosen.find(kFieldKey);
      !srf_folder.empty() && field != chosen.end() && field->second != study.exact.at(kFieldKey))
    reporter.warn(file + ": promises what the field " + pathOf(field->second).string() + " gives, but --srf names " +
                  srf_folder);
  std::vector<std::string> overrides = overridesOf(chosen);
  std::string text = file + ":";
  for (const std::string& set : overrides) text += " " + set;
  reporter.result(text);
  overrides.insert(overrides.end(), own.begin(), own.end());
  return overrides;
}

}  // namespace

int main(int argc, char** argv) {
  using namespace srf;
  Program program("render", "Renders the frames of a scene: deforms the model, relights it, writes OpenEXR files.");
  std::string scene_file, frames, quality;
  std::optional<double> target_error, target_time;
  std::vector<std::string> overrides;
  AnimationOptions options;
  CLI::App& app = program.app();
  app.add_option("scene", scene_file, "scene.json")->required();
  app.add_option("--srf", options.srf, "the field, X.srf; default: the scene's");
  app.add_option("-o,--output", options.output, "pattern of the frames, name.####.exr; default: the scene's");
  app.add_option("--frames", frames, "frames instead of the scene's, e.g. 0-10, 0-60x2 or 1,5,9");
  app.add_option("--set", overrides, "/json/pointer=value: changes the scene; may be repeated")
      ->allow_extra_args(false);
  app.add_option("--aovs", options.layers,
                 "layers to add: P, P0, N, L, handedness, stretch, shear, fallback, overlap, V, Z, view, confidence, "
                 "light_angle, extrapolation, occlusion")
      ->delimiter(',');
  app.add_option("--quality", quality,
                 "study.json of srf study: its setting that keeps the targets; --set wins over it");
  app.add_option("--target-error", target_error, "with --quality: most mean relative error, e.g. 0.01; 0: all exact")
      ->check(CLI::NonNegativeNumber);
  app.add_option("--target-time", target_time, "with --quality: most seconds a frame, as the study measured them")
      ->check(CLI::PositiveNumber);
  app.add_flag("--resume", options.resume, "keep frames that the same input and settings have finished");
  return program.run(argc, argv, [&](Reporter& reporter) {
    options.memory_bytes = program.memoryBudget();
    options.command = program.commandLine();
    if (!frames.empty()) options.frames = parseFrames(frames, "--frames");
    if (quality.empty() != (!target_error && !target_time))
      throw Error(ErrorKind::usage, "goes with --target-error or --target-time, and they with it", "--quality");
    if (!quality.empty())
      overrides = overrides =
          withQuality(quality, target_error, target_time, scene_file, options.srf.string(), overrides, reporter);
    const Scene scene = readScene(scene_file, overrides, reporter);
    options.finished = FrameLines(reporter);
    options.support = program.statsWanted();
    double seconds = 0;
    std::size_t rendered = 0;
    FrameSupport support;
    for (const RenderedFrame& frame : renderAnimation(scene, options, reporter)) {
      if (!frame.kept) seconds += frame.seconds, ++rendered;
      if (frame.support) support.add(*frame.support);
    }
    if (support.hits > 0) reporter.result(support.text());
    if (rendered > 1) std::printf("%zu frames, %.3f s each\n", rendered, seconds / static_cast<double>(rendered));
  });
}
