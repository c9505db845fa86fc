// study.json: what `srf study` measured of a scene, and the choice that `srf render --quality` makes of it.
#pragma once

#include <cstddef>
#include <filesystem>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "base/image.h"

namespace srf {

/// Keys of a scene and their values as JSON text: "/accuracy/views" to "4". As by --set.
using SceneKeys = std::map<std::string, std::string>;
std::vector<std::string> overridesOf(const SceneKeys& keys);
/// The key that names the field. Values: absolute paths.
inline constexpr const char* kFieldKey = "/srf";
/// A path as the value of a key, and back.
std::string pathText(const std::filesystem::path& path);
std::filesystem::path pathOf(const std::string& text);

/// How far a frame is from the one it should be.
struct FrameError {
  double mean = 0;                                        ///< ImageDifference::relative_error
  double percentile = 0;                                  ///< its 99.9th
  double psnr = 0, relative_mse = 0, ssim = 1, flip = 0;  ///< of compareImages, inside
};
/// Throws bad_input where the sizes differ.
FrameError frameError(const ImageF& image, const ImageF& reference);

struct MeasuredSetting {
  SceneKeys keys;
  std::size_t memory_bytes = 0;     ///< 0: the program's own --memory
  std::vector<FrameError> exact;    ///< of each studied frame, against the all-exact rendering
  std::vector<FrameError> truth;    ///< against --reference; empty without it
  std::vector<FrameError> further;  ///< of the first of Study::further_frames, against the all-exact rendering
  std::vector<double> seconds;      ///< of each studied frame: median of its warm repeats
  double spread = 0;                ///< slowest less fastest repeat of a frame, mean of the frames, seconds
  double full_size = 1;             ///< what those of the study's pictures were multiplied by, for those of full size
  bool full_size_measured = true;   ///< by a frame of full size; else foretold from the pixels alone
  double cold = 0;                  ///< the first frame of the first run: files opened, nothing in memory, seconds
  double bytes_read = 0, peak_bytes = 0;  ///< of the field's cache
  double field_bytes = 0;                 ///< of the field's files

  double worstError() const;  ///< largest mean relative error of a studied frame
  double worstTruth() const;  ///< the same against --reference; 0 without it
  double worstSeconds() const;
  /// What 39 of 40 other frames keep, going by how the studied and the further ones scatter; no less than the worst of
  /// these.
  double promisedError() const;
  double promisedSeconds() const;
};

/// What a knob may be set to, from exact to cheap.
struct Knob {
  std::string name, unit;
  std::vector<SceneKeys> values;
  std::vector<std::string> labels;  ///< one for each value
  bool searched = true;             ///< part of the search; else shown alone
  std::vector<std::size_t> memory;  ///< instead of `values`: bytes for --memory
};

struct Study {
  std::string scene, field, input_hash, scene_hash, reference;
  std::vector<int> frames;          ///< of every setting
  std::vector<int> further_frames;  ///< of what stands on the front, for its promise
  int passes = 0;
  int divisor = 1;  ///< the pictures were rendered 1 / divisor as wide and high; times are those of full size
  bool complete = false;
  SceneKeys exact, own;  ///< keys of the all-exact setting, and of the scene as it is
  std::vector<Knob> knobs;
  std::vector<MeasuredSetting> measured;

  const MeasuredSetting* find(const SceneKeys& keys, std::size_t memory_bytes = 0) const;
  /// Those that no other one beats in both worst error and worst time, fastest first: the error falls strictly. The
  /// all-exact one, if measured, is the last: another one without error at the frames that were looked at may have some
  /// elsewhere.
  std::vector<const MeasuredSetting*> front() const;
  /// Of errors but 0: how far the all-exact setting itself is from --reference, below which a promise against that
  /// setting would be idle. 0 without true pictures.
  double leastPromised() const;
};

/// What was measured of a knob, all else exact, from exact to cheap.
struct KnobCurve {
  std::vector<const MeasuredSetting*> measured;
  std::vector<std::string> labels;
  /// How far the error falls below a dearer value's, and the time rises above it, in parts of that: 0 for a curve that
  /// only ever trades one for the other.
  double error_back = 0, time_back = 0;
};
KnobCurve curveOf(const Study& study, const Knob& knob);

/// Throws bad_input that names the file and the key.
Study readStudy(const std::filesystem::path& file);
void writeStudy(const std::filesystem::path& file, const Study& study);
std::string studyTable(const Study& study);  ///< CSV, a row a setting and frame

/// The fastest of the front that promises at most `error`, or of those that promise at most `seconds` a frame the one
/// with the least error; with both, the fastest that keeps both. Throws bad_input that says what the study has to offer
/// where none does, or where `error` is below leastPromised().
const MeasuredSetting& chooseSetting(const Study& study, std::optional<double> error, std::optional<double> seconds,
                                     const std::string& where);

}  // namespace srf
