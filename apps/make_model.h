// The model stage: a shape by name or file to the model inside an SRF. What `srf model` and `srf pipeline` call.
#pragma once

#include <filesystem>
#include <string>

#include "model/deformable_model.h"
#include "model/reflectance_fit.h"

namespace srf {

/// `shape`: "hull", a parametric name (sphere, box, cylinder, plane, torus) or a mesh (PLY, OBJ, glTF) or point file.
/// Stores the model under `name` (empty: "mesh" or "surfels"), makes it the active one, fits the reflectance model to
/// its points where `fit` is given, and returns it.
DeformableModel makeModel(const std::filesystem::path& srf_folder, const std::string& shape,
                          const ModelOptions& options, const std::optional<FitOptions>& fit, Reporter& reporter,
                          const std::string& name = "");

}  // namespace srf
