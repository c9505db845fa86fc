// `srf check`: every photograph, read once.
#pragma once

#include <string>
#include <vector>

#include "acquire/capture_check.h"
#include "acquire/photometric_check.h"

namespace srf {

struct PhotoFacts {
  std::string fault;  // empty: it can be used
  std::size_t not_finite = 0, negative = 0, clipped = 0, pixels = 0;
  double ceiling = 0;     // above 0: a value that many pixels stop at, as those of a full sensor do
  double at_ceiling = 0;  // share of the lit pixels that stand there
  bool black = false;
};

struct AllPhotos {
  std::vector<std::vector<PhotoFacts>> facts;  // [view][photograph]
  std::vector<std::vector<SmallPhoto>> small;
};

/// Reads each photograph once, whole, with no more open at a time than fit into the memory; rows "photographs" and
/// "pixel values". One that cannot be used has a fault and no small copy.
AllPhotos checkPhotos(const Capture& capture, const CheckOptions& options, CheckReport& report, Reporter& reporter);

}  // namespace srf
