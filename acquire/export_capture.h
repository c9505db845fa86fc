// A capture in the files of other programs and data sets (`srf export`).
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "base/reporter.h"
#include "field/capture.h"

namespace srf {

/// "transforms", "nrhints", "colmap", "colmap-binary", "middlebury", "projections", "metashape", "lp", "diligent",
/// "diligent-mv", "openillumination".
const std::vector<std::string>& exportFormats();
/// Writes into `folder`. Photographs and masks stay where they are where the format can name them, else they are put
/// there as hard links (copies where the disk allows none). What the format cannot hold is told by warnings; throws
/// bad_input where it cannot hold the capture at all (a lens, several views). Nothing is re-centred or re-scaled.
void exportCapture(const std::string& format, const Capture& capture, const std::filesystem::path& folder,
                   Reporter& reporter);

}  // namespace srf
