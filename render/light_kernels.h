// What stands for the lights of many hits: kernels of light_weights over plain arrays, one lane a hit. Arrays are
// padded to whole vectors (kVectorLanes): kernels read and write up to there. The same bits in every instruction set.
#pragma once

#include <cstddef>
#include <cstdint>

#include "base/vec.h"
#include "render/vector_lanes.h"

namespace srf {

/// AcquiredLights' cells of directions: a cube's faces, each resolution x resolution.
struct LightCells {
  int resolution;
  const std::uint32_t* begin;       ///< of each cell in the candidates, and the end
  const std::uint32_t* candidates;  ///< lights that can be among the k + 1 nearest of a direction in the cell
  const float *x, *y, *z;           ///< of each candidate: its direction
};
inline constexpr int kMostNearest = 8;  ///< the largest k that nearestWeights knows

/// cell[i] = that of the unit vector (x, y, z)[i]. A direction within some 1e-7 of a border may be given to either
/// side; the lists of candidates have room for that.
void lightCells(const float* x, const float* y, const float* z, std::size_t count, int resolution, std::int32_t* cell);

/// Lit points: p* and the rows of L.
struct LitLanes {
  const double* p_star[3];
  const double* l[9];
};
/// Of a point light at `position` what FrameLighting knows of it at hits: its direction in acquisition space as floats,
/// and the reciprocal of its squared distance, which is at least `least_distance`. False: some lengths need more care,
/// those whose squares lie outside kOrdinarySquares. The same bits as the scalar form.
bool towardsLight(const LitLanes& lit, const Vec3& position, double least_distance, std::size_t count, float* x,
                  float* y, float* z, float* falloff);
inline constexpr double kOrdinarySquares[2] = {1e-250, 1e250};

/// The weights of the k nearest lights (AcquiredLights::nearest) of each unit vector, each list of which has more than
/// k candidates: weight[j * stride + i] of light[j * stride + i], j < k; all 0 where the k + 1 nearest tie. Off by at
/// most 4e-6 where no two lights lie within 0.1 radians of each other.
void nearestWeights(const LightCells& cells, const float* x, const float* y, const float* z, const std::int32_t* cell,
                    std::size_t count, int k, std::size_t stride, float* weight, std::uint32_t* light);

/// Orientations by their matrices, m[3 * row + column][i].
struct OrientationLanes {
  const float* m[9];
};
/// Where they lie in an OrientationGrid of `half_cells`: code[i] has the quaternion's largest component (w, x, y, z) in
/// bits 4 and 5, in bit 3 whether m is reflected, in bits 0 to 2 which coordinates are negative; cell[j][i] is the
/// distance of coordinate j's cell from the cube's middle, fraction[j][i] the way through it, outwards.
struct OrientationCells {
  std::int32_t* code;
  std::int32_t* cell[3];
  float* fraction[3];
};
/// Off by at most 4e-7 half_cells in a fraction.
void orientationCells(const OrientationLanes& orientations, std::size_t count, std::int32_t half_cells,
                      const OrientationCells& out);

}  // namespace srf
