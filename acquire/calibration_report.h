// What a calibration with a board found, as JSON and as pictures.
#pragma once

#include "acquire/camera_calibration.h"
#include "base/json.h"

namespace srf {

/// Every figure of the calibration: lenses, poses and the turntable with their deviations (degrees, pixels, units), the
/// residuals of each photograph. `doc/calibration.md` explains the keys.
Json calibrationJson(const BoardCalibrationInput& input, const BoardCalibration& calibration, const std::string& units);

/// A photograph with the corners that were found (green circles), where the model puts them (red crosses) and the error
/// between them drawn `exaggeration` times as long (yellow). Photographs over 1600 pixels are drawn smaller.
Image8 residualPicture(const Image8& grey, const BoardSighting& sighting, const SightingResidual& residual,
                       double exaggeration);
/// The exaggeration that makes the calibration's rms 12 pixels long, a round number.
double residualExaggeration(const BoardCalibration& calibration);

}  // namespace srf
