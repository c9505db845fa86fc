#include "apps/explain_plan.h"

#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <optional>
#include <utility>

#include "base/numeric.h"
#include "base/parallel.h"
#include "base/text.h"
#include "field/srf_folder.h"
#include "render/capture_support.h"
#include "render/light_set.h"
#include "render/light_weights.h"

namespace srf {
namespace {

namespace fs = std::filesystem;

/// A folder for one frame that is gone afterwards.
class Scratch {
 public:
  Scratch() : path_(fs::temp_directory_path() / ("srf-explain-" + std::to_string(::getpid()))) {}
  ~Scratch() {
    std::error_code code;
    fs::remove_all(path_, code);
  }
  const fs::path& path() const { return path_; }

 private:
  fs::path path_;
};

struct LightCounts {
  std::size_t directional = 0, near_lights = 0, environments = 0, environment_samples = 0, captured = 0, from_file = 0;
  bool every_texel = false;
};
LightCounts countLights(const Scene& scene) {
  LightCounts counts;
  for (const SceneLight& light : scene.lights) {
    counts.directional += std::holds_alternative<DirectionalLight>(light);
    counts.near_lights += std::holds_alternative<PointLight>(light);
    counts.captured += std::holds_alternative<CapturedLight>(light);
    counts.from_file += std::holds_alternative<FileLights>(light);
    if (const auto* environment = std::get_if<EnvironmentLight>(&light)) {
      ++counts.environments;
      counts.environment_samples += environment->samples;
      counts.every_texel |= environment->samples == 0;
    }
  }
  return counts;
}

std::size_t distantLights(const Scene& scene, const AnimationOptions& options, int frame) {
  const SrfManifest field = readManifest(options.srf.empty() ? scene.srf : options.srf);
  return LightSet(scene, field, Reporter::silent()).at(frame).distant.size();
}

/// The scene with a picture 1 / divisor as wide and high; none where that would be next to nothing, or where a file
/// holds the camera.
std::optional<Scene> smaller(const Scene& scene, int divisor) {
  constexpr int kLeast = 16;  // pixels a side
  Scene small = scene;
  if (auto* look_at = std::get_if<LookAtCamera>(&small.camera)) {
    look_at->width /= divisor, look_at->height /= divisor;
    if (std::min(look_at->width, look_at->height) >= kLeast) return small;
  }
  return std::nullopt;
}

/// Frames of one scene, rendered with the shortcuts or without to be timed.
struct TimedFrames {
  const Scene& scene;
  AnimationOptions options;
  double seconds = 0, hits = 0;  ///< of a warm frame, when it was last timed

  TimedFrames(const Scene& of, const AnimationOptions& base, int frame, bool shortcuts) : scene(of), options(base) {
    options.shortcuts = shortcuts;
    options.support = false;
    options.frames = {frame};
  }
  /// The mean of as many warm frames as take `least` seconds, going by the last time: what else the machine does then
  /// slows short frames and long ones alike. A first frame, not counted, fills the cache.
  void time(double least) {
    constexpr double kMost = 200;
    const double count = seconds > 0 ? std::clamp(std::ceil(least / seconds), 1.0, kMost) : 1;
    options.frames.resize(1 + static_cast<std::size_t>(count), options.frames.front());
    Reporter quiet(ProgressMode::none, LogLevel::error);
    const auto frames = renderAnimation(scene, options, quiet);
    seconds = 0;
    for (std::size_t i = 1; i < frames.size(); ++i) seconds += frames[i].seconds / count;
    hits = static_cast<double>(quiet.counters()["hits"]) / static_cast<double>(frames.size());
  }
};

/// The median over some rounds of what `factor` makes of the times of `all`, taken in turns.
template <class Factor>
double timedInTurns(std::initializer_list<TimedFrames*> all, const Factor& factor) {
  constexpr int kRounds = 3;
  double least = 0;
  for (TimedFrames* frames : all) {
    frames->time(0);
    least = std::max(least, frames->seconds);
  }
  std::vector<double> factors;
  for (int round = 0; round < kRounds; ++round) {
    for (TimedFrames* frames : all) frames->time(least);
    factors.push_back(factor());
  }
  return median(factors);
}

/// How many times as long as it does a frame of `hits` hits would take without the shortcuts: foretold from a smaller
/// picture rendered both ways, for what the shortcuts save is the same at every hit. Where that is little, a difference
/// of short times tells nothing and the frame itself is rendered both ways. 0: the picture is too small to tell.
double promisedFactor(const Scene& scene, const AnimationOptions& options, int frame, double hits) {
  constexpr double kEnough = 5000;  // hits a thread
  constexpr double kLittle = 3;     // times as long
  const auto small = smaller(scene, static_cast<int>(std::max(2.0, std::sqrt(hits / (kEnough * threadCount())))));
  if (!small) return 0;
  TimedFrames general(*small, options, frame, false), shortcut(*small, options, frame, true),
      whole(scene, options, frame, true);
  const double factor = timedInTurns({&general, &shortcut, &whole}, [&] {
    return general.hits > 0 ? 1 + (general.seconds - shortcut.seconds) * (hits / general.hits) / whole.seconds : 0;
  });
  return factor < kLittle ? measuredFactor(scene, options, frame) : factor;
}

}  // namespace

double measuredFactor(const Scene& scene, AnimationOptions options, int frame) {
  const Scratch scratch;
  options.output = (scratch.path() / "frame.####.exr").string();
  TimedFrames general(scene, options, frame, false), shortcut(scene, options, frame, true);
  return timedInTurns({&general, &shortcut}, [&] { return general.seconds / shortcut.seconds; });
}

Json planOfFrame(const Scene& scene, AnimationOptions options, int frame, Reporter& reporter) {
  const Scratch scratch;
  options.output = (scratch.path() / "frame.####.exr").string();
  options.frames = {frame};
  options.support = true;
  const std::vector<RenderedFrame> rendered = renderAnimation(scene, options, reporter);
  const auto counters = reporter.counters();
  const auto figures = reporter.figures();
  const auto counted = [&](const char* name) {
    const auto at = counters.find(name);
    return at == counters.end() ? 0.0 : static_cast<double>(at->second);
  };
  const auto figure = [&](const std::string& name) {
    const auto at = figures.find(name);
    return at == figures.end() ? 0.0 : at->second;
  };

  const Camera<ObjectSpace> camera = scene.cameraAt(frame);
  const double pixels = static_cast<double>(camera.lens.width) * camera.lens.height;
  const std::size_t moments = momentsOf(scene.effects, frame).size();
  const double samples = figure("samples_per_pixel");
  const LightCounts lights = countLights(scene);
  const std::size_t distant = distantLights(scene, options, frame);
  const bool guided = counted("model_values") > 0;
  const Deformation psi = scene.deformation.at(frame);
  const bool still = scene.deformation.none(), rigid = still || (!scene.deformation.movesVertices() && psi.rigid());
  const std::string hits = shortNumber(counted("hits")) + " hits";

  Json plan = Json::array();
  const auto add = [&](const char* name, bool on, const std::string& because, const std::string& expected = "",
                       const std::string& measured = "") {
    Json row{{"name", name}, {"on", on}, {"because", because}};
    if (!expected.empty()) row["expected"] = expected;
    if (!measured.empty()) row["measured"] = measured;
    plan.push_back(std::move(row));
  };
  add("rays", true, "/camera: " + shortNumber(camera.lens.width) + " x " + shortNumber(camera.lens.height) + " pixels",
      "at most " + shortNumber(pixels * samples * static_cast<double>(moments)), hits);
  add("supersampling", samples > 1,
      samples > scene.samples ? "surfels are smaller than a pixel" : "/samples is " + std::to_string(scene.samples),
      shortNumber(samples) + " samples a pixel");
  add("deformation", !still, still ? "/deformation is empty" : "/deformation",
      still                          ? "the model stays at rest"
      : scene.deformation.constant() ? "every point once, since no key moves it"
                                     : "every point at every frame");
  // Guided, fewer distant lights than kFewestShared are each for itself at every hit.
  const std::size_t fewest = guided ? FrameLighting::kFewestShared : 1;
  const bool one = rigid && distant >= fewest;
  const double factor = one ? promisedFactor(scene, options, frame, counted("hits")) : 0;
  add("one orientation for all hits", one,
      !rigid             ? "the deformation turns points differently"
      : distant == 0     ? "no light is distant"
      : distant < fewest ? "guided, " + std::to_string(distant) + " distant lights are each for itself"
      : still            ? "nothing is deformed"
                         : "the deformation is rigid",
      !rigid ? "vectors of light weights by orientation"
      : one  ? "one vector of light weights" +
                  (factor > 0 ? ": " + shortNumber(std::round(10 * factor) / 10) + " times as fast as one for each hit"
                              : "")
            : "",
      shortNumber(counted("light_vectors")) + " vectors");
  if (factor > 0) plan.back()["factor"] = factor;
  add("shared light weights", !rigid && scene.accuracy.light_sharing > 0,
      "/accuracy/light_sharing is " + shortNumber(scene.accuracy.light_sharing) + " degrees");
  const Shading shading = scene.accuracy.shading;
  const bool sparse = shading != Shading::every && samples == 1;
  const std::string shading_is = "/accuracy/shading is " + shadingAsJson(shading);
  add("sparse shading", sparse,
      shading_is + (shading != Shading::every && samples > 1 ? ", but a pixel has several samples" : ""),
      !sparse                      ? ""
      : shading == Shading::sparse ? "of smooth parts a third of the pixels, the others between them"
                                   : "of smooth parts a seventh of the pixels, the others between them",
      shortNumber(counted("pixels.between")) + " pixels");
  add("point lights", lights.near_lights + lights.from_file > 0,
      std::to_string(lights.near_lights) + " in /lights" +
          (lights.from_file ? ", and " + std::to_string(lights.from_file) + " files" : ""),
      lights.near_lights ? "light weights of their own at every hit" : "");
  add("directional lights", lights.directional > 0, std::to_string(lights.directional) + " in /lights");
  add("environments", lights.environments > 0, std::to_string(lights.environments) + " in /lights",
      lights.every_texel    ? "every texel a light"
      : lights.environments ? std::to_string(lights.environment_samples) + " lights"
                            : "");
  add("captured lights", lights.captured > 0, std::to_string(lights.captured) + " in /lights");
  add("guided interpolation", guided,
      scene.shadows == Shadows::both                 ? "/effects/shadows is \"both\", which is plain alone"
      : scene.interpolation == Interpolation::plain  ? "/interpolation is \"plain\""
      : scene.interpolation == Interpolation::guided ? "/interpolation is \"guided\""
      : scene.interpolation == Interpolation::model  ? "/interpolation is \"model\": no photographs"
      : guided                                       ? "the model holds a fit"
                                                     : "the model holds no fit",
      "", guided ? shortNumber(counted("model_values")) + " values of the fitted model" : "");
  const bool by_rays = !guided && (scene.shadows == Shadows::deformed || scene.shadows == Shadows::both ||
                                   scene.shadows == Shadows::off);
  const bool cast = by_rays || (guided && scene.shadows != Shadows::off);
  const bool deformed_shadows = scene.shadows == Shadows::deformed || (scene.shadows == Shadows::automatic && !still);
  add("shadow rays", cast,
      !guided && !by_rays ? "plain interpolation has the photographs' own shadows"
      : by_rays && scene.shadows == Shadows::deformed
          ? "/effects/shadows is \"deformed\": rays in the deformed model, and at rest to divide its shadows out"
      : by_rays && scene.shadows == Shadows::both
          ? "/effects/shadows is \"both\": rays in the deformed model, beside the photographs' own shadows"
      : by_rays                             ? "/effects/shadows is \"off\": rays at rest to divide its shadows out"
      : scene.shadows == Shadows::off       ? "/effects/shadows is \"off\""
      : scene.shadows == Shadows::automatic ? (deformed_shadows ? "guided and deformed: the deformed model's shadows"
                                                                : "guided and at rest: the rest pose's shadows")
      : deformed_shadows                    ? "/effects/shadows is \"deformed\""
                                            : "/effects/shadows is \"captured\"",
      cast ? "of an environment at most " + std::to_string(scene.accuracy.shadow_rays) + " a hit" : "",
      cast ? shortNumber(counted("shadow_rays")) + " rays" : "");
  const Effects& effects = scene.effects;
  add("matte", effects.matte, effects.matte ? "/effects/matte" : "/effects/matte is not asked for");
  add("ground", effects.ground.has_value(), effects.ground ? "/effects/ground" : "/effects/ground is not asked for",
      effects.ground ? "at most " + std::to_string(scene.accuracy.shadow_rays) + " shadow rays a sample and point light"
                     : "",
      effects.ground
          ? shortNumber(counted("ground.samples")) + " samples, " + shortNumber(counted("ground.shadow_rays")) + " rays"
          : "");
  add("motion blur", moments > 1,
      effects.motion_blur ? "/effects/motion_blur" : "/effects/motion_blur is not asked for",
      moments > 1 ? std::to_string(moments) + " pictures for this frame" : "");
  const bool lens = effectsAt(effects, frame).lens.has_value();
  add("depth of field", lens,
      effects.depth_of_field ? "/effects/depth_of_field" : "/effects/depth_of_field is not asked for",
      lens ? "rays everywhere in the picture, as many as samples" : "");
  add("look-ups", true, "/accuracy/views is " + std::to_string(scene.accuracy.views),
      "at most " + shortNumber(counted("hits") * scene.accuracy.views * 4) + " operations",
      shortNumber(counted("operations")) + " operations, " + shortNumber(figure("cache.misses")) + " blocks read");

  const auto& support = rendered.at(0).support;
  const int step = supportStep(camera.lens.width, camera.lens.height);
  add("capture support", true, "srf explain tells it; srf render does with --stats or a layer of it alone",
      "at most one in " + std::to_string(step * step) + " of " + shortNumber(pixels * static_cast<double>(moments)) +
          " pixels",
      shortNumber(support ? static_cast<double>(support->hits) : 0) + " places, " +
          shortNumber(std::round(1e4 * figure("seconds.support")) / 1e4) + " s, " +
          shortNumber(std::round(1e3 * figure("seconds.support") / rendered.at(0).seconds) / 10) + " % of the frame");

  Json seconds;
  for (const auto& [name, value] : figures)
    if (name.starts_with("seconds.")) seconds[name.substr(8)] = value;
  seconds["whole frame"] = rendered.at(0).seconds;
  Json out{{"frame", frame}, {"plan", std::move(plan)}, {"seconds", std::move(seconds)}};
  if (support && support->hits > 0)
    out["support"] = {
        {"supported", support->share(support->supported)},       {"far_from_views", support->share(support->view_far)},
        {"far_from_lights", support->share(support->light_far)}, {"seen_by_no_view", support->share(support->occluded)},
        {"stretched", support->share(support->stretched)},       {"text", support->text()}};
  return out;
}

void printPlan(const Json& plan) {
  std::printf("frame %d\n", plan["frame"].get<int>());
  for (const Json& row : plan["plan"]) {
    std::printf("  %-3s %-29s %s\n", row["on"].get<bool>() ? "on" : "off", row["name"].get<std::string>().c_str(),
                row["because"].get<std::string>().c_str());
    for (const char* key : {"expected", "measured"})
      if (row.contains(key)) std::printf("      %-29s %s: %s\n", "", key, row[key].get<std::string>().c_str());
  }
  std::printf(
      "  seconds (stages of all threads are shares of the time that passed; the first frame reads its blocks)\n");
  for (const auto& [stage, value] : plan["seconds"].items())
    std::printf("      %-29s %.4f\n", stage.c_str(), value.get<double>());
  if (plan.contains("support")) std::printf("  %s\n", plan["support"]["text"].get<std::string>().c_str());
}

}  // namespace srf
