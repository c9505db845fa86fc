// The lights that views were photographed under, as cameras at infinity: for a direction, the k nearest and their
// weights (M13). No visibility enters: shadows are in the photographs.
#pragma once

#include <array>
#include <optional>
#include <span>
#include <vector>

#include "field/capture.h"
#include "field/lumigraph_weights.h"
#include "render/light_kernels.h"

namespace srf {

/// One list of lights (StoredView.lights, shared by every view with an equal list) with an exact index over directions:
/// the cells of a cube, each with the lights that can be among the k + 1 nearest of a direction in the cell, seen from
/// any point of the object.
class AcquiredLights {
 public:
  /// `object`: box of every p that will be asked about.
  AcquiredLights(const std::vector<LightId>& ids, const std::vector<CaptureLight>& all,
                 const Box<AcquisitionSpace>& object, int k);

  const std::vector<LightId>& ids() const { return ids_; }
  int count() const { return static_cast<int>(lights_.size()); }
  /// All lie at infinity: what they answer depends on the direction alone.
  bool distant() const { return distant_; }
  /// Has lights of known direction: can stand for other lights.
  bool relightable() const { return !usable_.empty(); }
  std::optional<std::uint32_t> find(LightId light) const;

  /// The k + 1 nearest lights to `direction` at p, and where all of these tie the others that tie with them; nearest
  /// first, penalties in radians, sources are positions in ids().
  void ranked(const Direction<AcquisitionSpace>& direction, const Point<AcquisitionSpace>& p,
              std::vector<Penalised>& order) const;
  /// Weights of the k nearest lights to `direction` at p, sum 1; sources are positions in ids(). `scratch` is only
  /// memory.
  void nearest(const Direction<AcquisitionSpace>& direction, const Point<AcquisitionSpace>& p,
               std::vector<Penalised>& scratch, std::vector<Weighted>& weights) const;
  /// What nearestWeights needs to say the same of many directions at once; none where it cannot: for lights near the
  /// object, for as many lights as k or fewer, or a k beyond kMostNearest.
  std::optional<LightCells> cells() const;
  int k() const { return k_; }
  /// 1 / irradiance of each light of a distant list, r g b.
  const std::vector<std::array<float, 3>>& inverseIrradiances() const { return inverse_float_; }
  /// Positions in ids() of the lights of known direction.
  const std::vector<std::uint32_t>& usable() const { return usable_; }
  /// From p to light i, one of usable().
  Direction<AcquisitionSpace> directionOf(std::uint32_t i, const Point<AcquisitionSpace>& p) const {
    return lights_[i].directionFrom(p);
  }
  /// Units from p to light i, infinite for a distant one.
  double distanceTo(std::uint32_t i, const Point<AcquisitionSpace>& p) const;
  /// The square of the chord from `direction` at p to the nearest light of known direction (chordAngles). Where there
  /// is one.
  double chord2ToNearest(const Direction<AcquisitionSpace>& direction, const Point<AcquisitionSpace>& p) const;
  /// 1 / irradiance of light i at p per channel; 0 in a channel where the light is dark.
  Vec3 inverseIrradiance(std::uint32_t i, const Point<AcquisitionSpace>& p) const;

 private:
  struct Cell {
    std::size_t begin, end;  ///< in candidates_
  };
  Cell cell(const Vec3& direction) const;
  /// To each candidate of a cell, from `direction` at p. In memory of the thread, until the next call.
  std::span<const double> chord2OfCell(const Cell& cell, const Direction<AcquisitionSpace>& direction,
                                       const Point<AcquisitionSpace>& p) const;

  std::vector<LightId> ids_;
  std::vector<CaptureLight> lights_;
  std::vector<std::uint32_t> usable_;  ///< positions of the lights of known direction
  std::vector<Vec3> direction_;        ///< of distant lights
  std::vector<Vec3> inverse_;          ///< of distant lights
  bool distant_ = true;
  int k_;
  int resolution_ = 1;                ///< cells along the edge of a cube face
  std::vector<std::uint32_t> begin_;  ///< of each cell in candidates_, and the end
  std::vector<std::uint32_t> candidates_;
  std::array<std::vector<double>, 3> candidate_direction_;  ///< of distant lights
  std::array<std::vector<float>, 3> candidate_float_;       ///< the same
  std::vector<std::array<float, 3>> inverse_float_;
};

}  // namespace srf
