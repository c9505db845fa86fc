// Buehler et al., Unstructured Lumigraph Rendering (2001); the 1/P form reproduces a captured view.
#include "field/lumigraph_weights.h"

#include <algorithm>

namespace srf {

namespace {

/// Moves the `count` least to the front, in order. Callers mostly have them there already: then one look at each is
/// all.
void leastFirst(std::vector<Penalised>& candidates, std::size_t count) {
  for (std::size_t i = 1; i < candidates.size(); ++i) {
    std::size_t at = i;
    if (at >= count) {
      if (!(candidates[at] < candidates[count - 1])) continue;
      std::swap(candidates[at], candidates[count - 1]);
      at = count - 1;
    }
    for (; at > 0 && candidates[at] < candidates[at - 1]; --at) std::swap(candidates[at], candidates[at - 1]);
  }
}

}  // namespace

void lumigraphWeights(std::vector<Penalised>& candidates, int k, std::vector<Weighted>& weights) {
  weights.clear();
  std::erase_if(candidates, [](const Penalised& c) { return !(c.penalty < kPenaltyCap); });
  const std::size_t nearest = std::min<std::size_t>(candidates.size(), k);
  const std::size_t sorted = std::min<std::size_t>(candidates.size(), k + std::size_t{1});
  leastFirst(candidates, sorted);

  // With k or fewer usable sources the threshold lies far beyond them: nothing jumps when another one appears, and a
  // lone source gets weight 1.
  const double t = candidates.size() > nearest ? std::max(candidates[nearest].penalty, kLeastPenalty) : kPenaltyCap;
  double sum = 0;
  for (std::size_t i = 0; i < nearest; ++i) {
    const double weight = 1 / std::max(candidates[i].penalty, kLeastPenalty) - 1 / t;
    if (!(weight > 0)) break;  // sorted: the rest ties at the threshold
    weights.push_back({candidates[i].source, weight});
    sum += weight;
  }
  if (weights.empty())
    for (const Penalised& c : candidates)
      if (c.penalty <= t) {
        weights.push_back({c.source, 1});
        sum += 1;
      }
  for (Weighted& w : weights) w.weight /= sum;
}

}  // namespace srf
