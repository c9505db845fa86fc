// Pictures of masks, for people.
#pragma once

#include <filesystem>
#include <vector>

#include "acquire/visual_hull.h"
#include "field/capture.h"

namespace srf {

/// Writes VIEW.png for every view and contact_sheet.png of them all into `folder`: the photograph, dark where the mask
/// says background, the mask's outline in green, and, where a hull is given, the outline of its projection in orange.
/// At most 640 pixels a side.
void writeMaskPictures(const Capture& capture, const std::vector<SilhouetteView>& views, const AcquisitionMesh* hull,
                       const std::filesystem::path& folder, Reporter& reporter);

}  // namespace srf
