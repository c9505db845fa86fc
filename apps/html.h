// What the HTML pages of the programs share: self-contained, with pictures inside.
#pragma once

#include <cstddef>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include "base/vec.h"

namespace srf::html {

std::string escaped(const std::string& text);
std::string base64(const std::vector<std::byte>& bytes);
extern const char* const kStyle;  ///< the style sheet

/// Directions drawn as dots on the upper and the lower half of the sphere, by Lambert's azimuthal projection: it keeps
/// areas, so an uneven spread looks uneven.
class HemisphereMap {
 public:
  /// A light (dot; one of each place) or a view (square).
  void add(const Vec3& direction, bool light);
  std::string svg() const;

 private:
  std::string marks_[2];
  std::set<std::pair<long, long>> taken_[2];
};

}  // namespace srf::html
