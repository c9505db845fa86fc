// Masks of photographs on their way to a capture of developed pictures.
#pragma once

#include <filesystem>

#include "base/reporter.h"
#include "field/capture.h"

namespace srf {

/// Gives the views of `capture` the masks that belong to the photographs of `shot` (the same views in the same order,
/// with the photographs and lenses of the shoot): those of the folder `masks` by the name of a photograph or of the
/// view, or where it is empty those beside the photographs as `srf acquire` finds them. Where a view's lens is another
/// one in `capture`, its pictures were undistorted: so is its mask, written to masks/VIEW.png in the capture's folder,
/// with the object white. Throws bad_input for a mask of another size than its photograph, and where `masks` holds
/// none.
void carryMasks(Capture shot, const std::filesystem::path& masks, Capture& capture, Reporter& reporter);

}  // namespace srf
