#include "apps/plot.h"

#include <unistd.h>

#include <algorithm>
#include <cmath>

#include "apps/html.h"
#include "base/files.h"
#include "base/image_io.h"
#include "base/text.h"

namespace srf::plot {

using html::base64;

std::string percent(double error) {
  return error == 0 ? "0 %" : format("%.3g %%", 100 * error);
}

Axis::Axis(double least, double most, double first, double last)
    : low(least / 1.25), high(most * 1.25), from(first), to(last) {
  if (high / low < 3) low /= 1.5, high *= 1.5;
}

double Axis::at(double value) const {
  return from +
         (to - from) * (std::log(std::clamp(value, low, high)) - std::log(low)) / (std::log(high) - std::log(low));
}

std::vector<double> Axis::ticks() const {
  std::vector<double> out;
  for (int decade = static_cast<int>(std::floor(std::log10(low))); decade <= std::log10(high); ++decade)
    for (const double digit : {1.0, 2.0, 5.0})
      if (const double tick = digit * std::pow(10, decade); tick >= low && tick <= high) out.push_back(tick);
  if (out.size() > 7) std::erase_if(out, [](double t) { return std::fabs(std::remainder(std::log10(t), 1)) > 1e-6; });
  return out;
}

std::string tickLabel(double value, bool error) {
  return error ? format("%g %%", 100 * value) : format("%g s", value);
}

std::string uprightAxis(const Axis& axis, bool error, double x, bool left, double rule_from, double rule_to) {
  std::string out;
  for (const double tick : axis.ticks()) {
    if (left)
      out += format("<line x1=\"%.1f\" x2=\"%.1f\" y1=\"%.1f\" y2=\"%.1f\" stroke=\"#eee\"/>", rule_from, rule_to,
                    axis.at(tick), axis.at(tick));
    out += format("<text x=\"%.1f\" y=\"%.1f\" text-anchor=\"%s\" style=\"fill:%s\">%s</text>\n", x, axis.at(tick) + 4,
                  left ? "end" : "start", error ? kErrorColour : kTimeColour, tickLabel(tick, error).c_str());
  }
  return out;
}

std::string line(const std::vector<std::pair<double, double>>& points, const char* colour, bool dashed) {
  std::string path, dots;
  for (const auto& [x, y] : points) {
    path += format("%s%.1f %.1f", path.empty() ? "M" : "L", x, y);
    if (!dashed) dots += format("<circle cx=\"%.1f\" cy=\"%.1f\" r=\"3.5\" fill=\"%s\"/>", x, y, colour);
  }
  return "<path d=\"" + path +
         format("\" fill=\"none\" stroke=\"%s\" stroke-width=\"2\"%s/>", colour,
                dashed ? " stroke-dasharray=\"5 4\"" : "") +
         dots + "\n";
}

std::string png(const Image8& image) {
  const auto file = std::filesystem::temp_directory_path() / ("srf-page-" + std::to_string(::getpid()) + ".png");
  writePng(file, image);
  const auto bytes = readBinaryFile(file);
  std::filesystem::remove(file);
  return "<img width=\"300\" alt=\"\" src=\"data:image/png;base64," + base64(bytes) + "\">";
}

}  // namespace srf::plot
