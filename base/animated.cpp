#include "base/animated.h"

namespace srf {
Animated<double> readAnimatedNumber(const JsonNode& node) {
  return readAnimated<double>(node, [](const JsonNode& n) { return n.number(); });
}
Animated<Vec3> readAnimatedVec3(const JsonNode& node) {
  return readAnimated<Vec3>(node, [](const JsonNode& n) { return n.vec3(); });
}
Animated<double> readAnimatedAmount(const JsonNode& node) {
  return readAnimated<double>(node, [](const JsonNode& n) { return n.amount(); });
}
Animated<double> readAnimatedScale(const JsonNode& parent, std::string_view key) {
  const auto node = parent.find(key);
  return node ? readAnimatedAmount(*node) : Animated<double>(1);
}
Animated<Vec3> readAnimatedAmounts(const JsonNode& node) {
  return readAnimated<Vec3>(node, [](const JsonNode& n) {
    const Vec3 v = n.vec3();
    for (int c = 0; c < 3; ++c) n.at(c).amount();
    return v;
  });
}

}  // namespace srf
