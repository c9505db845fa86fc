#include "apps/report.h"

#include <algorithm>
#include <set>

#include "apps/html.h"
#include "apps/program.h"
#include "base/files.h"
#include "base/numeric.h"
#include "base/text.h"

namespace srf {
namespace {

using html::base64;
using html::escaped;

std::string viewName(const StoredView& view) {
  return escaped(view.name.substr(0, 60));
}

std::string row(const std::string& name, const std::string& value) {
  return "<tr><td>" + escaped(name) + "</td><td>" + escaped(value) + "</td></tr>\n";
}

std::string lightsText(const SrfManifest& field) {
  if (field.unknownIllumination()) return "the one unknown illumination of the photographs";
  std::set<std::vector<LightId>> sets;
  std::size_t least = SIZE_MAX, most = 0;
  for (const StoredView& view : field.views) {
    if (view.file.empty()) continue;
    sets.insert(view.lights);
    least = std::min(least, view.lights.size());
    most = std::max(most, view.lights.size());
  }
  std::string text = std::to_string(field.lights.size());
  if (sets.size() > 1) text += format(", %zu to %zu in a view, %zu different sets", least, most, sets.size());
  return text;
}

/// How much of the pictures the capture supports, why the rest is not, and what it cost to tell.
std::string support(const PipelineReport& report) {
  std::vector<std::pair<int, FrameSupport>> told;
  FrameSupport all;
  for (const RenderedFrame& frame : report.frames)
    if (frame.support) told.emplace_back(frame.frame, *frame.support), all.add(*frame.support);
  const std::string sentence = supportOfFrames(told);
  if (sentence.empty()) return "";
  std::string text = sentence + ".";
  if (told.size() < report.frames.size())
    text += format(" Told of %zu frames: the others were kept from a run that did not ask.", told.size());
  std::string rows = row("support", text) + row("over these frames", all.text());
  if (const auto took = report.figures.find("seconds.support"); took != report.figures.end()) {
    double seconds = 0;
    for (const RenderedFrame& frame : report.frames) seconds += frame.kept ? 0 : frame.seconds;
    rows += row("telling it took", format("%.2g s, %.1f %% of the time of the frames rendered now", took->second,
                                          100 * took->second / seconds));
  }
  return rows;
}

std::string summary(const PipelineReport& report) {
  const std::string& units = report.field.units;
  std::string out =
      "<table>\n" + row("views", std::to_string(report.field.views.size())) + row("lights", lightsText(report.field));
  if (report.hull) {
    const MeshTopology topology = meshTopology(*report.hull);
    out += row("hull", format("%zu triangles, %s, volume %.4g %s³", report.hull->triangles.size(),
                              topology.closed ? "closed" : "NOT closed", meshVolume(*report.hull), units.c_str()));
  }
  if (const auto cell = report.figures.find("hull.cell"); cell != report.figures.end())
    out += row("finest hull cell", format("%.4g %s", cell->second, units.c_str()));
  out += row("model", report.model) +
         row("size of the object", format("%.4g %s along the diagonal", report.bounds.diameter(), units.c_str()));
  double seconds = 0;
  std::size_t rendered = 0;
  for (const RenderedFrame& frame : report.frames)
    if (!frame.kept) seconds += frame.seconds, ++rendered;
  std::string frames = std::to_string(report.frames.size());
  if (rendered < report.frames.size())
    frames += format(", %zu of them kept from an earlier run", report.frames.size() - rendered);
  if (rendered > 0) frames += format(", %.2f s a rendered frame", seconds / static_cast<double>(rendered));
  out += row("frames", frames) + support(report);
  if (!report.video.empty()) out += row("video", report.video.filename().string());
  return out + "</table>\n";
}

std::string frames(const PipelineReport& report) {
  std::string list;
  for (const int frame : report.sheet_frames) list += (list.empty() ? "" : ", ") + std::to_string(frame);
  return "<h2>Frames</h2>\n<img alt=\"contact sheet\" src=\"data:image/png;base64," +
         base64(readBinaryFile(report.contact_sheet)) + "\">\n<p class=\"note\">Frames " + list +
         format(", row by row. Shown with exposure %.3g and the sRGB curve; the EXR frames are linear.</p>\n",
                report.exposure);
}

// Bars of 1 - IoU: what is wrong is what one wants to see.
std::string hullAgreement(const PipelineReport& report) {
  std::string out = "<h2>How the hull agrees with each silhouette</h2>\n";
  std::vector<double> wrong;
  for (const StoredView& view : report.field.views) wrong.push_back(100 * (1 - view.silhouette_iou));
  if (!report.hull || wrong.empty()) return out + "<p>No hull was carved for this field.</p>\n";
  const std::size_t worst = static_cast<std::size_t>(std::max_element(wrong.begin(), wrong.end()) - wrong.begin());
  double sum = 0;
  for (const double w : wrong) sum += w;
  const double mean = sum / static_cast<double>(wrong.size()), top = std::max(wrong[worst] * 1.1, 0.1);
  const double width = 900, height = 180, left = 46, bottom = 24;
  const double step = (width - left) / static_cast<double>(wrong.size());
  const auto y = [&](double w) { return (height - bottom) * (1 - w / top); };
  out += format("<svg viewBox=\"0 0 %g %g\" width=\"%g\">\n", width, height, width);
  for (const double tick : {0.0, top / 2, top})
    out += format(
        "<line x1=\"%g\" x2=\"%g\" y1=\"%.1f\" y2=\"%.1f\" stroke=\"#ddd\"/><text x=\"%g\" y=\"%.1f\" "
        "text-anchor=\"end\">%.2g %%</text>\n",
        left, width, y(tick), y(tick), left - 4, std::max(10.0, y(tick) + 4), tick);
  for (std::size_t i = 0; i < wrong.size(); ++i)
    out += format(
        "<rect x=\"%.2f\" y=\"%.2f\" width=\"%.2f\" height=\"%.2f\" fill=\"%s\"><title>%s: IoU %.4f</title></rect>\n",
        left + step * static_cast<double>(i), y(wrong[i]), std::max(0.5, step * 0.8), height - bottom - y(wrong[i]),
        i == worst ? "#c0392b" : "#4a7ebb", viewName(report.field.views[i]).c_str(),
        report.field.views[i].silhouette_iou);
  out += format("<text x=\"%g\" y=\"%g\">%s</text><text x=\"%g\" y=\"%g\" text-anchor=\"end\">%s</text></svg>\n", left,
                height - 8, viewName(report.field.views.front()).c_str(), width, height - 8,
                viewName(report.field.views.back()).c_str());
  return out +
         format("<p>Worst: <b>%s</b>, IoU %.4f. Mean IoU %.4f.</p>\n", viewName(report.field.views[worst]).c_str(),
                1 - wrong[worst] / 100, 1 - mean / 100) +
         "<p class=\"note\">A bar is the share of pixels in which the projected hull and the mask of that view differ "
         "(1 - "
         "intersection over union). Bars of like height are the pixel grid and the hull's resolution. One bar far "
         "above its "
         "neighbours is a view whose mask or pose is wrong: look at its mask first, then at its pose, or leave the "
         "view out.</p>\n";
}

std::string lightMap(const PipelineReport& report) {
  const Point<AcquisitionSpace> center = report.bounds.empty() ? Point<AcquisitionSpace>() : report.bounds.center();
  html::HemisphereMap map;
  for (const CaptureLight& light : report.field.lights)
    if (light.kind != LightKind::captured) map.add(light.directionFrom(center).raw(), true);
  for (const StoredView& view : report.field.views) map.add(view.camera.viewDirection(center).raw(), false);
  std::string out = "<h2>Where light and views came from</h2>\n" + map.svg();
  out += "<p class=\"note\">Directions from the object's centre: ";
  out += report.field.unknownIllumination() ? "squares are views. The light of the photographs is unknown, so there is "
                                              "none to draw: this field can be lit as it was "
                                              "photographed alone."
                                            : "yellow dots are acquired lights, blue squares are views. Highlights are "
                                              "blurred over the distance between lights.";
  return out +
         " Areas are true, rings stand at 30 and 60 degrees from the pole. Where a region holds neither, what is shown "
         "from there or lit from there is extrapolated from its neighbours.</p>\n";
}

std::string timings(const PipelineReport& report) {
  std::string out = "<h2>Time</h2>\n<table>\n";
  double most = 1e-9;
  for (const auto& stage : report.stages) most = std::max(most, stage.seconds);
  for (const auto& stage : report.stages)
    out += "<tr><td>" + escaped(stage.name) +
           format("</td><td class=\"n\">%.2f s</td><td class=\"n\">%llu</td>", stage.seconds,
                  static_cast<unsigned long long>(stage.steps)) +
           format("<td style=\"width:420px\"><div class=\"bar\" style=\"width:%.1f%%\"></div></td></tr>\n",
                  100 * stage.seconds / most);
  return out +
         "</table>\n<p class=\"note\">Seconds and steps of each stage; a stage inside another counts in both. Stages "
         "that an earlier "
         "run had finished are shown with the time they took then.</p>\n";
}

std::string warnings(const PipelineReport& report) {
  std::string out = "<h2>Warnings</h2>\n";
  if (report.warnings.empty()) return out + "<p>None.</p>\n";
  out += "<ul>\n";
  for (const std::string& text : report.warnings) out += "<li class=\"warn\">" + escaped(text) + "</li>\n";
  return out + "</ul>\n";
}

// How to read the names; those that are not here speak for themselves.
const std::map<std::string, std::string>& meanings() {
  static const std::map<std::string, std::string> kMeanings{
      {"pixels.nan", "pixels of photographs that are NaN or infinite: left out"},
      {"pixels.clamped", "values beyond the range of half floats: clamped"},
      {"pixels.negative", "pixels of photographs below 0"},
      {"pixels.not_finite", "pixels of frames that came out NaN or infinite: a fault of the program"},
      {"environment.unusable_texels", "texels of the map that are negative, NaN or infinite: taken as 0"},
      {"hull.views_left_out", "views whose silhouettes contradict the others"},
      {"hull.dust", "loose bits of the carved shape that were dropped"},
      {"hull.iou.mean", "agreement with the silhouettes, mean; 1 is perfect"},
      {"hull.iou.least", "the same, worst view"},
      {"model.unseen_points", "points of the model that no view sees: shown by their neighbours' views"},
      {"points.collapsed", "points whose deformed tangents gave no frame"},
      {"points.mirrored", "points that the deformation mirrors"},
      {"points.not_finite", "points that the deformation sends nowhere: dropped"},
      {"frame.collapsed", "hits whose deformed tangents gave no frame"},
      {"hits", "samples that met the object"},
      {"hits.no_visible_view", "hits that no view sees: shown by the nearest view"},
      {"hits.no_view", "hits that no photograph covers: left black"},
      {"operations", "shading operations: a hit in a view under all its lights"},
      {"light_vectors", "vectors of light weights made for them"},
      {"cache.hits", "blocks found in memory"},
      {"cache.misses", "blocks read from disk"},
      {"cache.reread", "blocks read more than once: raise --memory where this is large"},
      {"cache.bytes_read", "read from disk, bytes"},
      {"cache.peak_bytes", "most decoded blocks held at once, bytes"}};
  return kMeanings;
}

std::string counters(const PipelineReport& report) {
  std::string out = "<h2>Counters and figures</h2>\n<table>\n";
  const auto line = [&](const std::string& name, const std::string& value) {
    const auto meaning = meanings().find(name);
    out += "<tr><td>" + escaped(name) + "</td><td class=\"n\">" + value + "</td><td class=\"note\">" +
           (meaning == meanings().end() ? "" : meaning->second) + "</td></tr>\n";
  };
  for (const auto& [name, count] : report.counters) line(name, std::to_string(count));
  for (const auto& [name, value] : report.figures)
    if (!name.starts_with("support.")) line(name, format("%.6g", value));  // told in words above
  return out + "</table>\n<p class=\"note\">Summed over all frames that the last run rendered.</p>\n";
}

}  // namespace

std::string reportPage(const PipelineReport& report) {
  return "<!DOCTYPE html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"><title>" + escaped(report.field.source) +
         ": reflectance field report</title><style>" + html::kStyle + "</style></head><body>\n<h1>" +
         escaped(report.field.source) + "</h1>\n<p class=\"note\">" + escaped(report.scene.string()) + ", srf " +
         projectVersion() + "</p>\n<p><code>" + escaped(report.command) + "</code></p>\n" + summary(report) +
         frames(report) + warnings(report) + hullAgreement(report) + lightMap(report) + timings(report) +
         counters(report) + "</body></html>\n";
}

}  // namespace srf
