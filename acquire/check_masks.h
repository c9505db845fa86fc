// `srf check`: masks, and silhouettes found without them.
#pragma once

#include <vector>

#include "acquire/capture_check.h"
#include "acquire/check_photographs.h"

namespace srf {

/// What is kept of a silhouette: itself in small, and how many tiles of a field's block it touches.
struct KeptMask {
  Image8 mask;
  std::size_t tiles = 0;
  bool inverted = false;  // `mask` is the file's with black and white exchanged
  bool empty() const { return mask.empty(); }
};

/// By how much masks are made smaller: at least 256 pixels along the longer side remain, and six bytes a pixel of all
/// views (the mask and the distances that carving makes of it) take no more than a quarter of the memory.
int maskFactor(const Capture& capture, std::size_t memory);

/// Every mask file: rows "masks", and what is kept of it.
void checkMasks(const Capture& capture, int factor, std::vector<KeptMask>& kept, CheckReport& report);
/// Silhouettes of the views without a mask file, whose photographs can all be read: rows "silhouettes".
void segmentOthers(const Capture& capture, const AllPhotos& photos, int factor, std::vector<KeptMask>& kept,
                   CheckReport& report);

}  // namespace srf
