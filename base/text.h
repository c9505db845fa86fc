// Numbers as messages show them, words as tables hold them.
#pragma once

#include <cstdarg>
#include <cstdio>
#include <string>

namespace srf {

/// As printf has it; what lies beyond 511 characters is left out.
inline std::string format(const char* pattern, ...) __attribute__((format(printf, 1, 2)));
inline std::string format(const char* pattern, ...) {
  char text[512];
  va_list values;
  va_start(values, pattern);
  std::vsnprintf(text, sizeof text, pattern, values);
  va_end(values);
  return text;
}

/// So many digits at most: "0.05", "1e-09", "512".
inline std::string shortNumber(double x, int digits = 6) {
  char text[32];
  std::snprintf(text, sizeof text, "%.*g", digits, x);
  return text;
}

/// So many decimals: "0.9870". A plus sign before positive ones where asked.
inline std::string fixedNumber(double x, int decimals, bool plus = false) {
  char text[336];  // the largest double has 309 digits before its point
  std::snprintf(text, sizeof text, plus ? "%+.*f" : "%.*f", decimals, x);
  return text;
}

/// A field of a CSV file, in quotes.
inline std::string csvQuoted(const std::string& text) {
  std::string quoted = "\"";
  for (const char c : text) quoted += c == '"' ? std::string("\"\"") : std::string(1, c);
  return quoted + "\"";
}

}  // namespace srf
