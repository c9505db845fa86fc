// The fitted reflectance for other programs: as columns of a point list, and as a glTF material.
#pragma once

#include <array>
#include <filesystem>

#include "model/deformable_model.h"
#include "model/reflectance_fit.h"

namespace srf {

/// A point's reflectance in the terms of glTF's metallic-roughness material, linear, each from 0 to 1.
struct MetallicRoughness {
  std::array<float, 3> base_color{};
  float metallic = 0, roughness = 1;
};
/// kd and kt together are the diffuse albedo, ks the reflectance at normal incidence; the split into base colour and
/// metallic is that of Khronos's conversion from specular-glossiness. Roughness is the square root of alpha, for two of
/// them of their geometric mean.
MetallicRoughness metallicRoughness(const PointReflectance& point);

/// .ply: every point with its fitted normal and the columns base_color_{r,g,b}, metallic, roughness,
/// {kd,kt,ks,kf}_{r,g,b}, alpha_x, alpha_y, tangent_{x,y,z}, gate, indirect, indirect_shadow; of a mesh its triangles
/// too, of surfels the radius. .glb: the mesh with the fitted normals, base colour as COLOR_0, `_METALLIC` and
/// `_ROUGHNESS` as vertex attributes, and a material for each roughness found, whose metallic factor is the mean of its
/// vertices'. Throws usage for another suffix, and for a .glb of surfels.
void exportFit(const DeformableModel& model, const ReflectanceFit& fit, const std::filesystem::path& file);

}  // namespace srf
