#include "render/ground.h"

#include <algorithm>
#include <cmath>

#include "base/color.h"
#include "base/numeric.h"
#include "render/pixel_noise.h"

namespace srf {
namespace {

/// Whether a ray meets the box (slabs).
bool meets(const Box<ObjectSpace>& box, const Point<ObjectSpace>& origin, const Direction<ObjectSpace>& direction,
           double far_distance) {
  double near_t = 0, far_t = far_distance;
  for (int axis = 0; axis < 3; ++axis) {
    const double o = origin.raw()[axis], d = direction.raw()[axis];
    if (std::fabs(d) < 1e-300) {
      if (o < box.min[axis] || o > box.max[axis]) return false;
      continue;
    }
    const double a = (box.min[axis] - o) / d, b = (box.max[axis] - o) / d;
    near_t = std::max(near_t, std::min(a, b));
    far_t = std::min(far_t, std::max(a, b));
  }
  return near_t <= far_t;
}

}  // namespace

GroundShading::GroundShading(const GroundPlane& plane, const FrameLights& lights, const DeformedModel& object,
                             const Options& options)
    : plane_(plane), lights_(lights), object_(object), options_(options), bounds_(object.bounds()) {
  std::vector<Light> all;
  double left = 0;
  for (const DistantLight& light : lights.distant) {
    const double cosine = light.direction.raw().z;
    if (!(cosine > 0)) continue;
    all.push_back({light.direction, cosine * light.irradiance, dot(kLuminance, cosine * light.irradiance)});
    open_ += all.back().irradiance;
    left += all.back().strength;
  }
  // A light that would be asked at every turn anyway is asked by a ray of its own; the others take turns, each as often
  // as its strength says, so that every ray tells of as much light as any other.
  std::stable_sort(all.begin(), all.end(), [](const Light& a, const Light& b) { return a.strength > b.strength; });
  turns_ = std::max(1, options.shadow_rays);
  std::size_t next = 0;
  for (; next < all.size() && turns_ > 0; ++next) {
    const bool all_fit = all.size() - next <= static_cast<std::size_t>(turns_);
    if (!all_fit && all[next].strength * turns_ < left) break;
    left -= all[next].strength;
    --turns_;
    always_.push_back(all[next]);
  }
  double sum = 0;
  for (; next < all.size(); ++next) {
    if (!(all[next].strength > 0)) break;
    in_turn_.push_back(all[next]);
    up_to_.push_back(sum += all[next].strength);
  }
}

std::uint64_t GroundShading::shade(std::span<const Ray<ObjectSpace>> rays, std::span<const std::uint32_t> pixel,
                                   int width, std::span<SurfaceHit> hits, std::vector<GroundSample>& samples) const {
  struct Question {
    std::size_t sample;
    Vec3 irradiance;  // what does not arrive if something is in the way
  };
  std::vector<Ray<ObjectSpace>> shadow_rays;
  std::vector<double> far_distances;
  std::vector<Question> questions;
  std::vector<Vec3> open, blocked;
  const std::size_t first = samples.size();
  // The plane is exact, the object's floats are not: rays start a little above.
  const double offset = 1e-6 * bounds_.diameter();
  int index = 0;  // of the ray in its pixel
  for (std::size_t i = 0; i < rays.size(); ++i) {
    index = i > 0 && pixel[i] == pixel[i - 1] ? index + 1 : 0;
    const Ray<ObjectSpace>& ray = rays[i];
    const double down = ray.direction.raw().z, above = ray.origin.raw().z - plane_.height;
    if (!(down < 0 && above > 0)) continue;
    const double distance_to_plane = above / -down;
    if (!std::isfinite(distance_to_plane) || (hits[i].count > 0 && hits[i].distance <= distance_to_plane)) continue;
    hits[i].count = 0;
    Point<ObjectSpace> p = ray.origin + distance_to_plane * ray.direction;
    p = Point<ObjectSpace>(p.raw().x, p.raw().y, plane_.height + offset);
    samples.push_back({pixel[i], {}});
    open.push_back(open_);
    blocked.emplace_back();
    const auto ask = [&](const Direction<ObjectSpace>& direction, double far_distance, const Vec3& irradiance) {
      if (bounds_.empty() || !meets(bounds_, p, direction, far_distance)) return;
      shadow_rays.push_back({p, direction});
      far_distances.push_back(far_distance);
      questions.push_back({open.size() - 1, irradiance});
    };
    for (const Light& light : always_) ask(light.direction, INFINITY, light.irradiance);
    if (!in_turn_.empty() && turns_ > 0) {
      const double part = up_to_.back() / turns_;
      const int x = static_cast<int>(pixel[i] % width), y = static_cast<int>(pixel[i] / width);
      const double start = pixelNoise(x, y, index);
      for (int turn = 0; turn < turns_; ++turn) {
        const auto at = std::lower_bound(up_to_.begin(), up_to_.end(), (turn + start) * part);
        const Light& light = in_turn_[std::min<std::size_t>(at - up_to_.begin(), in_turn_.size() - 1)];
        ask(light.direction, INFINITY, (part / light.strength) * light.irradiance);
      }
    }
    for (const NearLight& light : lights_.near_lights) {
      const Vector<ObjectSpace> to = light.position - p;
      const double d = std::max(length(to), options_.min_distance);
      const auto direction = normalize(to);
      if (!direction || !(direction->raw().z > 0)) continue;
      const Vec3 irradiance = (direction->raw().z / (d * d)) * light.intensity;
      open.back() += irradiance;
      ask(*direction, 0.999 * length(to), irradiance);
    }
  }
  std::vector<std::uint8_t> shadowed(shadow_rays.size());
  object_.rays().occluded(shadow_rays, far_distances, 0, shadowed);
  for (std::size_t i = 0; i < questions.size(); ++i)
    if (shadowed[i]) blocked[questions[i].sample] += questions[i].irradiance;
  for (std::size_t i = 0; i < open.size(); ++i) {
    auto& rgba = samples[first + i].rgba;
    const double lost = dot(kLuminance, blocked[i]), all = dot(kLuminance, open[i]);
    if (plane_.shadow_only) {
      rgba[3] = static_cast<float>(all > 0 ? std::clamp(lost / all, 0.0, 1.0) : 0);
      continue;
    }
    for (int c = 0; c < 3; ++c)
      rgba[c] = static_cast<float>(plane_.albedo[c] / kPi * std::max(0.0, open[i][c] - blocked[i][c]));
    rgba[3] = 1;
  }
  return shadow_rays.size();
}

}  // namespace srf
