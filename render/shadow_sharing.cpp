#include "render/shadow_sharing.h"

#include <algorithm>
#include <array>
#include <numeric>

#include "render/guided_kernels.h"

namespace srf {
namespace {

constexpr std::uint32_t kNone = 0xffffffff;

void largest(std::span<const float> of, std::size_t count, std::int32_t& about, std::vector<std::uint32_t>& found) {
  found.resize(of.size());
  found.resize(largestKeys(of.data(), of.size(), count, found.data(), about));
}

}  // namespace

void SharedShadowRays::chooseEach(std::span<const float> keys, const LightClusters& lights, const NearClusters& near,
                                  std::size_t own) {
  largest(keys, own, least_of_each_, each);
  as_.assign(keys.size(), kNone);
  const auto closeness = [&](std::uint32_t a, std::uint32_t b) {
    return dot(lights.direction[a].raw(), lights.direction[b].raw());
  };
  for (const std::uint32_t light : each)
    for (const std::uint32_t other : near.of(light))
      if (as_[other] == kNone || closeness(light, other) > closeness(as_[other], other)) as_[other] = light;
  for (const std::uint32_t light : each) as_[light] = light;
}

void SharedShadowRays::choose(std::span<const float> keys, const LightClusters& lights, const NearClusters& near,
                              unsigned quarter, std::size_t sharers, std::size_t most) {
  once.clear(), alike.clear();
  // Lane by lane, which compilers make wide.
  constexpr std::size_t kLanes = 16;
  std::array<float, kLanes> lane_sum{};
  std::array<std::uint32_t, kLanes> lane_lit{};
  for (std::size_t i = 0; i < keys.size(); i += kLanes)
    for (std::size_t lane = 0; lane < kLanes; ++lane)
      lane_sum[lane] += keys[i + lane], lane_lit[lane] += keys[i + lane] > 0;
  const auto lit = std::accumulate(lane_lit.begin(), lane_lit.end(), std::size_t{0});
  if (lit <= most) return largest(keys, most, least_of_each_, each);

  std::size_t own = most;
  if (sharers > 1) {
    const float strong = kStrongLight * std::accumulate(lane_sum.begin(), lane_sum.end(), 0.f);
    const std::size_t quarter_of_all = (most + 3) / 4;
    std::size_t strong_count = 0;
    for (const float key : keys) strong_count += key > strong;
    for (const std::uint32_t light : near.crowded) {
      if (!(keys[light] > 0) || keys[light] > strong) continue;
      float shadow = keys[light];
      for (const std::uint32_t other : near.of(light)) shadow += keys[other];
      strong_count += shadow > strong;
    }
    own = std::max(quarter_of_all, std::min(strong_count, most - quarter_of_all));
    chooseEach(keys, lights, near, own);
    rest_.assign(keys.size(), 0);
    for (std::size_t k = quarter; k < keys.size(); k += 4)
      if (as_[k] == kNone) rest_[k] = keys[k];
    largest(rest_, sharers * ((most - own + 1) / 2), least_of_once_, once);
    const std::size_t left = (most - own + 1) / 2 - (once.size() + sharers - 1) / sharers;
    own += left;
    if (left > 0) {
      chooseEach(keys, lights, near, own);
      std::erase_if(once, [&](std::uint32_t light) { return as_[light] != kNone; });
    }
  } else {
    chooseEach(keys, lights, near, own);
  }
  for (const std::uint32_t light : each)
    for (const std::uint32_t other : near.of(light))
      if (as_[other] == light) alike.push_back({other, light});
}

}  // namespace srf
