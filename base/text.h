// Numbers as messages show them.
#pragma once

#include <cstdio>
#include <string>

namespace srf {

/// Six digits at most: "0.05", "1e-09", "512".
inline std::string shortNumber(double x) {
  char text[32];
  std::snprintf(text, sizeof text, "%g", x);
  return text;
}

}  // namespace srf
