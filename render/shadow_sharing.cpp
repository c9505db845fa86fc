#include "render/shadow_sharing.h"

#include <algorithm>
#include <numeric>

#include "render/guided_kernels.h"

namespace srf {
void SharedShadowRays::choose(std::span<const float> keys, unsigned quarter, std::size_t sharers, std::size_t most) {
  const auto largest = [&](std::span<const float> of, std::size_t count, std::int32_t& about,
                           std::vector<std::uint32_t>& found) {
    found.resize(of.size());
    found.resize(largestKeys(of.data(), of.size(), count, found.data(), about));
  };
  std::size_t own = most;
  brightest.clear();
  const auto lit = static_cast<std::size_t>(std::count_if(keys.begin(), keys.end(), [](float key) { return key > 0; }));
  if (sharers > 1 && lit > most) {
    const float strong = kStrongLight * std::accumulate(keys.begin(), keys.end(), 0.f);
    const auto strong_count =
        static_cast<std::size_t>(std::count_if(keys.begin(), keys.end(), [&](float key) { return key > strong; }));
    const std::size_t least = (most + 3) / 4, for_each = std::max(least, std::min(strong_count, most));
    of_quarter.assign(keys.size(), 0);
    for (std::size_t k = quarter; k < keys.size(); k += 4) of_quarter[k] = keys[k];
    largest(of_quarter, sharers * (most - for_each), least_of_quarter, brightest);
    own -= (brightest.size() + sharers - 1) / sharers;
  }
  largest(keys, own, least_of_each, each);
  once.clear();
  std::set_difference(brightest.begin(), brightest.end(), each.begin(), each.end(), std::back_inserter(once));
}

}  // namespace srf
