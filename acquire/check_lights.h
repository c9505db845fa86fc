// `srf check`: views, lights, and which of them have a photograph.
#pragma once

#include "acquire/capture_check.h"

namespace srf {

/// Missing and double photographs of a view under a light: rows "views x lights".
void checkCells(const Capture& capture, CheckReport& report);
/// The light table, and how views and lights lie about the object: rows "lights" and "coverage by ..".
void checkLightsAndCoverage(const Capture& capture, CheckReport& report);

/// The middle of the bounds, or else the point nearest to all optical axes.
Point<AcquisitionSpace> objectCentre(const Capture& capture);

}  // namespace srf
