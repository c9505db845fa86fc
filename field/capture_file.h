// transforms.json, as nerfstudio and instant-ngp read it, with the keys that doc/field_format.md adds.
#pragma once

#include <filesystem>

#include "field/capture.h"

namespace srf {

/// Reads `folder`/transforms.json (or the file itself). Validates everything that the file alone can show: keys, types,
/// rigid poses, unit-length-able directions, lights that frames name, frames that no light lacks. Does not open images.
Capture readCapture(const std::filesystem::path& folder_or_file);
/// Throws bad_input naming the place of a photograph or mask of the view that is not there.
void requireFiles(const CaptureView& view);
/// Writes `folder`/transforms.json; photo and mask paths are written relative to the folder.
void writeCapture(const std::filesystem::path& folder, const Capture& capture);

}  // namespace srf
