#include "apps/check_report.h"

#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <filesystem>

#include "apps/html.h"
#include "apps/program.h"
#include "base/files.h"
#include "base/image_io.h"
#include "base/text.h"

namespace srf {
namespace {

using html::escaped;

constexpr const char* kVerdictStyle = R"(
td.ok{color:#3a7d44}td.warning{color:#b36b00}td.fault{color:#b3261e;font-weight:600}.mend{color:#666}
td{overflow-wrap:anywhere})";

std::string verdicts(const CheckReport& report) {
  std::string out = "<table>\n";
  for (const CheckItem& i : report.items) {
    const std::string verdict = verdictName(i.verdict);
    out += "<tr><td class=\"" + verdict + "\">" + verdict + "</td><td>" + escaped(i.item) + "</td><td>" +
           (i.file.empty() ? "" : "<code>" + escaped(i.file) + "</code> ") + escaped(i.found) +
           (i.mend.empty() ? "" : "<br><span class=\"mend\">Mend: " + escaped(i.mend) + "</span>") + "</td></tr>\n";
  }
  return out + "</table>\n";
}

/// As the PNG file that image_io writes, inside the page.
std::string embedded(const Image8& picture) {
  const auto file = std::filesystem::temp_directory_path() / ("srf-picture-" + std::to_string(::getpid()) + ".png");
  writePng(file, picture);
  const auto bytes = readBinaryFile(file);
  std::filesystem::remove(file);
  return "data:image/png;base64," + html::base64(bytes);
}

std::string pictures(const CheckReport& report) {
  if (report.pictures.empty()) return "";
  std::string out = "<h2>Pictures</h2>\n";
  for (const CheckPicture& p : report.pictures)
    out += "<p><img alt=\"" + escaped(p.caption) + "\" src=\"" + embedded(p.pixels) + "\"></p>\n<p class=\"note\">" +
           escaped(p.caption) + "</p>\n";
  return out;
}

/// A bar a view from `base` up or down to its value.
std::string bars(const std::vector<double>& values, double base, const std::string& name) {
  double least = base, most = base;
  for (const double v : values) least = std::min(least, v), most = std::max(most, v);
  if (!(most > least)) return "";
  const double width = 900, height = 140, left = 56;
  const double step = (width - left) / static_cast<double>(values.size());
  const auto y = [&](double v) { return 8 + (height - 16) * (most - v) / (most - least); };
  std::string out = format("<svg viewBox=\"0 0 %g %g\" width=\"%g\">\n", width, height, width);
  for (const double tick : {least, most})
    out += format(
        "<line x1=\"%g\" x2=\"%g\" y1=\"%.1f\" y2=\"%.1f\" stroke=\"#ddd\"/>"
        "<text x=\"%g\" y=\"%.1f\" text-anchor=\"end\">%.4g</text>\n",
        left, width, y(tick), y(tick), left - 4, y(tick) + 4, tick);
  for (std::size_t i = 0; i < values.size(); ++i)
    out += format(
        "<rect x=\"%.2f\" y=\"%.2f\" width=\"%.2f\" height=\"%.2f\" fill=\"#4a7ebb\"><title>view %zu: %s "
        "%.4f</title></rect>\n",
        left + step * static_cast<double>(i), std::min(y(values[i]), y(base)), std::max(0.5, step * 0.8),
        std::max(0.5, std::fabs(y(values[i]) - y(base))), i, name.c_str(), values[i]);
  return out + "</svg>\n";
}

std::string perView(const CheckReport& report) {
  std::string out;
  std::vector<double> iou;
  for (const double v : report.view_iou)
    if (v >= 0) iou.push_back(v);
  if (!iou.empty())
    out +=
        "<h2>IoU of each silhouette with the hull</h2>\n" + bars(iou, 1, "IoU") +
        "<p class=\"note\">Views in the capture's order, down from 1. One far below its neighbours has a wrong mask or "
        "pose.</p>\n";
  if (!report.view_gain.empty())
    out += "<h2>Gain of each view</h2>\n" + bars(report.view_gain, 1, "gain") +
           "<p class=\"note\">From surface points that several views see under the same lights. A slope is a drift of "
           "lamps or exposure: divide each photograph by its view's gain.</p>\n";
  return out;
}

std::string drawing(const CheckReport& report) {
  return report.drawing.empty() ? ""
                                : "<h2>Cameras and lights</h2>\n" + report.drawing +
                                      "<p class=\"note\">As the capture's files tell them, before anything is "
                                      "mended.</p>\n";
}

std::string coverage(const CheckReport& report) {
  html::HemisphereMap map;
  for (const Vec3& d : report.light_directions) map.add(d, true);
  for (const Vec3& d : report.view_directions) map.add(d, false);
  return "<h2>Coverage of the sphere</h2>\n" + map.svg() +
         "<p class=\"note\">Directions from the object's centre: yellow dots are lights, blue squares are views. Areas "
         "are true, rings stand at 30 and 60 degrees from the pole.</p>\n";
}

}  // namespace

std::string checkPage(const std::string& capture, const CheckReport& report) {
  return "<!DOCTYPE html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"><title>" + escaped(capture) +
         ": check</title><style>" + html::kStyle + kVerdictStyle + "</style></head><body>\n<h1>" + escaped(capture) +
         "</h1>\n<p class=\"note\">srf " + projectVersion() +
         format(": %zu faults, %zu warnings</p>\n", report.count(Verdict::fault), report.count(Verdict::warning)) +
         verdicts(report) + pictures(report) + drawing(report) + perView(report) + coverage(report) +
         "</body></html>\n";
}

}  // namespace srf
