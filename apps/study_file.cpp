#include "apps/study_file.h"

#include <algorithm>
#include <cmath>
#include <iterator>
#include <nlohmann/json.hpp>

#include "base/error.h"
#include "base/image_metrics.h"
#include "base/json.h"
#include "base/numeric.h"
#include "base/text.h"

namespace srf {
namespace {

Json keysToJson(const SceneKeys& keys) {
  Json out = Json::object();
  for (const auto& [key, text] : keys) out[key] = Json::parse(text);
  return out;
}

SceneKeys keysFrom(const JsonNode& node) {
  if (!node.isObject()) throw node.error("found " + node.typeName() + ", expected an object of scene keys");
  SceneKeys keys;
  for (const auto& [key, value] : node.raw().items()) keys[key] = value.dump();
  return keys;
}

Json errorsToJson(const std::vector<FrameError>& errors) {
  Json out = Json::array();
  for (const FrameError& e : errors)
    out.push_back({{"relative_error_mean", e.mean},
                   {"relative_error_p99_9", e.percentile},
                   {"psnr_db", e.psnr},
                   {"relative_mse", e.relative_mse},
                   {"ssim", e.ssim},
                   {"flip", e.flip}});
  return out;
}

std::vector<FrameError> errorsFrom(const JsonNode& node) {
  std::vector<FrameError> errors;
  for (std::size_t i = 0; i < node.size(); ++i) {
    const JsonNode e = node.at(i);
    errors.push_back({e["relative_error_mean"].number(), e["relative_error_p99_9"].number(), e["psnr_db"].number(),
                      e["relative_mse"].number(), e["ssim"].number(), e["flip"].number()});
  }
  return errors;
}

std::vector<int> framesFrom(const JsonNode& node) {
  std::vector<int> frames;
  for (std::size_t i = 0; i < node.size(); ++i)
    frames.push_back(static_cast<int>(node.at(i).integer(-1000000, 1000000)));
  return frames;
}

Json settingToJson(const MeasuredSetting& m) {
  Json out{{"set", keysToJson(m.keys)}};
  if (m.memory_bytes) out["memory_bytes"] = m.memory_bytes;
  out["error_worst"] = m.worstError();
  out["seconds_worst"] = m.worstSeconds();
  out["promise"] = {{"error", m.promisedError()}, {"seconds", m.promisedSeconds()}};
  out["seconds"] = m.seconds;
  out["seconds_spread"] = m.spread;
  out["seconds_cold"] = m.cold;
  out["full_size_factor"] = m.full_size;
  out["full_size_measured"] = m.full_size_measured;
  out["bytes_read"] = m.bytes_read;
  out["peak_cache_bytes"] = m.peak_bytes;
  out["field_bytes"] = m.field_bytes;
  out["against_exact"] = errorsToJson(m.exact);
  out["against_reference"] = errorsToJson(m.truth);
  if (!m.further.empty()) out["against_exact_further"] = errorsToJson(m.further);
  return out;
}

MeasuredSetting settingFrom(const JsonNode& node, std::size_t frames, std::size_t further_frames) {
  MeasuredSetting m;
  m.keys = keysFrom(node["set"]);
  if (const auto bytes = node.find("memory_bytes")) m.memory_bytes = static_cast<std::size_t>(bytes->positiveNumber());
  m.seconds = node["seconds"].numbers(frames);
  m.spread = node["seconds_spread"].number();
  m.cold = node["seconds_cold"].number();
  if (const auto factor = node.find("full_size_factor")) m.full_size = factor->positiveNumber();
  if (const auto measured = node.find("full_size_measured")) m.full_size_measured = measured->boolean();
  m.bytes_read = node["bytes_read"].number();
  m.peak_bytes = node["peak_cache_bytes"].number();
  if (const auto bytes = node.find("field_bytes")) m.field_bytes = bytes->number();
  m.exact = errorsFrom(node["against_exact"]);
  m.truth = errorsFrom(node["against_reference"]);
  if (m.exact.size() != frames) throw node["against_exact"].error("holds other frames than /frames");
  if (const auto further = node.find("against_exact_further")) {
    m.further = errorsFrom(*further);
    if (m.further.size() > further_frames) throw further->error("holds more frames than /further_frames");
  }
  return m;
}

[[noreturn]] void refuseError(const Study& study, double error, const std::string& where) {
  const double exact = study.leastPromised();
  double least = exact;
  for (const MeasuredSetting& m : study.measured) least = std::min(least, m.worstTruth());
  throw badInput(
      where,
      format("an error of at most %.3g %% was asked for, but the all-exact setting itself is %.3g %% from the true "
             "pictures ",
             100 * error, 100 * exact) +
          study.reference +
          format(", and no setting that was measured is nearer than %.3g %%; ask for at least %.3g %% (0: all exact), "
                 "or see with srf study --capture what more views or lights would bring",
                 100 * least, 100 * exact));
}

}  // namespace

std::vector<std::string> overridesOf(const SceneKeys& keys) {
  std::vector<std::string> overrides;
  for (const auto& [key, text] : keys) overrides.push_back(key + "=" + text);
  return overrides;
}

std::string pathText(const std::filesystem::path& path) {
  return Json(std::filesystem::absolute(path).lexically_normal().string()).dump();
}

std::filesystem::path pathOf(const std::string& text) {
  return Json::parse(text).get<std::string>();
}

FrameError frameError(const ImageF& image, const ImageF& reference) {
  const ImageDifference d = compareImages(image, reference);
  return {.mean = d.relative_error,
          .percentile = d.relative_error_tail,
          .psnr = d.inside.psnr,
          .relative_mse = d.inside.relative_mse,
          .ssim = d.inside.ssim,
          .flip = d.inside.flip};
}

double MeasuredSetting::worstError() const {
  double worst = 0;
  for (const FrameError& e : exact) worst = std::max(worst, e.mean);
  return worst;
}

double MeasuredSetting::promisedError() const {
  // Student's t of n - 1 degrees of freedom that 39 in 40 stay below; of more the last.
  constexpr double kStudent[] = {12.706, 4.303, 3.182, 2.776, 2.571, 2.447, 2.365, 2.306, 2.262, 2.228};
  constexpr double kOneFrame = 1.1;  // a guess, for one frame tells nothing of the others
  std::vector<double> errors;
  for (const FrameError& e : exact) errors.push_back(e.mean);
  for (const FrameError& e : further) errors.push_back(e.mean);
  const double n = static_cast<double>(errors.size()), worst = *std::max_element(errors.begin(), errors.end());
  if (errors.size() < 2) return worst * kOneFrame;
  double mean = 0, squares = 0;
  for (const double e : errors) mean += e / n;
  for (const double e : errors) squares += square(e - mean);
  const double spread = std::sqrt(squares / (n - 1) * (1 + 1 / n));
  return std::max(worst, mean + kStudent[std::min(errors.size() - 2, std::size(kStudent) - 1)] * spread);
}

double MeasuredSetting::worstTruth() const {
  double worst = 0;
  for (const FrameError& e : truth) worst = std::max(worst, e.mean);
  return worst;
}

double MeasuredSetting::worstSeconds() const {
  return *std::max_element(seconds.begin(), seconds.end());
}

double MeasuredSetting::promisedSeconds() const {
  constexpr double kMargin = 1.1;  // times of one machine scatter by so much
  return worstSeconds() * kMargin;
}

const MeasuredSetting* Study::find(const SceneKeys& keys, std::size_t memory_bytes) const {
  for (const MeasuredSetting& m : measured)
    if (m.keys == keys && m.memory_bytes == memory_bytes) return &m;
  return nullptr;
}

std::vector<const MeasuredSetting*> Study::front() const {
  std::vector<const MeasuredSetting*> sorted, best;
  for (const MeasuredSetting& m : measured)
    if (!m.memory_bytes) sorted.push_back(&m);
  std::stable_sort(sorted.begin(), sorted.end(), [](const auto* a, const auto* b) {
    return std::pair(a->worstSeconds(), a->worstError()) < std::pair(b->worstSeconds(), b->worstError());
  });
  const bool has_exact = find(exact) != nullptr;
  for (const MeasuredSetting* m : sorted) {
    if (has_exact && m->keys != exact && !(m->worstError() > 0)) continue;
    if (best.empty() || m->worstError() < best.back()->worstError()) best.push_back(m);
  }
  return best;
}

double Study::leastPromised() const {
  const MeasuredSetting* setting = find(exact);
  return setting ? setting->worstTruth() : 0;
}

KnobCurve curveOf(const Study& study, const Knob& knob) {
  KnobCurve curve;
  double most_error = 0, least_time = HUGE_VAL;
  for (std::size_t i = 0; i < knob.values.size(); ++i) {
    const MeasuredSetting* m = study.find(knob.values[i], knob.memory.empty() ? 0 : knob.memory[i]);
    if (!m) continue;
    curve.measured.push_back(m);
    curve.labels.push_back(knob.labels[i]);
    if (most_error > 0) curve.error_back = std::max(curve.error_back, 1 - m->worstError() / most_error);
    curve.time_back = std::max(curve.time_back, m->worstSeconds() / least_time - 1);
    most_error = std::max(most_error, m->worstError());
    least_time = std::min(least_time, m->worstSeconds());
  }
  return curve;
}

Study readStudy(const std::filesystem::path& file) {
  const JsonNode root = readJsonFile(file);
  Study study;
  study.scene = root["scene"].string();
  study.field = root["field"].string();
  study.reference = root["reference"].string();
  study.input_hash = root["input_hash"].string();
  study.scene_hash = root["scene_hash"].string();
  study.passes = static_cast<int>(root["passes"].integer(1, 1000));
  if (const auto divisor = root.find("picture_divisor")) study.divisor = static_cast<int>(divisor->integer(1, 65536));
  study.complete = root["complete"].boolean();
  study.frames = framesFrom(root["frames"]);
  if (study.frames.empty()) throw root["frames"].error("is empty, expected the studied frames");
  if (const auto further = root.find("further_frames")) study.further_frames = framesFrom(*further);
  study.exact = keysFrom(root["exact"]);
  study.own = keysFrom(root["own"]);
  const JsonNode settings = root["settings"];
  for (std::size_t i = 0; i < settings.size(); ++i)
    study.measured.push_back(settingFrom(settings.at(i), study.frames.size(), study.further_frames.size()));
  return study;
}

void writeStudy(const std::filesystem::path& file, const Study& study) {
  Json out;
  out["scene"] = study.scene;
  out["field"] = study.field;
  out["reference"] = study.reference;
  out["input_hash"] = study.input_hash;
  out["scene_hash"] = study.scene_hash;
  out["frames"] = study.frames;
  out["further_frames"] = study.further_frames;
  out["passes"] = study.passes;
  out["picture_divisor"] = study.divisor;
  out["complete"] = study.complete;
  out["exact"] = keysToJson(study.exact);
  out["own"] = keysToJson(study.own);
  out["settings"] = Json::array();
  for (const MeasuredSetting& m : study.measured) out["settings"].push_back(settingToJson(m));
  out["knobs"] = Json::array();
  for (const Knob& knob : study.knobs) {
    const KnobCurve curve = curveOf(study, knob);
    Json errors = Json::array(), seconds = Json::array();
    for (const MeasuredSetting* m : curve.measured)
      errors.push_back(m->worstError()), seconds.push_back(m->worstSeconds());
    out["knobs"].push_back({{"name", knob.name},
                            {"values", curve.labels},
                            {"error_worst", errors},
                            {"seconds_worst", seconds},
                            {"error_falls_back", curve.error_back},
                            {"seconds_rise_back", curve.time_back}});
  }
  out["front"] = Json::array();
  for (const MeasuredSetting* m : study.front()) out["front"].push_back(keysToJson(m->keys));
  writeJsonFile(file, out);
}

std::string studyTable(const Study& study) {
  const char* const kErrors[] = {
      "relative_error_mean", "relative_error_p99_9", "psnr_db", "relative_mse", "ssim", "flip"};
  std::string out =
      "setting,memory_bytes,frame,seconds,seconds_spread,seconds_cold,bytes_read,peak_cache_bytes,field_bytes";
  for (const char* name : kErrors) out += std::string(",") + name;
  for (const char* name : kErrors) out += std::string(",reference_") + name;
  out += ",on_front\n";
  const auto front = study.front();
  for (const MeasuredSetting& m : study.measured) {
    std::string keys;
    for (const std::string& set : overridesOf(m.keys)) keys += (keys.empty() ? "" : " ") + set;
    const std::string quoted = csvQuoted(keys);
    for (std::size_t f = 0; f < study.frames.size(); ++f) {
      out += quoted + format(",%zu,%d,%.6g,%.6g,%.6g,%.0f,%.0f,%.0f", m.memory_bytes, study.frames[f], m.seconds[f],
                             m.spread, m.cold, m.bytes_read, m.peak_bytes, m.field_bytes);
      const auto errors = [&](const std::vector<FrameError>& of) {
        if (of.empty()) return std::string(",,,,,,");
        const FrameError& e = of[f];
        return format(",%.6g,%.6g,%.4f,%.6g,%.6f,%.6f", e.mean, e.percentile, e.psnr, e.relative_mse, e.ssim, e.flip);
      };
      out += errors(m.exact) + errors(m.truth) +
             (std::find(front.begin(), front.end(), &m) == front.end() ? ",0\n" : ",1\n");
    }
  }
  return out;
}

const MeasuredSetting& chooseSetting(const Study& study, std::optional<double> error, std::optional<double> seconds,
                                     const std::string& where) {
  const auto front = study.front();
  if (front.empty()) throw badInput(where, "holds no measured setting; run srf study again to go on with it");
  if (error && *error > 0 && *error < study.leastPromised()) refuseError(study, *error, where);
  const MeasuredSetting* best = nullptr;
  for (const MeasuredSetting* m : front) {  // fastest first
    if (seconds && m->promisedSeconds() > *seconds) break;
    if (error && m->promisedError() > *error) continue;
    if (!best || m->promisedError() < best->promisedError()) best = m;
    if (error) break;
  }
  if (best) return *best;
  const MeasuredSetting &fastest = *front.front(), &nearest = *front.back();
  throw badInput(
      where,
      format("no setting promises %s%s%s; the fastest promises %.3g s a frame with an error of "
             "%.3g %%, the nearest %.3g s with %.3g %%; ask for what one of these promises, or run "
             "srf study again with a longer --budget",
             error ? format("an error of at most %.3g %%", 100 * *error).c_str() : "", error && seconds ? " in " : "",
             seconds ? format("at most %.3g s a frame", *seconds).c_str() : "", fastest.promisedSeconds(),
             100 * fastest.promisedError(), nearest.promisedSeconds(), 100 * nearest.promisedError()));
}

}  // namespace srf
