#include "base/animated.h"

namespace srf {
namespace {

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

}  // namespace

Animated<double> readAnimatedNumber(const JsonNode& node) {
  return readAnimated<double>(node, [](const JsonNode& n) { return n.number(); });
}
Animated<Vec3> readAnimatedVec3(const JsonNode& node) {
  return readAnimated<Vec3>(node, [](const JsonNode& n) { return n.vec3(); });
}
Animated<double> readAnimatedAmount(const JsonNode& node) {
  return readAnimated<double>(node, [](const JsonNode& n) { return n.amount(); });
}
Animated<Vec3> readAnimatedAmounts(const JsonNode& node) {
  return readAnimated<Vec3>(node, [](const JsonNode& n) {
    const Vec3 v = n.vec3();
    for (int c = 0; c < 3; ++c) n.at(c).amount();
    return v;
  });
}

}  // namespace srf
