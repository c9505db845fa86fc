// What `srf info` shows of a fitted reflectance model: figures, and pictures from one of the capture's cameras.
#pragma once

#include <filesystem>
#include <vector>

#include "base/json.h"
#include "field/srf_folder.h"
#include "model/reflectance_fit.h"

namespace srf {

/// Held-out errors before and after, roughnesses with their shares, and how much of the model is guided.
Json fitInfo(const ReflectanceFit& fit);

/// Writes gate.png, indirect.png, indirect_shadow.png, slant.png, roughness.png (0 black, 1 white, as they are),
/// normal.png (x, y, z from -1 to 1, acquisition space), base_color.png and metallic.png into `folder`, as the field's
/// first camera with photographs sees the model. Returns their names.
std::vector<std::string> writeFitPictures(const SrfManifest& field, const DeformableModel& model,
                                          const ReflectanceFit& fit, const std::filesystem::path& folder);

}  // namespace srf
