// A capture to an SRF folder: silhouettes, hull, registered views. What `srf acquire` and `srf pipeline` call.
#pragma once

#include <filesystem>
#include <functional>
#include <optional>
#include <string>

#include "acquire/pose_adjustment.h"
#include "acquire/silhouette.h"
#include "acquire/visual_hull.h"
#include "field/reflectance_store.h"
#include "field/srf_folder.h"

namespace srf {

struct AcquireOptions {
  SilhouetteOptions silhouette;
  HullOptions hull;
  /// Absent: the poses stay as they are. Bounds left empty are the hull's.
  std::optional<PoseAdjustmentOptions> adjust_poses;
  bool make_hull = true;  ///< false where the model will come from another shape
  /// Makes the hull from the carved one, e.g. exactVisualHull; absent: the carved one it is.
  std::function<VisualHull(const std::vector<SilhouetteView>&, const VisualHull&, Reporter&)> refine_hull;
  std::filesystem::path mask_pictures;  ///< folder for pictures of the masks; empty: none
  StoreCoding coding;                   ///< of the reflectance images
  /// That the whole process may hold: photographs are read again where it has no room for all of a view. A photograph
  /// and a row of tiles of its view are held in any case, and the silhouettes of all views while the hull is carved.
  std::size_t memory_bytes = std::size_t{1} << 30;
  std::string command;  ///< recorded in the manifest
};

/// Writes `out` (X.srf) and returns its manifest. An existing SRF there is replaced only when the new one is whole;
/// a folder that is not an SRF is refused. Views finished by an interrupted run of the same input and options are kept.
SrfManifest acquireField(const Capture& capture, const std::filesystem::path& out, const AcquireOptions& options,
                         Reporter& reporter);

/// Writes a hull into the folder; the entry that a manifest names it by.
StoredFile storeHull(const AcquisitionMesh& mesh, const std::filesystem::path& folder);

}  // namespace srf
