// Which places of pictures a mesh covers, for many pictures in one pass over its triangles.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "base/camera.h"
#include "base/mesh.h"

namespace srf {

/// A picture looked at in the centres of every `step`-th pixel, from step / 2 on, along both sides.
struct SampledPicture {
  Camera<AcquisitionSpace> camera;
  int step = 1;               ///< pixels, 1 or more
  int columns = 0, rows = 0;  ///< samples, at most 65535 each

  /// About `samples` along the longer side.
  static SampledPicture of(const Camera<AcquisitionSpace>& camera, int samples);
  /// Pixel of a column or row.
  int pixel(int sample) const { return step / 2 + sample * step; }
};

/// For each picture a byte per sample, row by row: 1 where a triangle covers it, seen from either side. Triangles with
/// a corner that the camera does not see cover nothing. Quick where triangles that follow each other lie close
/// together.
std::vector<std::vector<std::uint8_t>> coveredSamples(const AcquisitionMesh& mesh,
                                                      std::span<const SampledPicture> pictures);

}  // namespace srf
