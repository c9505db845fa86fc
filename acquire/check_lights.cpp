#include "acquire/check_lights.h"

#include <algorithm>
#include <cmath>
#include <set>

#include "acquire/check_section.h"
#include "base/numeric.h"
#include "base/text.h"

namespace srf {
namespace {

constexpr double kWideGap = 45;  // degrees without any view or light

/// The direction with nothing near it, and the angle to the nearest.
struct Gap {
  Vec3 direction;
  double angle = 0;  // degrees
};
Gap widestGap(const std::vector<Vec3>& directions) {
  constexpr int kSamples = 2000;  // 2.4 degrees apart
  Gap widest;
  for (int i = 0; i < kSamples; ++i) {
    const double z = 1 - (2 * i + 1.0) / kSamples, r = std::sqrt(1 - z * z), turn = i * kPi * (3 - std::sqrt(5.0));
    const Vec3 d{r * std::cos(turn), r * std::sin(turn), z};
    double nearest = kPi;
    for (const Vec3& e : directions) nearest = std::min(nearest, angleBetweenUnit(d, e));
    if (degrees(nearest) > widest.angle) widest = {d, degrees(nearest)};
  }
  return widest;
}

void reportCoverage(Section& section, const std::vector<Vec3>& directions, const std::string& noun) {
  const Gap gap = widestGap(directions);
  const std::string found = counted(directions.size(), noun + " direction") + ", the widest gap " +
                            fixedNumber(gap.angle, 0) + " degrees about (" + fixedNumber(gap.direction.x, 2) + ", " +
                            fixedNumber(gap.direction.y, 2) + ", " + fixedNumber(gap.direction.z, 2) + ")";
  if (gap.angle > kWideGap)
    section.warn("", found, "add " + noun + "s there if the animation shows that side; it will be extrapolated");
  section.finish(found);
}

}  // namespace

void checkCells(const Capture& capture, CheckReport& report) {
  Section section(report, "views x lights");
  if (capture.unknownIllumination()) {
    section.finish(counted(capture.views.size(), "view") + " under the one light of the photographs");
    return;
  }
  std::vector<std::set<std::uint32_t>> lights(capture.views.size());
  std::set<std::uint32_t> used;
  std::size_t most = 0, cells = 0;
  for (std::size_t v = 0; v < capture.views.size(); ++v) {
    for (const Photo& photo : capture.views[v].photos) {
      if (!photo.light) continue;
      if (!lights[v].insert(photo.light->value).second)
        section.fault(
            photo.file.string(),
            "is a second photograph of this view under light '" + capture.lights[photo.light->value].name + "'",
            "keep one of them");
      used.insert(photo.light->value);
    }
    most = std::max(most, lights[v].size());
    cells += lights[v].size();
  }
  if (cells == 0)
    section.fault(capture.folder.string(), "no photograph names a light",
                  "give the frames their lights, or remove /lights for one unknown illumination");
  // On a turntable the lights move with the views: then each has its own, and none lacks another's.
  const bool shared = used.size() < 2 * std::max<std::size_t>(most, 1);
  for (std::size_t v = 0; v < capture.views.size(); ++v) {
    if (lights[v].empty() || lights[v].size() == (shared ? used.size() : most)) continue;
    std::string missing;
    if (shared)
      for (const std::uint32_t l : used)
        if (!lights[v].contains(l)) {
          missing = ", for one '" + capture.lights[l].name + "'";
          break;
        }
    section.warn(capture.views[v].name,
                 "has " + std::to_string(lights[v].size()) + " of " + std::to_string(shared ? used.size() : most) +
                     " lights" + missing,
                 "take the missing photographs; the look-up interpolates from the others until then");
  }
  for (std::size_t l = 0; l < capture.lights.size(); ++l)
    if (!used.contains(static_cast<std::uint32_t>(l)))
      section.warn("", "light '" + capture.lights[l].name + "' has no photograph", "add its photographs or remove it");
  section.finish(counted(cells, "photograph") + ": " + counted(capture.views.size(), "view") + " with " +
                 counted(most, "light") + " each");
}

Point<AcquisitionSpace> objectCentre(const Capture& capture) {
  if (capture.bounds) return capture.bounds->center();
  // The point nearest to all optical axes: sum of (I - f f^T) (x - o) = 0.
  Mat3 a{{Vec3{}, Vec3{}, Vec3{}}};
  Vec3 b;
  for (const CaptureView& view : capture.views) {
    const Vec3 f = view.camera.forward().raw(), o = view.camera.center().raw();
    for (int i = 0; i < 3; ++i)
      for (int j = 0; j < 3; ++j) {
        const double m = (i == j) - f[i] * f[j];
        a.row[i][j] += m;
        b[i] += m * o[j];
      }
  }
  const Vec3 x = inverse(a) * b;
  return Point<AcquisitionSpace>(isFinite(x) ? x : capture.views.front().camera.center().raw());
}

void checkLightsAndCoverage(const Capture& capture, CheckReport& report) {
  const Point<AcquisitionSpace> centre = objectCentre(capture);
  Section views(report, "coverage by views");
  std::vector<Vec3> view_directions, light_directions;
  for (const CaptureView& view : capture.views) view_directions.push_back(view.camera.viewDirection(centre).raw());
  reportCoverage(views, view_directions, "view");
  report.view_directions = view_directions;
  if (capture.unknownIllumination()) return;

  Section lights(report, "lights");
  for (const CaptureLight& light : capture.lights) {
    light_directions.push_back(light.directionFrom(centre).raw());
    if (!isFinite(light.strength) || !(minComponent(light.strength) >= 0) || !(maxComponent(light.strength) > 0))
      lights.fault("", "light '" + light.name + "' has no strength above 0",
                   "give it the irradiance or intensity that was measured");
    if (light.kind == LightKind::point && capture.bounds &&
        distance(light.position, centre) < 0.5 * capture.bounds->diameter())
      lights.warn("", "light '" + light.name + "' lies within the object's bounds", "mend its position or its units");
  }
  // A view that sees one direction under two names: the weights of the look-up cannot tell them apart.
  std::set<std::pair<std::uint32_t, std::uint32_t>> told;
  for (const CaptureView& view : capture.views)
    for (std::size_t i = 0; i < view.photos.size(); ++i)
      for (std::size_t j = 0; j < i; ++j) {
        if (!view.photos[i].light || !view.photos[j].light) continue;
        const auto a = view.photos[j].light->value, b = view.photos[i].light->value;
        if (a == b || degrees(angleBetweenUnit(light_directions[a], light_directions[b])) > 0.1) continue;
        if (told.emplace(std::min(a, b), std::max(a, b)).second)
          lights.warn("",
                      "lights '" + capture.lights[a].name + "' and '" + capture.lights[b].name +
                          "' shine from the same direction",
                      "remove one of them");
      }
  lights.finish(counted(capture.lights.size(), "light") + ", all of different direction and of strength above 0");
  Section cover(report, "coverage by lights");
  reportCoverage(cover, light_directions, "light");
  report.light_directions = light_directions;
}

}  // namespace srf
