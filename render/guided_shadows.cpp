// Shadow rays of guided interpolation: by whom they are sent, and who is told what they find.
#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>

#include "render/cast_shadows.h"
#include "render/guided_interpolation.h"
#include "render/guided_lanes.h"
#include "render/pixel_rays.h"

namespace srf {
namespace {

constexpr std::size_t kRaysAtOnce = 1024;
constexpr int kCellsAlong = kPixelBlock;  // whose cells are whole pixels
static_assert((kCellsAlong & (kCellsAlong - 1)) == 0);
// Hits tell each other what is hidden where the surface between them is flat to this share of their distance, and their
// normals agree to this cosine.
constexpr double kFlat = 0.25;
constexpr float kSharedNormals = 0.9f;

bool sideBySide(const GuidedBlock::Hit& a, const GuidedBlock::Hit& b) {
  const auto [x, y, z] = a.model.n;
  const Vec3 step = (b.query.hit->p_star - a.query.hit->p_star).raw();
  return b.gate > 0 && std::fabs(dot(Vec3{x, y, z}, step)) <= kFlat * length(step) &&
         dot3(b.model.n, x, y, z) >= kSharedNormals;
}

}  // namespace

void GuidedLighting::castShadows(GuidedBlock& block) const {
  const FrameLights& lights = lighting_.lights();
  const std::size_t distant_count = lights.distant.size(), near_count = lights.near_lights.size();
  if (options_.shadows == Shadows::off) return block.sight.assign(block.hits.size() * row(), kInSight);
  const bool at_rest = options_.shadows == Shadows::captured;
  auto& wanted = block.rays_wanted;
  wanted.clear();
  block.groups.clear(), block.alike.clear(), block.alike_end.clear();
  std::vector<Point<ObjectSpace>> origins(block.hits.size());
  for (std::size_t h = 0; h < block.hits.size(); ++h) {
    const GuidedBlock::Hit& hit = block.hits[h];
    if (!(hit.gate > 0)) continue;
    const LookUp& look_up = *hit.query.look_up;
    // Acquisition space is the object's at rest.
    origins[h] =
        at_rest ? Point<ObjectSpace>(look_up.p.raw()) + offset_ * Direction<ObjectSpace>::fromUnit(look_up.normal.raw())
                : hit.query.hit->p_star + offset_ * (look_up.acquisition_from_object.inverse() * look_up.normal);
    for (std::size_t k = 0; k < near_count; ++k) {
      const DirectionLanes l = lanesOf(block.near_direction, h * near_lanes_ + k);
      if (dot3(hit.model.n, *l.x, *l.y, *l.z) > 0)
        wanted.push_back({static_cast<std::uint32_t>(cluster_lanes_ + k), static_cast<std::uint32_t>(h),
                          static_cast<std::uint32_t>(h)});
    }
  }
  if (distant_count > 0) askTogether(block);
  block.sight.assign(block.hits.size() * row(), kNotAsked);
  block.told.assign((block.hits.size() + block.groups.size()) * cluster_lanes_, kNotAsked);
  // By light: rays of one packet run side by side.
  const std::size_t lists = cluster_lanes_ + near_lanes_;
  block.first_ray.assign(lists + 1, 0);
  for (const GuidedBlock::ShadowRay& ray : wanted) ++block.first_ray[ray.light + 1];
  for (std::size_t k = 0; k < lists; ++k) block.first_ray[k + 1] += block.first_ray[k];
  block.ray_order.resize(wanted.size());
  for (std::uint32_t i = 0; i < wanted.size(); ++i) block.ray_order[block.first_ray[wanted[i].light]++] = i;

  auto& [rays, far_distances, blocked] = block.rays;
  for (std::size_t begin = 0; begin < wanted.size(); begin += kRaysAtOnce) {
    const std::size_t end = std::min(wanted.size(), begin + kRaysAtOnce);
    rays.clear();
    far_distances.clear();
    for (std::size_t i = begin; i < end; ++i) {
      const auto [light, h, told] = wanted[block.ray_order[i]];
      const GuidedBlock::Hit& hit = block.hits[h];
      const auto& acquisition_from_object = hit.query.look_up->acquisition_from_object;
      Direction<ObjectSpace> direction;
      double far = std::numeric_limits<double>::infinity();
      if (light < cluster_lanes_) {
        direction = clusters_.direction[light];
      } else {
        const std::size_t near = light - cluster_lanes_;
        const DirectionLanes l = lanesOf(block.near_direction, h * near_lanes_ + near);
        direction = Direction<ObjectSpace>::fromUnit(Vec3{double{*l.x}, double{*l.y}, double{*l.z}});
        far = kShortOfLight * distance(lights.near_lights[near].position, hit.query.hit->p_star);
      }
      if (at_rest) direction = Direction<ObjectSpace>::fromUnit((acquisition_from_object * direction).raw());
      rays.push_back({origins[h], direction});
      far_distances.push_back(far);
    }
    blocked.assign(rays.size(), 0);
    occluders_.rays().occluded(rays, far_distances, 0, blocked, /*side_by_side=*/true);
    for (std::size_t i = begin; i < end; ++i) {
      const GuidedBlock::ShadowRay& ray = wanted[block.ray_order[i]];
      const LightSight sight = blocked[i - begin] ? kHidden : kInSight;
      if (ray.light < cluster_lanes_)
        block.told[ray.told * cluster_lanes_ + ray.light] = sight;
      else
        block.sight[ray.hit * row() + distant_lanes_ + (ray.light - cluster_lanes_)] = sight;
    }
  }
  block.shadow_rays += wanted.size();
  if (distant_count > 0) tellEachOther(block);
}

void GuidedLighting::askTogether(GuidedBlock& block) const {
  const std::size_t distant_count = lighting_.lights().distant.size();
  block.keys.resize(distant_lanes_);
  block.cluster_keys.resize(cluster_lanes_);
  for (std::size_t first = 0, end; first < block.hits.size(); first = end) {
    const GuidedBlock::Hit& hit = block.hits[first];
    end = first + 1;
    if (!(hit.gate > 0)) continue;
    while (end < block.hits.size() && end - first < kMostSharers && block.hits[end].query.cell == hit.query.cell &&
           sideBySide(hit, block.hits[end]))
      ++end;
    std::fill(block.keys.begin(), block.keys.end(), 0.f);
    for (std::size_t h = first; h < end; ++h)
      addBrightness(channels(std::as_const(block.answer), h * row()), distant_lanes_, block.keys.data());
    std::span<const float> keys = block.keys;
    if (clusters_.count() < distant_count) {
      for (std::size_t c = 0; c < clusters_.count(); ++c)
        block.cluster_keys[c] =
            std::accumulate(&block.keys[clusters_.first[c]], block.keys.data() + clusters_.first[c + 1], 0.f);
      keys = block.cluster_keys;
    }
    block.asked.choose(keys, clusters_, near_clusters_, hit.query.cell.quarter(), end - first,
                       static_cast<std::size_t>(options_.shadow_rays));
    for (const std::uint32_t light : block.asked.each)
      for (std::size_t h = first; h < end; ++h)
        block.rays_wanted.push_back({light, static_cast<std::uint32_t>(h), static_cast<std::uint32_t>(h)});
    for (const auto& [light, as] : block.asked.alike) block.alike.push_back({light, as});
    block.alike_end.push_back(block.alike.size());
    const auto told = static_cast<std::uint32_t>(block.hits.size() + block.groups.size());
    block.groups.push_back({static_cast<std::uint32_t>(first), static_cast<std::uint32_t>(end)});
    std::size_t asker = first;
    for (const std::uint32_t light : block.asked.once) {
      const auto next = [&] { return asker + 1 < end ? asker + 1 : first; };
      const auto faces = [&] {
        const std::array<float, 3> l = floats(clusters_.direction[light].raw());
        return dot3(block.hits[asker].model.n, l[0], l[1], l[2]) > 0;
      };
      for (std::size_t tried = first; tried < end && !faces(); ++tried) asker = next();
      block.rays_wanted.push_back({light, static_cast<std::uint32_t>(asker), told});
      asker = next();
    }
  }
}

void GuidedLighting::tellEachOther(GuidedBlock& block) const {
  const std::size_t distant_count = lighting_.lights().distant.size(), hit_count = block.hits.size(),
                    count = cluster_lanes_;
  const auto rowOf = [&](std::size_t of) { return block.told.data() + of * count; };
  const auto take = [](std::int8_t* __restrict to, const std::int8_t* __restrict from, std::size_t size) {
    static_assert(kNotAsked == -1 && kHidden == 0 && kInSight == 1);
    for (std::size_t k = 0; k < size; ++k) {
      const int unasked = to[k] >> 7;  // all bits or none: a choice that compilers make wide
      to[k] = static_cast<std::int8_t>((unasked & from[k]) | (~unasked & to[k]));
    }
  };
  const auto cellOf = [&](std::size_t group) { return block.hits[block.groups[group].first].query.cell; };
  // Hits of a block lie within kCellsAlong cells of each other.
  const auto place = [](const ShadowCell& cell) {
    return static_cast<std::size_t>(cell.y & (kCellsAlong - 1)) * kCellsAlong + (cell.x & (kCellsAlong - 1));
  };
  std::array<std::uint32_t, std::size_t{kCellsAlong} * kCellsAlong> first_group;
  first_group.fill(static_cast<std::uint32_t>(block.groups.size()));
  for (std::size_t g = block.groups.size(); g-- > 0;) {
    for (std::size_t h = block.groups[g].first; h < block.groups[g].second; ++h)
      for (std::size_t i = g > 0 ? block.alike_end[g - 1] : 0; i < block.alike_end[g]; ++i)
        rowOf(h)[block.alike[i].light] = rowOf(h)[block.alike[i].as];
    first_group[place(cellOf(g))] = static_cast<std::uint32_t>(g);
    take(rowOf(hit_count + g), rowOf(block.groups[g].first), count);
  }
  std::size_t captured_count = 0;
  for (const AcquiredLights& list : lighting_.lists())
    captured_count = std::max(captured_count, static_cast<std::size_t>(list.count()));
  std::vector<std::int8_t> told(count), filled;
  for (std::size_t g = 0; g < block.groups.size(); ++g) {
    const auto [first, end] = block.groups[g];
    std::copy_n(rowOf(hit_count + g), count, told.begin());
    std::array<bool, 4> asked{};
    for (const ShadowCell& cell : cellOf(g).about())
      for (std::size_t other = first_group[place(cell)];
           !asked[cell.quarter()] && other < block.groups.size() && cellOf(other) == cell; ++other) {
        const auto [begin_there, end_there] = block.groups[other];
        if (!sideBySide(block.hits[first], block.hits[begin_there])) continue;
        take(told.data(), rowOf(hit_count + other), count);
        asked[cell.quarter()] = end_there - begin_there > 1;
      }
    // What nobody asked after is as the cluster beside it, in the order of directions, where that is nearer than
    // captured lights are.
    filled = told;
    if (clusters_.count() > captured_count) {
      take(filled.data() + 1, told.data(), count - 1);
      take(filled.data(), told.data() + 1, count - 1);
    }
    for (std::size_t h = first; h < end; ++h) {
      take(rowOf(h), filled.data(), count);
      std::int8_t* const sight = block.sight.data() + h * row();
      if (clusters_.count() == distant_count)
        std::copy_n(rowOf(h), distant_count, sight);
      else
        for (std::size_t c = 0; c < clusters_.count(); ++c)
          std::fill(sight + clusters_.first[c], sight + clusters_.first[c + 1], rowOf(h)[c]);
    }
  }
}

}  // namespace srf
