// Captures that are described by other programs' files: Middlebury's _par.txt, COLMAP's text and binary models.
#pragma once

#include <filesystem>

#include "base/reporter.h"
#include "field/capture.h"

namespace srf {

/// The capture in a folder: transforms.json, else a Middlebury *_par.txt, else a COLMAP model (cameras/images .bin or
/// .txt in the folder, sparse/ or sparse/0). Throws bad_input that lists what was looked for.
Capture openCapture(const std::filesystem::path& folder, Reporter& reporter);

Capture readMiddlebury(const std::filesystem::path& par_file, Reporter& reporter);
Capture readColmap(const std::filesystem::path& model_folder, const std::filesystem::path& image_folder,
                   Reporter& reporter);

}  // namespace srf
