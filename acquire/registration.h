// The photographs of one view become its reflectance store (M2, M6).
#pragma once

#include <filesystem>

#include "base/reporter.h"
#include "field/reflectance_store.h"
#include "field/srf_folder.h"

namespace srf {

struct RegistrationOptions {
  StoreCoding coding;
  std::size_t memory_bytes = std::size_t{1}
                             << 28;  ///< for this view; photographs are read again where it does not suffice
};

/// What registering a view holds at least, at the size of its camera: one photograph, and a row of tiles of all.
std::size_t leastRegistrationMemory(const CaptureView& view);

/// Throws bad_input where a photograph of the view is missing or not of the camera's size. Reads headers alone.
void checkPhotographs(const Capture& capture, ViewId view);

/// Writes views/<number>-<name>-<identity>.blk in the SRF's folder, or takes the one that is there: the identity is a
/// hash of all that the store depends on (photographs by path, size and time, camera, mask, options), so a finished
/// file is a right one. `mask`: coverage at the camera's size. The stage advances by one for each photograph under a
/// light. Counts pixels.nan (covered no more), pixels.clamped (beyond 65504) and pixels.negative (set to 0).
StoredView registerView(const Capture& capture, ViewId view, const Image8& mask,
                        const std::filesystem::path& srf_folder, const RegistrationOptions& options,
                        Reporter::Stage& stage, Reporter& reporter);

}  // namespace srf
