// `srf check`: what the photographs' shading tells of the light table, of turned pictures and of the exposure.
#pragma once

#include "acquire/capture_check.h"
#include "acquire/photometric_check.h"

namespace srf {

/// Rows "light table", and lights mended.
void reportLightTable(const Capture& capture, const PhotometricReport& found, CheckReport& report);
/// Rows "photographs upright"; those that are not are left out of what is mended.
void reportTurned(const Capture& capture, const PhotometricReport& found, CheckReport& report);
/// Rows "exposure".
void reportExposure(const Capture& capture, const PhotometricReport& found, CheckReport& report);

}  // namespace srf
