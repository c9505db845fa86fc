// `srf check`: whether silhouettes and poses belong together, and what would make them.
#pragma once

#include <optional>
#include <vector>

#include "acquire/capture_check.h"
#include "acquire/visual_hull.h"

namespace srf {

/// The hull with which the views agree; nothing where they do not. `views`: masks and cameras of the views `which` of
/// the capture; poses that can be mended are, there and in the report. Rows "silhouettes agree".
std::optional<VisualHull> checkAgreement(const Capture& capture, std::vector<SilhouetteView>& views,
                                         const std::vector<std::size_t>& which, CheckReport& report);

}  // namespace srf
