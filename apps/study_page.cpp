#include "apps/study_page.h"

#include <algorithm>
#include <cmath>

#include "apps/heat_image.h"
#include "apps/html.h"
#include "apps/plot.h"
#include "apps/program.h"
#include "base/image_io.h"
#include "base/image_metrics.h"
#include "base/text.h"

namespace srf {
namespace {

using html::escaped;
using plot::Axis;
using plot::kErrorColour;
using plot::kTimeColour;
using plot::line;
using plot::percent;
using plot::png;
using plot::tickLabel;
using plot::uprightAxis;

constexpr double kFloor = 1e-5;   // errors below are drawn here: a logarithm has no 0
constexpr double kSteady = 0.05;  // what a curve may fall back and still be called steady

std::string keysText(const SceneKeys& keys) {
  std::string out;
  for (const auto& [key, value] : keys)
    out += (out.empty() ? "" : ", ") + key.substr(1) + " " +
           (key == kFieldKey ? pathOf(value).filename().string() : value);
  return escaped(out);
}

/// What a setting does otherwise than the exact one.
std::string changesText(const Study& study, const SceneKeys& keys) {
  SceneKeys changed;
  for (const auto& [key, value] : keys)
    if (const auto at = study.exact.find(key); at == study.exact.end() || at->second != value) changed[key] = value;
  return changed.empty() ? "all exact" : keysText(changed);
}

double drawn(const MeasuredSetting& m) {
  return std::max(kFloor, m.worstError());
}

std::string frontPlot(const Study& study) {
  const auto front = study.front();
  double least_time = HUGE_VAL, most_time = 0, least_error = HUGE_VAL, most_error = 0;
  for (const MeasuredSetting& m : study.measured) {
    least_time = std::min(least_time, m.worstSeconds()), most_time = std::max(most_time, m.worstSeconds());
    least_error = std::min(least_error, drawn(m)), most_error = std::max(most_error, drawn(m));
  }
  const double width = 900, height = 400, left = 70, right = 20, top = 20, bottom = 50;
  const Axis x(least_time, most_time, left, width - right), y(least_error, most_error, height - bottom, top);
  std::string out = format("<svg viewBox=\"0 0 %g %g\" width=\"%g\" role=\"img\">\n", width, height, width);
  out += uprightAxis(y, true, left - 6, true, left, width - right);
  for (const double tick : x.ticks())
    out += format(
        "<line x1=\"%.1f\" x2=\"%.1f\" y1=\"%g\" y2=\"%g\" stroke=\"#eee\"/>"
        "<text x=\"%.1f\" y=\"%g\" text-anchor=\"middle\">%s</text>\n",
        x.at(tick), x.at(tick), top, height - bottom, x.at(tick), height - bottom + 16, tickLabel(tick, false).c_str());
  out += format(
      "<text x=\"%g\" y=\"%g\" text-anchor=\"middle\">seconds a frame (worst studied frame, logarithmic)</text>"
      "<text transform=\"translate(14,%g) rotate(-90)\" text-anchor=\"middle\">mean relative error (worst "
      "studied frame, logarithmic)</text>\n",
      (left + width - right) / 2, height - 12, (top + height - bottom) / 2);
  for (const MeasuredSetting& m : study.measured) {
    if (m.memory_bytes) continue;
    out += format("<circle cx=\"%.1f\" cy=\"%.1f\" r=\"3\" fill=\"#bbb\"><title>", x.at(m.worstSeconds()),
                  y.at(drawn(m))) +
           changesText(study, m.keys) + "</title></circle>\n";
  }
  std::vector<std::pair<double, double>> points;
  for (const MeasuredSetting* m : front) points.emplace_back(x.at(m->worstSeconds()), y.at(drawn(*m)));
  out += line(points, kErrorColour);
  if (const MeasuredSetting* own = study.find(study.own))
    out += format(
        "<rect x=\"%.1f\" y=\"%.1f\" width=\"12\" height=\"12\" fill=\"none\" stroke=\"%s\" "
        "stroke-width=\"2.5\"/>\n",
        x.at(own->worstSeconds()) - 6, y.at(drawn(*own)) - 6, kTimeColour);
  // At the lower left, where nothing lies: no setting is both fast and exact.
  const double legend = left + 20, below = height - bottom - 80;
  out += format(
      "<rect x=\"%g\" y=\"%g\" width=\"295\" height=\"66\" fill=\"#fff\" fill-opacity=\".85\" stroke=\"#ddd\"/>"
      "<circle cx=\"%g\" cy=\"%g\" r=\"4\" fill=\"%s\"/><text x=\"%g\" y=\"%g\">the front: nothing measured beats "
      "these</text><circle cx=\"%g\" cy=\"%g\" r=\"3\" fill=\"#bbb\"/><text x=\"%g\" y=\"%g\">other "
      "settings</text>",
      legend, below, legend + 14, below + 14, kErrorColour, legend + 28, below + 18, legend + 14, below + 33,
      legend + 28, below + 37);
  out += format(
      "<rect x=\"%g\" y=\"%g\" width=\"10\" height=\"10\" fill=\"none\" stroke=\"%s\" stroke-width=\"2.5\"/>"
      "<text x=\"%g\" y=\"%g\">the scene as it is</text></svg>\n",
      legend + 9, below + 47, kTimeColour, legend + 28, below + 56);
  return out +
         format(
             "<p>Each dot is one setting of the renderer, tried on this scene: down is nearer to the exact picture, "
             "left is "
             "faster. Error is how far a pixel is off, of its own brightness, in the mean. An error of 0 is drawn at "
             "%g %%.</p>\n",
             100 * kFloor);
}

std::string recommendations(const Study& study) {
  std::string out =
      "<h2>What to use</h2>\n<table>\n<tr><th>wanted</th><th>promised error</th><th>promised time</th>"
      "<th>settings, where not exact</th></tr>\n";
  const auto front = study.front();
  const auto row = [&](const std::string& wanted, const MeasuredSetting& m) {
    out += "<tr><td>" + wanted + "</td><td class=\"n\">" + percent(m.promisedError()) +
           format("</td><td class=\"n\">%.3g s</td><td>", m.promisedSeconds()) + changesText(study, m.keys) +
           "</td></tr>\n";
  };
  for (const double error : {0.03, 0.01, 0.003, 0.001})
    if (error >= study.leastPromised())
      row(format("at most %g %% error in the least time", 100 * error), chooseSetting(study, error, std::nullopt, ""));
  const double fastest = front.front()->promisedSeconds();
  for (const double factor : {1.0, 2.0})
    row(format("least error in %.3g s a frame", fastest * factor),
        chooseSetting(study, std::nullopt, fastest * factor * (1 + 1e-9), ""));
  out += "</table>\n";
  if (study.leastPromised() > 0)
    out += format(
        "<p>Less than %.3g %% cannot be promised: so far the all-exact setting itself is from the true "
        "pictures.</p>\n",
        100 * study.leastPromised());
  return out +
         "<p>The promised error is what 39 in 40 frames keep, going by how the studied and further frames scatter, and "
         "no less than the worst of these; the promised time is the longest and a tenth more. To use one: <code>srf "
         "render " +
         escaped(study.scene.substr(0, 120)) +
         " --quality study.json --target-error 0.01</code> (or <code>--target-time 0.1</code>).</p>\n";
}

std::string knobPlot(const Study& study, const Knob& knob) {
  const KnobCurve curve = curveOf(study, knob);
  const std::vector<const MeasuredSetting*>& measured = curve.measured;
  const std::vector<std::string>& labels = curve.labels;
  if (measured.size() < 2) return "";
  double least_time = HUGE_VAL, most_time = 0, least_error = HUGE_VAL, most_error = 0;
  for (const auto* m : measured) {
    least_time = std::min(least_time, m->worstSeconds()), most_time = std::max(most_time, m->worstSeconds());
    if (m->worstError() > 0) least_error = std::min(least_error, drawn(*m));
    most_error = std::max(most_error, drawn(*m));
  }
  if (least_error > most_error) least_error = kFloor;
  least_error = std::max(kFloor, least_error / 3);  // room for the exact one, whose error is 0
  const double width = 440, height = 230, left = 62, right = 58, top = 26, bottom = 40;
  const Axis errors(least_error, most_error, height - bottom, top), times(least_time, most_time, height - bottom, top);
  std::string out = format("<svg viewBox=\"0 0 %g %g\" width=\"%g\" role=\"img\">\n", width, height, width) +
                    "<text x=\"62\" y=\"14\" style=\"font-weight:bold\">" + escaped(knob.name) + "</text>\n" +
                    uprightAxis(errors, true, left - 6, true, left, width - right) +
                    uprightAxis(times, false, width - right + 6, false, 0, 0);
  std::vector<std::pair<double, double>> error_line, time_line;
  for (std::size_t i = 0; i < measured.size(); ++i) {
    const double x =
        left + (width - left - right) * (static_cast<double>(i) + 0.5) / static_cast<double>(measured.size());
    error_line.emplace_back(x, errors.at(measured[i]->worstError() > 0 ? drawn(*measured[i]) : errors.low));
    time_line.emplace_back(x, times.at(measured[i]->worstSeconds()));
    out += format("<text x=\"%.1f\" y=\"%g\" text-anchor=\"middle\">", x, height - bottom + 16) + escaped(labels[i]) +
           "</text>\n";
  }
  const std::string unit = knob.unit.empty() ? "" : knob.unit + "; ";
  out += line(time_line, kTimeColour) + line(error_line, kErrorColour) +
         format("<text x=\"%g\" y=\"%g\" text-anchor=\"middle\">", (left + width - right) / 2, height - 6) +
         escaped(unit) + "exact at the left</text></svg>\n";
  const MeasuredSetting &exact = *measured.front(), &cheap = *measured.back();
  return "<div style=\"display:inline-block;width:440px;margin-right:20px;vertical-align:top\">" + out + "<p>" +
         escaped(knob.name) + " " + escaped(labels.back()) + " instead of " + escaped(labels.front()) +
         format(" costs %s of error and takes %.2f of the time", percent(cheap.worstError()).c_str(),
                cheap.worstSeconds() / exact.worstSeconds()) +
         (cheap.field_bytes != exact.field_bytes
              ? format(", in files of %.2f of the size.", cheap.field_bytes / exact.field_bytes)
              : ".") +
         (curve.error_back > kSteady && !knob.unit.empty()
              ? format(" On the way the error falls back by %.0f %%.", 100 * curve.error_back)
              : "") +
         "</p></div>\n";
}

std::string pictures(const Study& study, const PictureOf& picture) {
  const MeasuredSetting* exact = study.find(study.exact);
  const ImageF reference = picture(*exact);
  if (reference.empty()) return "";
  std::string out = format(
      "<h2>Side by side</h2>\n<p>Frame %d: the exact picture, the setting's, and where an eye that "
      "flips between both would see a difference (FLIP: black none, pale yellow 1).</p>\n",
      study.frames[study.frames.size() / 2]);
  std::vector<const MeasuredSetting*> shown;
  for (const double error : {0.1, 0.01, 0.001})
    if (const auto* m = &chooseSetting(study, error, std::nullopt, "");
        m != exact && std::find(shown.begin(), shown.end(), m) == shown.end())
      shown.push_back(m);
  for (const MeasuredSetting* m : shown) {
    const ImageF image = picture(*m);
    if (image.empty()) continue;
    const ImageDifference d = compareImages(image, reference);
    const double exposure = 1 / d.white;
    out += "<p>" + changesText(study, m->keys) +
           format(": error %s, FLIP %.4f, %.3g s a frame</p>\n", percent(m->worstError()).c_str(), d.inside.flip,
                  m->worstSeconds()) +
           png(displayImage(reference, exposure)) + " " + png(displayImage(image, exposure)) + " " +
           png(heatImage(d.flip_map)) + "\n";
  }
  return out;
}

std::string frontTable(const Study& study) {
  std::string out =
      "<h2>The front</h2>\n<table>\n<tr><th>time</th><th>error</th><th>99.9 %</th><th>PSNR</th><th>FLIP</th>";
  const bool truth = !study.reference.empty();
  out += truth ? "<th>error to truth</th><th>settings, where not exact</th></tr>\n"
               : "<th>settings, where not exact</th></tr>\n";
  for (const MeasuredSetting* m : study.front()) {
    double tail = 0, psnr = HUGE_VAL, flip = 0, true_error = 0;
    for (const FrameError& e : m->exact)
      tail = std::max(tail, e.percentile), psnr = std::min(psnr, e.psnr), flip = std::max(flip, e.flip);
    for (const FrameError& e : m->truth) true_error = std::max(true_error, e.mean);
    out += format(
        "<tr><td class=\"n\">%.3g s</td><td class=\"n\">%s</td><td class=\"n\">%s</td><td class=\"n\">%.1f dB</td>"
        "<td class=\"n\">%.4f</td>",
        m->worstSeconds(), percent(m->worstError()).c_str(), percent(tail).c_str(), psnr, flip);
    if (truth) out += "<td class=\"n\">" + percent(true_error) + "</td>";
    out += "<td>" + changesText(study, m->keys) + "</td></tr>\n";
  }
  return out +
         "</table>\n<p class=\"note\">The worst studied frame of each. \"error\" is the mean over the object's "
         "pixels of |difference| / (reference + 1 % of the peak), \"99.9 %\" its 99.9th percentile, both against "
         "the all-exact rendering. study.csv holds every setting and frame.</p>\n";
}

}  // namespace

std::string studyPage(const Study& study, const PictureOf& picture) {
  const auto listed = [](const std::vector<int>& numbers) {
    std::string out;
    for (const int number : numbers) out += (out.empty() ? "" : ", ") + std::to_string(number);
    return out;
  };
  const std::string frames = listed(study.frames), further = listed(study.further_frames);
  std::string out = "<!DOCTYPE html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"><title>" + escaped(study.scene) +
                    ": accuracy and time</title><style>" + html::kStyle +
                    "</style></head><body>\n<h1>What accuracy costs "
                    "in time</h1>\n<p class=\"note\">" +
                    escaped(study.scene) + ", frames " + frames +
                    (further.empty() ? "" : " (for the front's promises also " + further + ")") + ", srf " +
                    projectVersion() + "</p>\n";
  if (const MeasuredSetting* exact = study.find(study.exact), *own = study.find(study.own); exact && own)
    out += format("<p>The exact picture takes %.3g s a frame. The scene as it is takes %.3g s and differs by %s.</p>\n",
                  exact->worstSeconds(), own->worstSeconds(), percent(own->worstError()).c_str());
  if (study.divisor > 1)
    out += format(
        "<p class=\"note\">To fit the time, the study's pictures are 1/%d as wide and high as the scene's. Times are "
        "those of full size: measured for the scene as it is and for the front, else as many times longer as it has "
        "more pixels, which is too long rather than too short.</p>\n",
        study.divisor);
  if (!study.complete)
    out +=
        "<p class=\"warn\">The time ran out before everything was measured: run <code>srf study</code> again to go "
        "on.</p>\n";
  out += frontPlot(study) + recommendations(study) +
         format(
             "<h2>One knob at a time</h2>\n<p>All else exact: <span style=\"color:%s\">red is the error (left "
             "scale)</span>, <span style=\"color:%s\">blue the seconds a frame (right scale)</span>, both logarithmic; "
             "the exact setting's error is 0 and drawn at the bottom.</p>\n",
             kErrorColour, kTimeColour);
  for (const Knob& knob : study.knobs) out += knobPlot(study, knob);
  out += pictures(study, picture) + frontTable(study);
  out += "<h2>What \"exact\" means here</h2>\n<p>" + keysText(study.exact) +
         "</p>\n<p class=\"note\">The most exact setting that the time allowed: environment samples 0 are all texels; "
         "views and lights are the scene's own, for how many are interpolated is a choice of the method that a true "
         "picture alone can judge (--reference).</p>\n";
  return out + "</body></html>\n";
}

}  // namespace srf
