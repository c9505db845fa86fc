#include "apps/capture_page.h"

#include <algorithm>
#include <cmath>

#include "apps/heat_image.h"
#include "apps/html.h"
#include "apps/plot.h"
#include "apps/program.h"
#include "base/image_io.h"
#include "base/text.h"

namespace srf {
namespace {

using html::escaped;
using plot::Axis;
using plot::percent;

constexpr const char* kPlainColour = plot::kTimeColour;
constexpr const char* kGuidedColour = plot::kErrorColour;

std::string count(double number) {
  return number == std::floor(number) ? format("%.0f", number) : format("%.1f", number);
}

std::string unseenText(Unseen unseen, bool unknown_light) {
  switch (unseen) {
    case Unseen::view:
      return unknown_light ? "a new view" : "a new view, under a photographed light";
    case Unseen::light:
      return "a new light, from a photographed view";
    case Unseen::both:
      return "a new view under a new light";
  }
  return {};
}

std::string scoreTable(const CaptureStudy& study) {
  std::string out =
      "<h2>How well it foretells photographs</h2>\n<table>\n<tr><th>foretold</th><th>interpolation</th>"
      "<th>error</th><th>PSNR</th><th>FLIP</th><th>pictures</th></tr>\n";
  for (const Unseen unseen : {Unseen::view, Unseen::light, Unseen::both})
    for (const bool guided : {true, false})
      if (const HoldoutCase* c = study.find(unseen, guided))
        out += "<tr><td>" + unseenText(unseen, study.unknown_light) +
               format(
                   "</td><td>%s</td><td class=\"n\">%s</td><td class=\"n\">%.1f dB</td><td class=\"n\">%.3f</td>"
                   "<td class=\"n\">%zu</td></tr>\n",
                   guided ? "guided" : "plain", percent(c->error()).c_str(), c->psnr(), c->flip(), c->pictures.size());
  return out +
         "</table>\n<p class=\"note\">Error: root mean square of the difference to the photographs, as a share of "
         "theirs, inside the silhouette. PSNR and FLIP: mean of the pictures, two pixels inside.</p>\n";
}

std::string trendPlot(const CaptureStudy& study, const std::vector<const CaptureTrend*>& trends) {
  double fewest = HUGE_VAL, most = 0, least_error = HUGE_VAL, most_error = 0;
  for (const CaptureTrend* t : trends) {
    most = std::max(most, 2 * t->count);
    least_error = std::min(least_error, t->law.at(2 * t->count));
    for (const auto& [n, error] : t->measured) {
      fewest = std::min(fewest, n), most = std::max(most, n);
      least_error = std::min(least_error, error), most_error = std::max(most_error, error);
    }
  }
  const double width = 440, height = 260, left = 62, right = 20, top = 30, bottom = 44;
  const Axis x(fewest, most, left, width - right), y(least_error, most_error, height - bottom, top);
  const CaptureTrend& first = *trends.front();
  std::string out = format("<svg viewBox=\"0 0 %g %g\" width=\"%g\" role=\"img\">\n", width, height, width) +
                    "<text x=\"62\" y=\"14\" style=\"font-weight:bold\">" +
                    unseenText(first.unseen, study.unknown_light) + "</text>\n" +
                    plot::uprightAxis(y, true, left - 6, true, left, width - right);
  std::vector<double> ticks;
  for (const auto& measured : first.measured) ticks.push_back(measured[0]);
  if (first.count > 1.05 * ticks.back()) ticks.push_back(first.count);
  ticks.push_back(2 * first.count);
  double last_x = -HUGE_VAL;
  for (const double tick : ticks) {
    if (x.at(tick) - last_x < 24) continue;
    last_x = x.at(tick);
    out += format("<text x=\"%.1f\" y=\"%g\" text-anchor=\"middle\">%s</text>\n", last_x, height - bottom + 16,
                  count(tick).c_str());
  }
  out += format("<line x1=\"%.1f\" x2=\"%.1f\" y1=\"%g\" y2=\"%g\" stroke=\"#999\" stroke-dasharray=\"2 3\"/>",
                x.at(first.count), x.at(first.count), top, height - bottom);
  out += format("<text x=\"%g\" y=\"%g\" text-anchor=\"middle\">number of %s (dotted: this capture's)</text>\n",
                (left + width - right) / 2, height - 8, first.of_lights ? "lights" : "views");
  for (const CaptureTrend* t : trends) {
    const char* colour = t->guided ? kGuidedColour : kPlainColour;
    std::vector<std::pair<double, double>> points, ahead;
    for (const auto& [n, error] : t->measured) points.emplace_back(x.at(n), y.at(error));
    for (const double n : {t->measured.front()[0], 2 * t->count}) ahead.emplace_back(x.at(n), y.at(t->law.at(n)));
    out += plot::line(ahead, colour, true) + plot::line(points, colour);
  }
  return "<div style=\"display:inline-block;width:460px;vertical-align:top\">" + out + "</svg></div>\n";
}

std::string trendPlots(const CaptureStudy& study, const std::vector<CaptureTrend>& trends) {
  std::string out;
  for (const Unseen unseen : {Unseen::both, Unseen::view, Unseen::light})
    for (const bool of_lights : {false, true}) {
      std::vector<const CaptureTrend*> same;
      for (const CaptureTrend& t : trends)
        if (t.unseen == unseen && t.of_lights == of_lights) same.push_back(&t);
      if (!same.empty()) out += trendPlot(study, same);
    }
  return out;
}

std::string pictures(std::span<const ShownPrediction> shown) {
  if (shown.empty()) return "";
  std::string out =
      "<h2>Side by side</h2>\n<p>The photograph that was left out, what the others foretell, and where an eye that "
      "flips between both would see a difference (FLIP: black none, pale yellow 1). The best of the pictures, one in "
      "the middle, the worst.</p>\n";
  for (const ShownPrediction& s : shown) {
    const ImageDifference d = compareImages(s.prediction, s.photograph.rgb, s.photograph.inside);
    ImageF masked = d.flip_map;
    for (std::size_t i = 0; i < masked.data().size(); ++i) masked.data()[i] *= s.photograph.inside.data()[i];
    out += "<p>View " + escaped(s.view) + (s.light.empty() ? "" : ", light " + escaped(s.light)) +
           format(": %.1f dB</p>\n", s.score.figures.psnr) + plot::png(displayImage(s.photograph.rgb, 1 / d.white)) +
           " " + plot::png(displayImage(s.prediction, 1 / d.white)) + " " + plot::png(heatImage(masked)) + "\n";
  }
  return out;
}

}  // namespace

std::vector<std::string> captureSentences(const CaptureStudy& study) {
  std::vector<std::string> out;
  const bool guided = study.no_fit.empty();
  std::string left = study.views_out > 0 ? format("%d of %d views", study.views_out, study.views) : "";
  if (study.lights_out > 0)
    left += (left.empty() ? "" : " and ") + count(study.lights_out) + " of " + count(study.lights) + " lights";
  const Unseen hardest = study.find(Unseen::both, false) ? Unseen::both
                         : study.views_out > 0           ? Unseen::view
                                                         : Unseen::light;
  const HoldoutCase* found = study.find(hardest, guided);
  if (!found) found = study.find(hardest, false);
  out.push_back(format("With %s left out, %s comes out with an error of %s (%.1f dB).", left.c_str(),
                       unseenText(hardest, study.unknown_light).c_str(), percent(found->error()).c_str(),
                       found->psnr()));
  const CaptureTrend* best = nullptr;
  const std::vector<CaptureTrend> trends = study.trends();
  for (const CaptureTrend& t : trends) {
    if (t.unseen != hardest || t.guided != found->subset.guided) continue;
    if (!best || t.law.exponent > best->law.exponent) best = &t;
    const double ratio = t.law.at(2 * t.count) / t.law.at(t.count);
    out.push_back(format("Twice the %s (%s instead of %s): about %.0f %% less error (%+.1f dB).",
                         t.of_lights ? "lights" : "views", count(2 * t.count).c_str(), count(t.count).c_str(),
                         100 * (1 - ratio), -20 * std::log10(ratio)));
  }
  if (best)
    out.push_back(best->law.exponent < 0.1
                      ? "More photographs would hardly help: what is left lies elsewhere, in the shape or in the way "
                        "of interpolation."
                      : std::string("More ") + (best->of_lights ? "lights" : "views") +
                            " would help most. This is extrapolated, one doubling beyond what was measured, by a "
                            "power law: the shape sets a floor that it does not know.");
  if (study.unknown_light) out.push_back("The illumination is unknown: views alone can be left out.");
  if (study.views_out == 0) out.push_back(format("%d views are too few to leave one out.", study.views));
  if (study.lights_out == 0 && !study.unknown_light)
    out.push_back(count(study.lights) + " lights a view are too few to leave one out.");
  if (!guided && !study.unknown_light) out.push_back("Plain interpolation alone: " + study.no_fit + ".");
  return out;
}

std::string capturePage(const CaptureStudy& study, std::span<const ShownPrediction> shown) {
  std::string out = "<!DOCTYPE html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"><title>" + escaped(study.field) +
                    ": what the capture supports</title><style>" + html::kStyle +
                    "</style></head><body>\n<h1>What this capture supports</h1>\n<p class=\"note\">" +
                    escaped(study.field) + ", " + std::to_string(study.views) + " views" +
                    (study.unknown_light ? "" : ", " + count(study.lights) + " lights") + ", srf " + projectVersion() +
                    "</p>\n";
  for (const std::string& sentence : captureSentences(study)) out += "<p>" + escaped(sentence) + "</p>\n";
  out += scoreTable(study);
  const std::vector<CaptureTrend> trends = study.trends();
  if (!trends.empty())
    out += format(
               "<h2>What more photographs would bring</h2>\n<p>Dots: error with all that was kept, with half of it and "
               "with a quarter, "
               "always of the same photographs. Dashed: the power law through them, drawn up to twice as many as the "
               "capture has; beyond the dots nothing is measured. <span style=\"color:%s\">Red: guided</span>, "
               "<span style=\"color:%s\">blue: plain</span> interpolation; both scales logarithmic, lower is "
               "better.</p>\n",
               kGuidedColour, kPlainColour) +
           trendPlots(study, trends);
  out += pictures(shown);
  out +=
      "<h2>How it is measured</h2>\n<p class=\"note\">Left out at random, an eighth of the views and of the lights. "
      "The other photographs are the field, the reflectance model is fitted to them anew, and each left-out photograph "
      "is rendered by its own camera and light. The shape stays the one that all silhouettes gave. Halves and quarters "
      "are spread as evenly as they go. Photographs that are all but black are not asked.";
  if (study.lossy) out += " The field is compressed with losses: the photographs are what it kept of them.";
  return out + "</p>\n</body></html>\n";
}

}  // namespace srf
