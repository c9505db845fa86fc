// Frames of many hits at once: plain loops over arrays, which compilers make wide. The same operations in the same
// order as the forms for one hit, so the same bits, where they say that they hold; elsewhere that form is to be asked.
#pragma once

#include <cstddef>

#include "model/local_frame.h"

namespace srf {

inline constexpr std::size_t kFrameLanes = 64;  ///< hits at once
using FrameVector = double[3][kFrameLanes];     ///< by coordinate and hit

/// What hits of triangles blend: of each of three points its weight, its rest tangents and its carried tangents.
struct BlendedFrames {
  std::size_t count;
  double weight[3][kFrameLanes];
  FrameVector rest_u[3], rest_v[3], u[3], v[3];
  FrameVector reference;  ///< u0 of the point whose phase counts
  // Results: R0's columns and the carried tangents of that pair.
  FrameVector r_u, r_v, r_n, t_u, t_v;
  bool holds[kFrameLanes];
};
/// As DeformedModel::blendFrames of triangles: turns in-plane phases that differ from the reference's by more than
/// `phase_cosine` tells; holds where the squared sine between the blended rest tangents is more than `least_squared`.
/// Unit vectors are off by some 1e-16 over that sine.
void blendFrames(BlendedFrames& frames, double phase_cosine, double least_squared);

/// As lookUp with FrameMode::bisector: L = R0 (u-bar v-bar sigma n-bar)^T; the same bits.
struct FramesToLookUp {
  std::size_t count;
  FrameVector r_u, r_v, r_n;  ///< R0's columns
  FrameVector t_u, t_v;       ///< carried tangents
  double handedness[kFrameLanes];
  FrameVector l[3];  ///< result: rows of L
  bool holds[kFrameLanes];
};
void lookUpFrames(FramesToLookUp& frames);

}  // namespace srf
