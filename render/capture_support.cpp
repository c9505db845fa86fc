#include "render/capture_support.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstdio>
#include <sstream>

#include "base/color.h"
#include "base/numeric.h"
#include "model/local_frame.h"
#include "render/view_kernels.h"

namespace srf {
namespace {

constexpr double kMostStretch = 2;

/// The median angle from a direction to the nearest other one, radians; 0 for one alone.
double spacingOf(const std::vector<Vec3>& directions) {
  if (directions.size() < 2) return 0;
  std::vector<double> nearest;
  for (std::size_t i = 0; i < directions.size(); ++i) {
    double least = kPi;
    for (std::size_t j = 0; j < directions.size(); ++j)
      if (j != i) least = std::min(least, angleBetweenUnit(directions[i], directions[j]));
    nearest.push_back(least);
  }
  return median(nearest);
}

}  // namespace

void FrameSupport::add(const HitSupport& hit) {
  ++hits;
  supported += hit.supported();
  view_far += hit.view_far;
  light_far += hit.light_far;
  occluded += hit.occluded;
  stretched += hit.stretched;
}

void FrameSupport::add(const FrameSupport& other) {
  hits += other.hits;
  supported += other.supported;
  view_far += other.view_far;
  light_far += other.light_far;
  occluded += other.occluded;
  stretched += other.stretched;
}

std::string FrameSupport::text() const {
  char line[320];
  std::snprintf(
      line, sizeof line,
      "%.0f %% of the picture is supported by the capture; further than one spacing from a view %.0f %%, from "
      "a light %.0f %%; seen by no view %.0f %%; stretched beyond 2 %.0f %%",
      100 * share(supported), 100 * share(view_far), 100 * share(light_far), 100 * share(occluded),
      100 * share(stretched));
  return line;
}

std::string FrameSupport::numbers() const {
  char line[160];
  std::snprintf(line, sizeof line, "%llu %.9g %.9g %.9g %.9g %.9g", static_cast<unsigned long long>(hits), supported,
                view_far, light_far, occluded, stretched);
  return line;
}

std::optional<FrameSupport> FrameSupport::fromNumbers(const std::string& text) {
  FrameSupport s;
  std::istringstream in(text);
  in >> s.hits >> s.supported >> s.view_far >> s.light_far >> s.occluded >> s.stretched;
  return in ? std::optional(s) : std::nullopt;
}

int supportStep(int width, int height) {
  return static_cast<int>(std::bit_floor(static_cast<unsigned>(std::max(128, std::min(width, height)) / 128)));
}

std::string supportOfFrames(std::span<const std::pair<int, FrameSupport>> frames) {
  const std::pair<int, FrameSupport>*least = nullptr, *most = nullptr;
  const auto supported = [](const auto* frame) { return frame->second.share(frame->second.supported); };
  for (const auto& frame : frames) {
    if (frame.second.hits == 0) continue;
    if (!least || supported(&frame) < supported(least)) least = &frame;
    if (!most || supported(&frame) > supported(most)) most = &frame;
  }
  if (!least) return "";
  char line[160];
  const double low = std::round(100 * supported(least)), high = std::round(100 * supported(most));
  if (low == high)
    std::snprintf(line, sizeof line, "%.0f %% of the picture is supported by the capture, in every frame", low);
  else
    std::snprintf(line, sizeof line, "%.0f to %.0f %% of the picture is supported by the capture; least in frame %d",
                  low, high, least->first);
  return line;
}

bool CaptureSupport::wanted(const std::set<std::string>& layers) {
  return layers.contains("light_angle") || layers.contains("extrapolation") || layers.contains("occlusion");
}

CaptureSupport::CaptureSupport(std::span<const SourceView> views, std::span<const AcquiredLights> lists,
                               std::span<const std::uint32_t> list_of_view, const Box<AcquisitionSpace>& object)
    : lists_(lists), list_of_view_(list_of_view) {
  const Point<AcquisitionSpace> middle = object.empty() ? Point<AcquisitionSpace>() : object.center();
  std::vector<Vec3> directions;
  for (const SourceView& view : views)
    if (view.coverage) directions.push_back(view.camera.viewDirection(middle).raw());
  view_spacing_ = spacingOf(directions);
  for (const AcquiredLights& list : lists) {
    directions.clear();
    for (const std::uint32_t i : list.usable()) directions.push_back(list.directionOf(i, middle).raw());
    light_spacing_.push_back(spacingOf(directions));
  }
}

HitSupport CaptureSupport::at(const SurfaceHit& hit, const LookUp& look_up, std::span<const ChosenView> chosen,
                              ViewSelection::Result result, const FrameLighting& lighting) const {
  constexpr double kRounding = 1e-6;  // radians; a spacing of 0 still has its own direction
  HitSupport support;
  support.occluded = result != ViewSelection::Result::seen;
  const TangentChange change = tangentChange(hit.tangents);
  support.stretched = !(change.longest <= kMostStretch && change.shortest >= 1 / kMostStretch);
  const ChosenView* most = nullptr;  // whose lights count
  double nearest = kPi;
  for (const ChosenView& view : chosen) {
    nearest = std::min(nearest, view.angle);
    if (!most || view.weight > most->weight) most = &view;
  }
  support.view_far = nearest > view_spacing_ + kRounding;
  if (!most) return support;

  const std::uint32_t index = list_of_view_[most->view];
  const AcquiredLights& list = lists_[index];
  double all = 0, far = 0, angles = 0;
  thread_local std::vector<double> gives, angle;
  gives.clear(), angle.clear();
  const auto add = [&](const Direction<ObjectSpace>& to_light, const Vec3& irradiance) {
    const Direction<AcquisitionSpace> l = look_up.acquisition_from_object * to_light;
    const double given = std::max(0.0, dot(look_up.normal.raw(), l.raw())) * dot(kLuminance, irradiance);
    if (!(given > 0)) return;
    gives.push_back(given), angle.push_back(list.chord2ToNearest(l, look_up.p));
  };
  for (const DistantLight& light : lighting.lights().distant) add(light.direction, light.irradiance);
  for (const NearLight& light : lighting.lights().near_lights) {
    const Vector<ObjectSpace> to_light = light.position - hit.p_star;
    const double d = std::max(length(to_light), lighting.options().min_distance);
    if (const auto direction = normalize(to_light)) add(*direction, light.intensity / (d * d));
  }
  const std::size_t count = gives.size();
  angle.resize(paddedLanes(count), 0);
  for (std::size_t i = 0; i < angle.size(); i += kVectorLanes) chordAngles(angle.data() + i, kVectorLanes);
  for (std::size_t i = 0; i < count; ++i) {
    all += gives[i];
    angles += gives[i] * angle[i];
    if (angle[i] > light_spacing_[index] + kRounding) far += gives[i];
  }
  for (const RestLight& light : lighting.lights().rest) {  // one of the acquired themselves
    const auto at = list.find(light.light);
    if (!at) continue;
    const Vec3 inverse = list.inverseIrradiance(*at, look_up.p);
    all += light.scale * (inverse.y > 0 ? 1 / inverse.y : 1);
  }
  if (all > 0) support.light_far = far / all, support.light_angle = degrees(angles / all);
  return support;
}

}  // namespace srf
