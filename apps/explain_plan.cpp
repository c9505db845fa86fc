#include "apps/explain_plan.h"

#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <optional>
#include <utility>

#include "base/text.h"

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

/// Seconds of a warm frame, and its hits.
std::pair<double, double> warmFrame(const Scene& scene, AnimationOptions options, int frame, bool shortcuts) {
  Reporter quiet(ProgressMode::none, LogLevel::error);
  options.shortcuts = shortcuts;
  options.support = false;
  options.frames = {frame, frame, frame, frame};
  const auto frames = renderAnimation(scene, options, quiet);
  double least = frames[1].seconds;
  for (std::size_t i = 2; i < frames.size(); ++i) least = std::min(least, frames[i].seconds);
  return {least, static_cast<double>(quiet.counters()["hits"]) / static_cast<double>(frames.size())};
}

/// How many times as long as it does a frame of `hits` hits would take without the shortcuts: foretold from two small
/// pictures without them, by what each hit adds. 0: the picture is too small to tell.
double promisedFactor(const Scene& scene, const AnimationOptions& options, int frame, double hits) {
  const auto small = smaller(scene, 4), large = smaller(scene, 2);
  if (!small || !large) return 0;
  const auto [seconds_a, hits_a] = warmFrame(*small, options, frame, false);
  const auto [seconds_b, hits_b] = warmFrame(*large, options, frame, false);
  const double a_hit = hits_b > hits_a ? std::max(0.0, seconds_b - seconds_a) / (hits_b - hits_a) : 0;
  return (seconds_b + (hits - hits_b) * a_hit) / warmFrame(scene, options, frame, true).first;
}

}  // namespace

double measuredFactor(const Scene& scene, AnimationOptions options, int frame) {
  const Scratch scratch;
  options.output = (scratch.path() / "frame.####.exr").string();
  return warmFrame(scene, options, frame, false).first / warmFrame(scene, options, frame, true).first;
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
  const double factor = rigid && !guided && lights.directional + lights.environments > 0
                            ? promisedFactor(scene, options, frame, counted("hits"))
                            : 0;
  add("one orientation for all hits", rigid,
      still   ? "nothing is deformed"
      : rigid ? "the deformation is rigid"
              : "the deformation turns points differently",
      rigid ? "one vector of light weights" +
                  (factor > 0 ? ": " + shortNumber(std::round(10 * factor) / 10) + " times as fast as one for each hit"
                              : "")
            : "vectors of light weights by orientation",
      shortNumber(counted("light_vectors")) + " vectors");
  if (factor > 0) plan.back()["factor"] = factor;
  add("shared light weights", !rigid && scene.accuracy.light_sharing > 0,
      "/accuracy/light_sharing is " + shortNumber(scene.accuracy.light_sharing) + " degrees");
  add("sparse shading", scene.accuracy.sparse_shading && samples == 1,
      !scene.accuracy.sparse_shading ? "/accuracy/shading is \"every\""
      : samples > 1                  ? "/accuracy/shading is \"sparse\", but a pixel has several samples"
                                     : "/accuracy/shading is \"sparse\"",
      scene.accuracy.sparse_shading && samples == 1 ? "of smooth parts a third of the pixels, the others between them"
                                                    : "",
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

  Json seconds;
  for (const auto& [name, value] : figures)
    if (name.starts_with("seconds.")) seconds[name.substr(8)] = value;
  seconds["whole frame"] = rendered.at(0).seconds;
  Json out{{"frame", frame}, {"plan", std::move(plan)}, {"seconds", std::move(seconds)}};
  if (const auto& support = rendered.at(0).support; support && support->hits > 0)
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
