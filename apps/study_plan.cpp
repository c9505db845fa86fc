#include "apps/study_plan.h"

#include <algorithm>
#include <cmath>

#include "base/image_io.h"
#include "base/text.h"
#include "render/light_set.h"

namespace srf {
namespace {

constexpr const char* kSamples = "/samples";
constexpr const char* kSharing = "/accuracy/light_sharing";
constexpr const char* kViews = "/accuracy/views";
constexpr const char* kLights = "/accuracy/lights";
constexpr const char* kShadowRays = "/accuracy/shadow_rays";
constexpr const char* kFrame = "/accuracy/frame";
constexpr const char* kInterpolation = "/interpolation";
constexpr const char* kShading = "/accuracy/shading";
constexpr int kEveryRay = 1000000;  // the most that a scene may ask for

bool isEnvironment(const std::string& key) {
  return key.starts_with("/lights/");
}

// As the JSON of study.json gives it back: 1000000 and not 1e+06, which would be another setting there.
std::string text(double value) {
  return value == std::floor(value) ? format("%.0f", value) : format("%g", value);
}
std::string text(int value) {
  return std::to_string(value);
}

// 0 stands for every texel.
double lightsTaken(int samples) {
  return samples == 0 ? HUGE_VAL : samples;
}

struct Environments {
  std::vector<std::string> keys;
  int own = 0;      // the most of any; 0: every texel
  double most = 0;  ///< that samples 0 takes
};
Environments environmentsOf(const Scene& scene) {
  Environments found;
  for (std::size_t i = 0; i < scene.lights.size(); ++i) {
    const auto* environment = std::get_if<EnvironmentLight>(&scene.lights[i]);
    if (!environment) continue;
    if (found.keys.empty() || lightsTaken(environment->samples) > lightsTaken(found.own))
      found.own = environment->samples;
    found.keys.push_back("/lights/" + std::to_string(i) + "/samples");
    const ImageSize size = readImageSize(environment->map);
    found.most = std::max(found.most, static_cast<double>(mostEnvironmentLights(size.width, size.height)));
  }
  return found;
}

double numberOf(const SceneKeys& keys, const std::string& key) {
  return std::stod(keys.at(key));
}

// The exact value, then those of the ladder and the scene's own that are cheaper, in order.
Knob knob(const std::string& name, const std::string& unit, const std::vector<std::string>& keys,
          const SceneKeys& exact, const SceneKeys& own, std::vector<double> ladder, bool fewer_is_cheaper) {
  const auto cost = [&](double value) {
    if (isEnvironment(keys[0]) && value == 0) return HUGE_VAL;
    return fewer_is_cheaper ? value : -value;
  };
  const double start = numberOf(exact, keys[0]);
  ladder.push_back(numberOf(own, keys[0]));
  ladder.push_back(start);
  std::erase_if(ladder, [&](double value) { return cost(value) > cost(start); });
  std::sort(ladder.begin(), ladder.end(), [&](double a, double b) { return cost(a) > cost(b); });
  ladder.erase(std::unique(ladder.begin(), ladder.end()), ladder.end());
  Knob out{name, unit, {}, {}, true, {}};
  for (const double value : ladder) {
    SceneKeys changed = exact;
    for (const std::string& key : keys) changed[key] = text(value);
    out.values.push_back(changed);
    out.labels.push_back((isEnvironment(keys[0]) && value == 0) || value == kEveryRay ? "all" : text(value));
  }
  return out;
}

// A knob of words: the exact one and another.
Knob choice(const std::string& name, const std::string& key, const SceneKeys& exact,
            const std::vector<std::string>& words, bool searched) {
  Knob out{name, "", {}, {}, searched, {}};
  for (const std::string& word : words) {
    SceneKeys changed = exact;
    changed[key] = "\"" + word + "\"";
    out.values.push_back(changed);
    out.labels.push_back(word);
  }
  return out;
}

}  // namespace

SceneKeys ownSetting(const Scene& scene, const SceneProbe& probe) {
  const Environments environments = environmentsOf(scene);
  SceneKeys keys{{kSamples, text(scene.samples)},
                 {kSharing, text(scene.accuracy.light_sharing)},
                 {kViews, text(scene.accuracy.views)},
                 {kLights, text(scene.accuracy.lights)},
                 {kFrame, scene.accuracy.frame == FrameMode::bisector ? "\"bisector\"" : "\"polar\""}};
  for (const std::string& key : environments.keys) keys[key] = text(environments.own);
  if (probe.guided) keys[kInterpolation] = "\"guided\"";
  if (probe.shadow_rays) keys[kShadowRays] = text(scene.accuracy.shadow_rays);
  if (scene.accuracy.shading != Shading::every) keys[kShading] = shadingAsJson(scene.accuracy.shading);
  return keys;
}

SceneKeys exactSetting(const Scene& scene, const SceneProbe& probe, double seconds) {
  const Environments environments = environmentsOf(scene);
  SceneKeys keys = ownSetting(scene, probe);
  keys[kSharing] = "0";
  if (scene.accuracy.shading != Shading::every) keys[kShading] = shadingAsJson(Shading::every);
  if (probe.shadow_rays) keys[kShadowRays] = text(kEveryRay);
  const double own_lights = environments.own == 0 ? environments.most : environments.own;
  int samples = 16;
  double lights = environments.keys.empty() ? 0 : std::min(environments.most, 4096.0);
  for (bool fewer_lights = false; samples > 1; fewer_lights = !fewer_lights) {
    const double cost = probe.seconds * samples * (own_lights > 0 ? std::max(1.0, lights / own_lights) : 1);
    if (cost <= seconds) break;
    if (fewer_lights)
      lights = std::max(64.0, lights / 2);
    else
      samples /= 2;
  }
  keys[kSamples] = text(std::max(samples, scene.samples));
  const bool all = environments.own == 0 || lights >= environments.most;
  for (const std::string& key : environments.keys)
    keys[key] = all ? "0" : text(std::max(static_cast<int>(lights), environments.own));
  return keys;
}

double exactSeconds(const Scene& scene, const SceneProbe& probe, const SceneKeys& exact) {
  const Environments environments = environmentsOf(scene);
  double seconds = probe.seconds * numberOf(exact, kSamples);
  if (!environments.keys.empty()) {
    const auto taken = [&](double samples) { return samples == 0 ? environments.most : samples; };
    seconds *= std::max(1.0, taken(numberOf(exact, environments.keys[0])) / taken(environments.own));
  }
  return seconds;
}

std::vector<Knob> knobsOf(const SceneKeys& exact, const SceneKeys& own, std::size_t memory_bytes,
                          const std::vector<FieldKnob>& fields, const std::filesystem::path& folder) {
  std::vector<Knob> knobs;
  std::vector<std::string> environments;
  for (const auto& [key, value] : exact)
    if (isEnvironment(key)) environments.push_back(key);
  if (!environments.empty())
    knobs.push_back(knob("Environment samples", "lights taken from the map", environments, exact, own,
                         {4096, 1024, 256, 64, 16}, true));
  knobs.push_back(knob("Samples", "rays a pixel", {kSamples}, exact, own, {16, 8, 4, 2, 1}, true));
  knobs.push_back(knob("Light sharing", "degrees over which light weights are shared", {kSharing}, exact, own,
                       {0.5, 1, 2, 4, 8}, false));
  knobs.push_back(knob("Views", "acquired views interpolated", {kViews}, exact, own, {4, 3, 2, 1}, true));
  knobs.push_back(knob("Lights", "acquired lights interpolated", {kLights}, exact, own, {4, 3, 2, 1}, true));
  if (exact.contains(kShadowRays))
    knobs.push_back(
        knob("Shadow rays", "most a hit, for environments", {kShadowRays}, exact, own, {128, 32, 8, 2}, true));
  if (exact.contains(kInterpolation))
    knobs.push_back(choice("Interpolation", kInterpolation, exact, {"guided", "plain"}, true));
  const bool bisector = exact.at(kFrame) == "\"bisector\"";
  knobs.push_back(
      choice("Local frame", kFrame, exact, {bisector ? "bisector" : "polar", bisector ? "polar" : "bisector"}, false));
  for (const FieldKnob& field : fields) {
    Knob out{field.name, field.unit, {exact}, {field.own}, true, {}};
    for (const FieldVariant& variant : field.variants) {
      SceneKeys changed = exact;
      changed[kFieldKey] = pathText(folder / variant.name);
      out.values.push_back(changed);
      out.labels.push_back(variant.label);
    }
    knobs.push_back(out);
  }
  Knob memory{"Memory", "for blocks and weights", {exact}, {format("%zu MiB", memory_bytes >> 20)}, false, {0}};
  for (const std::size_t mebibytes : {256, 64})
    if (const std::size_t bytes = mebibytes << 20; bytes < memory_bytes) {
      memory.values.push_back(exact);
      memory.labels.push_back(format("%zu MiB", mebibytes));
      memory.memory.push_back(bytes);
    }
  if (memory.values.size() > 1) knobs.push_back(memory);
  std::erase_if(knobs, [](const Knob& k) { return k.values.size() < 2; });
  return knobs;
}

std::vector<SceneKeys> worthTrying(const Study& study) {
  struct Step {
    SceneKeys changed;  // the keys that differ from exact
    double squared_error, time_ratio;
  };
  const MeasuredSetting* exact = study.find(study.exact);
  std::vector<std::vector<Step>> steps;
  for (const Knob& knob : study.knobs) {
    if (!knob.searched) continue;
    std::vector<Step> of;
    for (const SceneKeys& keys : knob.values) {
      const MeasuredSetting* m = study.find(keys);
      if (!m) return {};
      Step step{{}, m->worstError() * m->worstError(), m->worstSeconds() / exact->worstSeconds()};
      for (const auto& [key, value] : keys)
        if (study.exact.at(key) != value) step.changed[key] = value;
      of.push_back(step);
    }
    steps.push_back(of);
  }
  std::vector<SceneKeys> settings;
  for (double target = 0.1; target > 0.0003; target *= 0.7) {
    double least = HUGE_VAL;
    SceneKeys best;
    std::vector<std::size_t> at(steps.size(), 0);
    for (bool left = true; left;) {
      double squared = 0, ratio = 1;
      for (std::size_t k = 0; k < at.size(); ++k)
        squared += steps[k][at[k]].squared_error, ratio *= steps[k][at[k]].time_ratio;
      if (squared <= target * target && ratio < least) {
        SceneKeys changed = study.exact;
        bool apart = true;  // no two knobs turn the same key: one field is not at once another coding and another hull
        for (std::size_t k = 0; k < at.size(); ++k)
          for (const auto& [key, value] : steps[k][at[k]].changed) {
            apart &= changed.at(key) == study.exact.at(key);
            changed[key] = value;
          }
        if (apart) least = ratio, best = changed;
      }
      std::size_t k = 0;
      while (k < at.size() && ++at[k] == steps[k].size()) at[k++] = 0;
      left = k < at.size();
    }
    if (!best.empty() && std::find(settings.begin(), settings.end(), best) == settings.end()) settings.push_back(best);
  }
  return settings;
}

}  // namespace srf
