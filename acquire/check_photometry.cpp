#include "acquire/check_photometry.h"

#include <cmath>
#include <map>
#include <set>

#include "acquire/check_section.h"
#include "base/text.h"

namespace srf {
namespace {

constexpr double kPoorFit = 0.3;  // correlation of shading and photographs that cannot be right
constexpr double kDrift = 0.05;   // change of exposure over a capture that is told

}  // namespace

void reportLightTable(const Capture& capture, const PhotometricReport& found, CheckReport& report) {
  Section section(report, "light table");
  const std::string file = (capture.folder / "transforms.json").string();
  Capture& mended = report.mended.capture;
  if (!found.why_not.empty()) {
    section.finish("not looked at: " + found.why_not);
    return;
  }
  if (found.axes) {
    const std::string change = axesText(*found.axes);
    section.fault(file,
                  "the lights do not fit the photographs (correlation " + fixedNumber(found.fit, 2) +
                      " with their shading); they do (" + fixedNumber(found.axes_fit, 2) + ") with " + change,
                  "write the directions and positions of all lights with " + change);
    for (CaptureLight& light : mended.lights) {
      light.direction = Direction<AcquisitionSpace>::fromUnit(*found.axes * light.direction.raw());
      light.position = Point<AcquisitionSpace>(*found.axes * light.position.raw());
    }
    report.mended.what.push_back("all lights: " + change);
  } else if (found.fit < kPoorFit) {
    section.warn(file,
                 "the lights fit the photographs poorly: correlation " + fixedNumber(found.fit, 2) +
                     " with the shading of the hull",
                 "see whether lights and cameras are given in the same axes; mirrors of the table do not help");
  }
  // Where each light's photographs belong; two that belong to each other were exchanged.
  std::map<std::uint32_t, const ForeignLight*> belongs;
  for (const ForeignLight& f : found.foreign) belongs[f.light.value] = &f;
  const std::vector<CaptureLight> told = mended.lights;
  for (const ForeignLight& f : found.foreign) {
    const auto other = belongs.find(f.fits.value);
    const bool swapped = other != belongs.end() && other->second->fits == f.light;
    CaptureLight& light = mended.lights[f.light.value];
    light.direction = told[f.fits.value].direction;
    light.position = told[f.fits.value].position;
    const std::string a = "'" + told[f.light.value].name + "'", b = "'" + told[f.fits.value].name + "'";
    const auto fit =
        " (correlation " + fixedNumber(f.after, 2) + " there, " + fixedNumber(f.before, 2) + " at its own)";
    if (swapped && f.light > f.fits) continue;
    section.fault(
        file,
        swapped ? "lights " + a + " and " + b + " are exchanged: the photographs of each show the other's shading" + fit
                : "the photographs of light " + a + " show the shading of light " + b + fit,
        swapped ? "exchange the two directions or positions, or the two lights' photographs"
                : "see which light each photograph belongs to: give " + a + " the place of " + b);
    report.mended.what.push_back(swapped ? "lights " + a + " and " + b + ": places exchanged"
                                         : "light " + a + ": given the place of " + b);
  }
  for (const StrayLight& s : found.stray) {
    const Vec3 d = s.seen_from.raw();
    section.warn(file,
                 "light '" + told[s.light.value].name + "' stands " + fixedNumber(s.off, 0) +
                     " degrees from where its photographs are lit from, about (" + fixedNumber(d.x, 2) + ", " +
                     fixedNumber(d.y, 2) + ", " + fixedNumber(d.z, 2) + ") (correlation " + fixedNumber(s.after, 2) +
                     " there, " + fixedNumber(s.before, 2) + " as told)",
                 "measure it again, or see whether its photographs are another light's");
  }
  section.finish("as the photographs show it: correlation " + fixedNumber(found.fit, 2) +
                 " with the shading of the hull");
}

void reportTurned(const Capture& capture, const PhotometricReport& found, CheckReport& report) {
  Section section(report, "photographs upright");
  std::vector<std::set<std::size_t>> drop(capture.views.size());
  for (const TurnedPhoto& t : found.turned) {
    section.fault(capture.views[t.view].photos[t.photo].file.string(),
                  "is " + t.how + ": its shading fits by " + fixedNumber(t.after, 2) + " when it is turned back, by " +
                      fixedNumber(t.before, 2) + " as it is",
                  "turn the picture back (and see whether its EXIF orientation was applied twice)");
    drop[t.view].insert(t.photo);
    report.mended.what.push_back(capture.views[t.view].photos[t.photo].file.string() + ": left out, it is " + t.how);
  }
  for (std::size_t v = 0; v < drop.size(); ++v)
    for (auto p = drop[v].rbegin(); p != drop[v].rend(); ++p)
      report.mended.capture.views[v].photos.erase(report.mended.capture.views[v].photos.begin() +
                                                  static_cast<std::ptrdiff_t>(*p));
  section.finish(found.why_not.empty() ? "none is turned or mirrored against its shading"
                                       : "not looked at: " + found.why_not);
}

void reportExposure(const Capture& capture, const PhotometricReport& found, CheckReport& report) {
  Section section(report, "exposure");
  if (found.gain.empty()) {
    section.finish("not looked at: too few points are seen by several views");
    return;
  }
  report.view_gain = found.gain;
  if (std::fabs(found.drift) > kDrift && std::fabs(found.drift) > 4 * found.drift_error)
    section.warn(capture.views.back().name,
                 std::string("the photographs grow ") + (found.drift > 0 ? "brighter" : "darker") + " by " +
                     fixedNumber(100 * std::fabs(found.drift), 0) + " % (+- " +
                     fixedNumber(200 * found.drift_error, 0) + ") from the first view to the last",
                 "see whether the lights were warm and the exposure fixed; divide each photograph by its view's gain "
                 "(in the --json and --report files)");
  section.finish("steady: " + fixedNumber(100 * found.drift, 1, true) + " % from the first view to the last");
}

}  // namespace srf
