// Numbers and vectors that change over the frames: {"keys": [[frame, value], ...], "interpolation": ...}.
#pragma once

#include <algorithm>
#include <cstddef>
#include <vector>

#include "base/json.h"

namespace srf {

enum class KeyInterpolation { linear, step, cubic };

/// A value of type T over frames. Before the first and after the last key the value holds.
template <class T>
class Animated {
 public:
  Animated() = default;
  Animated(const T& constant) : keys_{{0.0, constant}} {}  // NOLINT(google-explicit-constructor)
  Animated(std::vector<std::pair<double, T>> keys, KeyInterpolation interpolation)
      : keys_(std::move(keys)), interpolation_(interpolation) {}

  bool constant() const { return keys_.size() <= 1; }
  const std::vector<std::pair<double, T>>& keys() const { return keys_; }
  KeyInterpolation interpolation() const { return interpolation_; }

  /// `cubic` is Catmull-Rom through the keys (tangents from the neighbours' times), one-sided at the ends.
  T at(double frame) const {
    if (keys_.empty()) return T{};
    if (keys_.size() == 1 || frame <= keys_.front().first) return keys_.front().second;
    if (frame >= keys_.back().first) return keys_.back().second;
    std::size_t i = 1;
    while (keys_[i].first <= frame) ++i;
    const auto& [t0, a] = keys_[i - 1];
    const auto& [t1, b] = keys_[i];
    const double h = t1 - t0, t = (frame - t0) / h;
    if (interpolation_ == KeyInterpolation::step) return a;
    if (interpolation_ == KeyInterpolation::linear) return a + (b - a) * t;
    const T m0 = slope(i - 1), m1 = slope(i);
    const double t2 = t * t, t3 = t2 * t;
    return a * (2 * t3 - 3 * t2 + 1) + m0 * (h * (t3 - 2 * t2 + t)) + b * (3 * t2 - 2 * t3) + m1 * (h * (t3 - t2));
  }

 private:
  T slope(std::size_t i) const {
    const std::size_t lo = i == 0 ? 0 : i - 1, hi = std::min(i + 1, keys_.size() - 1);
    return (keys_[hi].second - keys_[lo].second) * (1.0 / (keys_[hi].first - keys_[lo].first));
  }
  std::vector<std::pair<double, T>> keys_;
  KeyInterpolation interpolation_ = KeyInterpolation::linear;
};

/// Reads a value, or the animated form of one: `read_value` takes a node to its T. Keys must rise strictly.
template <class T, class ReadValue>
Animated<T> readAnimated(const JsonNode& node, const ReadValue& read_value) {
  if (!node.isObject()) return Animated<T>(read_value(node));
  node.onlyKeys({"keys", "interpolation"});
  const JsonNode list = node["keys"];
  if (list.size() == 0) throw list.error("has no keys, expected at least one [frame, value]");
  std::vector<std::pair<double, T>> keys;
  for (std::size_t i = 0; i < list.size(); ++i) {
    const JsonNode key = list.at(i);
    if (key.size() != 2) throw key.error("has " + std::to_string(key.size()) + " entries, expected [frame, value]");
    const double frame = key.at(0).number();
    if (!keys.empty() && !(frame > keys.back().first))
      throw key.at(0).error("is not after the key before it; sort the keys by frame");
    keys.emplace_back(frame, read_value(key.at(1)));
  }
  auto interpolation = KeyInterpolation::linear;
  if (const auto word = node.find("interpolation"))
    interpolation = static_cast<KeyInterpolation>(word->choice({"linear", "step", "cubic"}));
  return {std::move(keys), interpolation};
}

/// Reads a number, or the animated form of one.
Animated<double> readAnimatedNumber(const JsonNode& node);
/// Reads [x, y, z], or the animated form of it.
Animated<Vec3> readAnimatedVec3(const JsonNode& node);
/// The same of at least 0 at every key; between them cubic keys may still pass below it.
Animated<double> readAnimatedAmount(const JsonNode& node);
/// That of `key`, or 1 where there is none: what scales a light.
Animated<double> readAnimatedScale(const JsonNode& parent, std::string_view key);
Animated<Vec3> readAnimatedAmounts(const JsonNode& node);

}  // namespace srf
