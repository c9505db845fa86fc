// What the pages of `srf study` are drawn with: curves as SVG, pictures as PNG inside the page.
#pragma once

#include <filesystem>
#include <string>
#include <utility>
#include <vector>

#include "base/image.h"

namespace srf::plot {

constexpr const char* kErrorColour = "#c0392b";
constexpr const char* kTimeColour = "#2a5d9f";

/// "1.23 %".
std::string percent(double error);

/// A logarithmic axis over the values from `least` to `most`, a little beyond both.
struct Axis {
  double low, high, from, to;  ///< values, and where they are drawn
  Axis(double least, double most, double first, double last);
  double at(double value) const;
  std::vector<double> ticks() const;
};
/// Of an error as a percentage, else of seconds.
std::string tickLabel(double value, bool error);
/// Ticks and rules of an upright axis, labels at `x`.
std::string uprightAxis(const Axis& axis, bool error, double x, bool left, double rule_from, double rule_to);
/// Dots joined by lines. `dashed`: without dots.
std::string line(const std::vector<std::pair<double, double>>& points, const char* colour, bool dashed = false);

/// The picture as an element of the page.
std::string png(const Image8& image);

}  // namespace srf::plot
