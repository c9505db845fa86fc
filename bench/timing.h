// Repeated timings: median and spread, in milliseconds.
#pragma once

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <string>
#include <vector>

namespace srf::bench {

template <class Work>
double milliseconds(const Work& work) {
  const auto start = std::chrono::steady_clock::now();
  work();
  return std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - start).count();
}

struct Series {
  std::vector<double> values;
  void add(double v) { values.push_back(v); }
  double at(double share) const {
    std::vector<double> sorted = values;
    std::sort(sorted.begin(), sorted.end());
    return sorted.empty() ? 0 : sorted[static_cast<std::size_t>(share * (sorted.size() - 1) + 0.5)];
  }
  double median() const { return at(0.5); }
};

/// Of one quantity over another, repeat by repeat, so that both were measured under the same load.
inline Series ratios(const Series& over, const Series& under) {
  Series series;
  for (std::size_t i = 0; i < std::min(over.values.size(), under.values.size()); ++i)
    series.add(over.values[i] / under.values[i]);
  return series;
}

/// "0.94 (0.90 .. 1.02)": the median, and the interval that holds the true one with 95 % (order statistics, by the
/// binomial distribution; with fewer than six values all of them).
inline std::string shownRatio(const Series& s) {
  const double n = static_cast<double>(s.values.size());
  const double out = n < 6 ? 0 : std::max(0.0, std::floor(0.5 * n - 0.98 * std::sqrt(n)) - 1 + (n < 9));
  char text[96];
  const double share = n > 1 ? out / (n - 1) : 0;
  std::snprintf(text, sizeof text, "%.2f (%.2f .. %.2f)", s.median(), s.at(share), s.at(1 - share));
  return text;
}

/// "12.3 (11.9 .. 14.0)"
inline std::string shown(const Series& s) {
  char text[96];
  std::snprintf(text, sizeof text, "%.1f (%.1f .. %.1f)", s.median(), s.at(0), s.at(1));
  return text;
}

/// The processor's name, as the system tells it.
inline std::string processorName() {
  std::string name = "unknown processor";
  if (FILE* file = std::fopen("/proc/cpuinfo", "r")) {
    char line[256];
    while (std::fgets(line, sizeof line, file)) {
      const std::string text = line;
      if (!text.starts_with("model name")) continue;
      name = text.substr(text.find(':') + 2);
      name.pop_back();
      break;
    }
    std::fclose(file);
  }
  return name;
}

}  // namespace srf::bench
