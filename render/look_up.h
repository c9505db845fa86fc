// L: what a hit in the deformed model sees, taken back to acquisition space (Eq. 2 to 4, 10; M11).
#pragma once

#include "model/deformed_model.h"

namespace srf {

struct LookUp {
  Point<AcquisitionSpace> p;                                          ///< = p0 (Eq. 3)
  Orthogonal<AcquisitionSpace, ObjectSpace> acquisition_from_object;  ///< L (Eq. 10); det -1 where Psi mirrors
  Direction<AcquisitionSpace> normal;                                 ///< n0
  bool collapsed = false;                                             ///< the deformed tangents gave no frame
};

/// L = R0 (u-bar v-bar sigma n-bar)^T.
LookUp lookUp(const SurfaceHit& hit, FrameMode mode);
/// The same of the hits named, many at a time; the same bits.
void lookUp(std::span<const SurfaceHit> hits, std::span<const std::size_t> which, FrameMode mode,
            std::span<LookUp> look_ups);

}  // namespace srf
