// Unstructured lumigraph weights (M12, M13): the k sources of least penalty, with weights that are 1 at a source of
// penalty 0 and fall to 0 where a source leaves the set, so that nothing pops. Sources are views or acquired lights.
#pragma once

#include <algorithm>
#include <cstdint>
#include <vector>

namespace srf {

inline constexpr double kLeastPenalty = 1e-6;  ///< radians: smaller ones count as equal, which keeps 1/P finite
inline constexpr double kPenaltyCap = 1e4;     ///< beyond every usable penalty; the threshold where no (k+1)-th exists
inline constexpr double kResolutionPenalty = 0.1;  ///< radians for a view twice as far away as the desired eye

struct Penalised {
  double penalty = 0;
  std::uint32_t source = 0;
  /// By penalty; ties by index, so that the order of the input never matters.
  friend bool operator<(const Penalised& a, const Penalised& b) {
    return a.penalty != b.penalty ? a.penalty < b.penalty : a.source < b.source;
  }
};
struct Weighted {
  std::uint32_t source = 0;
  double weight = 0;
};

/// Share of the resolution penalty: 0 where the source is as near as the desired eye or nearer. Distances in units.
inline double resolutionPenalty(double source_distance, double desired_distance) {
  if (!(source_distance > desired_distance && desired_distance > 0)) return 0;
  return kResolutionPenalty * (source_distance - desired_distance) / desired_distance;
}

/// P of a view: angle (radians) and resolution, divided by `usable` in [0, 1] (visibility, coverage, field of view,
/// foreshortening). Continuous down to `usable` = 0, where it is infinite, also at a captured view.
inline double viewPenalty(double angle, double resolution, double usable) {
  // The floor comes before the division: a captured view that fades out of sight fades, it does not vanish at once.
  return std::max(angle + resolution, kLeastPenalty) / usable;
}

/// w = 1/max(P, least) - 1/max(t, least), t = min(P of the (k+1)-th, cap), normalised to sum 1; sources of weight 0 are
/// left out. Where every weight is 0 the sources that tie at t share alike. `candidates` must hold the k+1 of least
/// penalty and all that tie with them; it is reordered. Penalties at or beyond the cap, or NaN, are unusable; no usable
/// one gives no weights.
void lumigraphWeights(std::vector<Penalised>& candidates, int k, std::vector<Weighted>& weights);

}  // namespace srf
