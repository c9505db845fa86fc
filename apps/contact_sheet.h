// Display pictures of an animation: one exposure for all frames, and a sheet of small pictures.
#pragma once

#include <filesystem>
#include <vector>

#include "base/image.h"

namespace srf {

/// The exposure that brings the 99th percentile of what the object shows in these frames to 0.9.
double displayExposure(const std::vector<ImageF>& frames);

/// The frames row by row, each reduced to fit `tile` x `tile` pixels by averaging linear light.
Image8 contactSheet(const std::vector<ImageF>& frames, int columns, int tile, double exposure);

/// The colour of a premultiplied picture over black: the first three channels.
ImageF overBlack(const ImageF& rgba);

}  // namespace srf
