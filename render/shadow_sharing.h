// Which hit sends a shadow ray to which light, where hits that lie side by side tell each other what their rays found.
// Of many lights most are weak, and neighbours see them alike. Hits of a cell of the picture, a pixel or a few, form a
// group: its brightest lights each hit asks after for itself; of the others the groups of 2 x 2 cells ask after a
// quarter each, light by light one of the group's hits. A group takes what it did not ask after from the cells beside
// it, each light from another distance, so that no edges of cells show.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "render/light_clusters.h"

namespace srf {

inline constexpr std::size_t kMostSharers = 16;  ///< hits of a group

/// More distant lights than the first for each ray of a hit are asked after in clusters (light_clusters.h), as many as
/// the second says: about half of them stand below the horizon, and hits side by side ask after some 6 a ray.
inline constexpr std::size_t kLightsOfARay = 32, kClustersOfARay = 16;

/// Lights this near to each other, radians, throw one shadow: of one of them the other tells a hit more than its
/// neighbours do.
inline constexpr double kOneShadow = 0.045;
/// A shadow's outline shows where more than this of all that hits are given is lost in it: each hit asks.
inline constexpr float kStrongLight = 0.08f;

/// A cell of the picture, by its place.
struct ShadowCell {
  std::int32_t x = 0, y = 0;
  bool operator==(const ShadowCell&) const = default;
  /// The lights that it asks after are those whose number is this modulo 4.
  unsigned quarter() const { return (static_cast<unsigned>(x) & 1u) + 2 * (static_cast<unsigned>(y) & 1u); }
  /// The cells about it that ask after other quarters.
  std::array<ShadowCell, 8> about() const {
    return {{{x + 1, y},
             {x, y + 1},
             {x + 1, y + 1},
             {x - 1, y},
             {x, y - 1},
             {x - 1, y + 1},
             {x + 1, y - 1},
             {x - 1, y - 1}}};
  }
};

/// The lights, or clusters of them, that a group asks after, and memory of choosing them. Positions rise.
class SharedShadowRays {
 public:
  struct Alike {
    std::uint32_t light, as;
  };
  std::vector<std::uint32_t> each;  ///< every hit for itself
  std::vector<std::uint32_t> once;  ///< one hit for all
  std::vector<Alike> alike;         ///< hidden from a hit where the one of `each` is that they stand beside

  /// Chooses for a group of `sharers` hits with `most` rays each in the mean. `keys`: of each light, what it gives the
  /// hits together; padded for the kernels. `near`: those within kOneShadow. A quarter of the rays, rounded up, or
  /// up to three where the light is strong, goes to lights that each hit asks after, half of the others to those of the
  /// group's quarter, and what these leave to more that each asks after. Rays that groups share lie farther apart and
  /// take longer: the other half is not sent. A hit alone, or hits under at most `most` lights, ask after each for
  /// themselves.
  void choose(std::span<const float> keys, const LightClusters& lights, const NearClusters& near, unsigned quarter,
              std::size_t sharers, std::size_t most);

 private:
  /// Fills `each` and `as`.
  void chooseEach(std::span<const float> keys, const LightClusters& lights, const NearClusters& near, std::size_t own);

  std::vector<std::uint32_t> as_;                       ///< of each light: the one of `each` that it is, or is as
  std::vector<float> rest_;                             ///< keys of what may be asked after once
  std::int32_t least_of_each_ = 0, least_of_once_ = 0;  ///< largestKeys' `about`, from one group to the next
};

}  // namespace srf
