#include "render/acquired_lights.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "base/numeric.h"
#include "base/parallel.h"
#include "render/view_kernels.h"

namespace srf {
namespace {

struct CubeCell {
  int face, x, y;
};

CubeCell cubeCell(const Vec3& d, int resolution) {
  const double ax = std::fabs(d.x), ay = std::fabs(d.y), az = std::fabs(d.z);
  const double half = 0.5 * resolution;
  const auto cell = [&](int axis, double major, double s, double t) {
    const double scale = half / std::fabs(major);
    const auto index = [&](double x) { return std::clamp(static_cast<int>(x * scale + half), 0, resolution - 1); };
    return CubeCell{2 * axis + (major < 0 ? 1 : 0), index(s), index(t)};
  };
  if (ax >= ay && ax >= az) return cell(0, d.x, d.y, d.z);
  if (ay >= az) return cell(1, d.y, d.z, d.x);
  return cell(2, d.z, d.x, d.y);
}

/// Unit vector at face coordinates (s, t) in [-1, 1].
Vec3 cubeDirection(int face, double s, double t) {
  const int axis = face / 2;
  Vec3 d;
  d[axis] = face % 2 ? -1 : 1;
  d[(axis + 1) % 3] = s;
  d[(axis + 2) % 3] = t;
  return d / length(d);
}

double inverseOrZero(double x) {
  return x > 0 && std::isfinite(x) ? 1 / x : 0;
}

}  // namespace

AcquiredLights::AcquiredLights(const std::vector<LightId>& ids, const std::vector<CaptureLight>& all,
                               const Box<AcquisitionSpace>& object, int k)
    : ids_(ids), k_(k) {
  const Point<AcquisitionSpace> center = object.empty() ? Point<AcquisitionSpace>() : object.center();
  // Splats reach a little beyond their centres.
  const double radius = 0.55 * object.diameter();
  double parallax = 0;  // how far a light's direction may differ between the centre and a point of the object
  for (const LightId id : ids) {
    const CaptureLight& light = all[id.value];
    if (light.kind != LightKind::captured) usable_.push_back(static_cast<std::uint32_t>(lights_.size()));
    if (light.kind == LightKind::point) {
      distant_ = false;
      const double d = distance(light.position, center);
      parallax = std::max(parallax, d > radius ? std::asin(radius / d) : kPi);
    }
    lights_.push_back(light);
    direction_.push_back(light.directionFrom(center).raw());
    inverse_.push_back(
        {inverseOrZero(light.strength.x), inverseOrZero(light.strength.y), inverseOrZero(light.strength.z)});
  }
  if (usable_.empty()) return;

  // Cells about half as wide as the lights lie apart.
  resolution_ = std::clamp(static_cast<int>(2 * std::sqrt(static_cast<double>(usable_.size()))), 1, 32);
  const std::size_t cells = 6 * static_cast<std::size_t>(resolution_) * resolution_;
  std::vector<std::vector<std::uint32_t>> lists(cells);
  parallelFor(cells, 64, [&](std::size_t first, std::size_t last) {
    std::vector<Penalised> order(usable_.size());
    for (std::size_t c = first; c < last; ++c) {
      const int face = static_cast<int>(c / (resolution_ * resolution_));
      const int x = static_cast<int>(c % resolution_), y = static_cast<int>(c / resolution_ % resolution_);
      const auto at = [&](double i) { return 2 * i / resolution_ - 1; };
      const Vec3 middle = cubeDirection(face, at(x + 0.5), at(y + 0.5));
      double reach = 0;  // a cell is convex: no direction in it is further from the middle than a corner
      for (const auto& [i, j] : {std::pair{0, 0}, {0, 1}, {1, 0}, {1, 1}})
        reach = std::max(reach, angleBetweenUnit(middle, cubeDirection(face, at(x + i), at(y + j))));
      for (std::size_t i = 0; i < order.size(); ++i)
        order[i] = {angleBetweenUnit(middle, direction_[usable_[i]]), usable_[i]};
      std::sort(order.begin(), order.end());
      // From a direction in the cell and a point of the object, the (k+1)-th nearest light is at most
      // P_(k+1) + reach + parallax away, and a light at angle P is at least P - reach - parallax away.
      const std::size_t last_wanted = std::min<std::size_t>(k_, order.size() - 1);
      const double limit = order[last_wanted].penalty + 2 * (reach + parallax) + 1e-6;
      for (const Penalised& light : order)
        if (light.penalty <= limit) lists[c].push_back(light.source);
    }
  });
  begin_.reserve(cells + 1);
  for (const auto& list : lists) {
    begin_.push_back(static_cast<std::uint32_t>(candidates_.size()));
    candidates_.insert(candidates_.end(), list.begin(), list.end());
  }
  begin_.push_back(static_cast<std::uint32_t>(candidates_.size()));
  if (distant_)
    for (const std::uint32_t i : candidates_)
      for (int k = 0; k < 3; ++k) {
        candidate_direction_[k].push_back(direction_[i][k]);
        candidate_float_[k].push_back(static_cast<float>(direction_[i][k]));
      }
  for (const Vec3& inverse : inverse_)
    inverse_float_.push_back(
        {static_cast<float>(inverse.x), static_cast<float>(inverse.y), static_cast<float>(inverse.z)});
}

std::optional<LightCells> AcquiredLights::cells() const {
  if (!distant_ || usable_.size() <= static_cast<std::size_t>(k_) || k_ > kMostNearest) return std::nullopt;
  return LightCells{resolution_,
                    begin_.data(),
                    candidates_.data(),
                    candidate_float_[0].data(),
                    candidate_float_[1].data(),
                    candidate_float_[2].data()};
}

std::optional<std::uint32_t> AcquiredLights::find(LightId light) const {
  const auto at = std::find(ids_.begin(), ids_.end(), light);
  if (at == ids_.end()) return std::nullopt;
  return static_cast<std::uint32_t>(at - ids_.begin());
}

AcquiredLights::Cell AcquiredLights::cell(const Vec3& direction) const {
  const CubeCell at = cubeCell(direction, resolution_);
  const std::size_t c = (static_cast<std::size_t>(at.face) * resolution_ + at.y) * resolution_ + at.x;
  return {begin_[c], begin_[c + 1]};
}

std::span<const double> AcquiredLights::chord2OfCell(const Cell& of, const Direction<AcquisitionSpace>& direction,
                                                     const Point<AcquisitionSpace>& p) const {
  const std::size_t count = of.end - of.begin;
  thread_local std::vector<double> memory;
  if (memory.size() < count) memory.resize(count);
  double* const chord2 = memory.data();
  const Vec3& d = direction.raw();
  if (distant_) {
    squaredChords(d, candidate_direction_[0].data() + of.begin, candidate_direction_[1].data() + of.begin,
                  candidate_direction_[2].data() + of.begin, count, chord2);
  } else {
    for (std::size_t c = 0; c < count; ++c) {
      const Vec3 difference = d - lights_[candidates_[of.begin + c]].directionFrom(p).raw();
      chord2[c] = dot(difference, difference);
    }
  }
  return {chord2, count};
}

void AcquiredLights::ranked(const Direction<AcquisitionSpace>& direction, const Point<AcquisitionSpace>& p,
                            std::vector<Penalised>& scratch) const {
  scratch.clear();
  if (usable_.empty()) return;
  // Ranked by the square of the chord, which grows with the angle and keeps the digits of small ones; only the k + 1
  // nearest pay for an arcsine.
  const Cell of = cell(direction.raw());
  const std::span<const double> chord2 = chord2OfCell(of, direction, p);
  const std::size_t count = chord2.size();
  const std::uint32_t* const candidates = candidates_.data() + of.begin;
  const std::size_t wanted = std::min<std::size_t>(k_ + std::size_t{1}, count);
  scratch.assign(wanted, {std::numeric_limits<double>::infinity(), ~0u});
  Penalised* const least = scratch.data();
  double worst = least[wanted - 1].penalty;
  for (std::size_t c = 0; c < count; ++c) {
    if (chord2[c] > worst) continue;
    const Penalised light{chord2[c], candidates[c]};
    std::size_t at = wanted - 1;
    if (!(light < least[at])) continue;
    for (; at > 0 && light < least[at - 1]; --at) least[at] = least[at - 1];
    least[at] = light;
    worst = least[wanted - 1].penalty;
  }
  const auto floored = [](double c2) { return std::max(c2, square(kLeastPenalty)); };
  if (floored(scratch.back().penalty) == floored(scratch.front().penalty)) {
    // All tie: the others that tie with them share too (lumigraphWeights).
    const double tie = floored(scratch.front().penalty);
    scratch.clear();
    for (std::size_t c = 0; c < count; ++c)
      if (floored(chord2[c]) <= tie) scratch.push_back({chord2[c], candidates[c]});
  }
  for (std::size_t at = 0; at < scratch.size(); at += kVectorLanes) {
    double angle[kVectorLanes] = {};
    const std::size_t some = std::min(kVectorLanes, scratch.size() - at);
    for (std::size_t i = 0; i < some; ++i) angle[i] = scratch[at + i].penalty;
    chordAngles(angle, some);
    for (std::size_t i = 0; i < some; ++i) scratch[at + i].penalty = angle[i];
  }
}

void AcquiredLights::nearest(const Direction<AcquisitionSpace>& direction, const Point<AcquisitionSpace>& p,
                             std::vector<Penalised>& scratch, std::vector<Weighted>& weights) const {
  ranked(direction, p, scratch);
  lumigraphWeights(scratch, k_, weights);
}

double AcquiredLights::distanceTo(std::uint32_t i, const Point<AcquisitionSpace>& p) const {
  return lights_[i].kind == LightKind::point ? distance(lights_[i].position, p)
                                             : std::numeric_limits<double>::infinity();
}

double AcquiredLights::chord2ToNearest(const Direction<AcquisitionSpace>& direction,
                                       const Point<AcquisitionSpace>& p) const {
  return std::ranges::min(chord2OfCell(cell(direction.raw()), direction, p));
}

Vec3 AcquiredLights::inverseIrradiance(std::uint32_t i, const Point<AcquisitionSpace>& p) const {
  if (lights_[i].kind != LightKind::point) return inverse_[i];
  const double d = distance(lights_[i].position, p);
  return (d * d) * inverse_[i];
}

}  // namespace srf
