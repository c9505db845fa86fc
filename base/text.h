// Numbers as messages show them, words as tables hold them.
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

/// A field of a CSV file, in quotes.
inline std::string csvQuoted(const std::string& text) {
  std::string quoted = "\"";
  for (const char c : text) quoted += c == '"' ? std::string("\"\"") : std::string(1, c);
  return quoted + "\"";
}

}  // namespace srf
