#include "model/fit_export.h"

#include <algorithm>
#include <cmath>
#include <map>

#include "base/error.h"
#include "base/mesh_io.h"
#include "model/glb_writer.h"
#include "model/gltf_file.h"

namespace srf {
namespace {

constexpr const char* kOption = "--export-parameters";
constexpr float kDielectric = 0.04f;  // reflectance of glTF's dielectrics at normal incidence

float brightness(const std::array<float, 3>& c) {
  return std::sqrt(0.299f * c[0] * c[0] + 0.587f * c[1] * c[1] + 0.114f * c[2] * c[2]);
}

/// Khronos, KHR_materials_pbrSpecularGlossiness, "convert-between-workflows": the metallic that gives both.
float solveMetallic(float diffuse, float specular, float one_minus_specular) {
  if (specular < kDielectric) return 0;
  const float a = kDielectric;
  const float b = diffuse * one_minus_specular / (1 - kDielectric) + specular - 2 * kDielectric;
  const float c = kDielectric - specular;
  return std::clamp((-b + std::sqrt(std::max(b * b - 4 * a * c, 0.f))) / (2 * a), 0.f, 1.f);
}

void writeGlb(const DeformableModel& model, const ReflectanceFit& fit, const std::filesystem::path& file) {
  std::vector<float> positions, normals, colors, metallic, roughness;
  const auto append = [](std::vector<float>& to, const Vec3& p) {
    for (int a = 0; a < 3; ++a) to.push_back(static_cast<float>(p[a]));
  };
  // A material of each roughness: the triangles go with their first corner.
  struct Material {
    std::vector<std::uint32_t> corners;
    double metallic = 0;
    std::size_t points = 0;
  };
  std::map<std::array<float, 2>, Material> materials;
  const auto materialOf = [&](std::uint32_t i) -> Material& {
    const PointReflectance& r = fit.points[i].reflectance;
    return materials[{r.alpha_x, r.alpha_y}];
  };
  for (std::uint32_t i = 0; i < model.size(); ++i) {
    const PointReflectance& r = fit.points[i].reflectance;
    const MetallicRoughness m = metallicRoughness(r);
    append(positions, gltfFromObject(model.p0[i].raw()));
    append(normals, gltfFromObject({r.normal[0], r.normal[1], r.normal[2]}));
    colors.insert(colors.end(), m.base_color.begin(), m.base_color.end());
    metallic.push_back(m.metallic);
    roughness.push_back(m.roughness);
    Material& material = materialOf(i);
    material.metallic += m.metallic;
    ++material.points;
  }
  for (const Triangle& t : model.triangles) {
    std::vector<std::uint32_t>& corners = materialOf(t[0]).corners;
    corners.insert(corners.end(), t.begin(), t.end());
  }

  GlbWriter glb;
  const auto add = [&](const std::vector<float>& values, const char* type, std::size_t width) {
    return glb.add(values, GlbWriter::kFloat, type, width, GlbWriter::kVertices);
  };
  Json attributes;
  attributes["POSITION"] = glb.addPositions(positions);
  attributes["NORMAL"] = add(normals, "VEC3", 3);
  attributes["COLOR_0"] = add(colors, "VEC3", 3);
  attributes["_METALLIC"] = add(metallic, "SCALAR", 1);
  attributes["_ROUGHNESS"] = add(roughness, "SCALAR", 1);
  Json primitives = Json::array();
  for (const auto& [alpha, material] : materials) {
    if (material.corners.empty()) continue;
    primitives.push_back(
        {{"attributes", attributes},
         {"indices", glb.add(material.corners, GlbWriter::kUnsigned, "SCALAR", 1, GlbWriter::kIndices)},
         {"material", glb.json["materials"].size()}});
    PointReflectance r;
    r.alpha_x = alpha[0], r.alpha_y = alpha[1];
    glb.json["materials"].push_back({{"name", "alpha " + std::to_string(alpha[0]) + " " + std::to_string(alpha[1])},
                                     {"pbrMetallicRoughness",
                                      {{"baseColorFactor", {1, 1, 1, 1}},
                                       {"metallicFactor", material.metallic / static_cast<double>(material.points)},
                                       {"roughnessFactor", metallicRoughness(r).roughness}}}});
  }
  glb.showMesh(file.stem().string(), std::move(primitives));
  glb.write(file);
}

}  // namespace

MetallicRoughness metallicRoughness(const PointReflectance& point) {
  std::array<float, 3> diffuse, specular;
  for (int c = 0; c < 3; ++c) {
    diffuse[c] = std::clamp(point.coefficient[0][c] + point.coefficient[1][c], 0.f, 1.f);
    specular[c] = std::clamp(point.coefficient[2][c], 0.f, 1.f);
  }
  const float most = *std::max_element(specular.begin(), specular.end());
  MetallicRoughness m;
  m.metallic = solveMetallic(brightness(diffuse), brightness(specular), 1 - most);
  for (int c = 0; c < 3; ++c) {
    const float of_diffuse = diffuse[c] * (1 - most) / ((1 - kDielectric) * std::max(1 - m.metallic, 1e-6f));
    const float of_specular = (specular[c] - kDielectric * (1 - m.metallic)) / std::max(m.metallic, 1e-6f);
    const float share = m.metallic * m.metallic;
    m.base_color[c] = std::clamp((1 - share) * of_diffuse + share * of_specular, 0.f, 1.f);
  }
  m.roughness = std::sqrt(std::sqrt(point.alpha_x * point.alpha_y));
  return m;
}

void exportFit(const DeformableModel& model, const ReflectanceFit& fit, const std::filesystem::path& file) {
  if (file.extension() == ".glb") {
    if (model.kind != ModelKind::mesh)
      throw Error(ErrorKind::usage, "the model is of surfels, which a .glb does not hold; export a .ply", kOption);
    return writeGlb(model, fit, file);
  }
  if (file.extension() != ".ply")
    throw Error(ErrorKind::usage, "found '" + file.string() + "', expected a name that ends in .glb or .ply", kOption);
  AcquisitionMesh mesh;
  mesh.positions = model.p0;
  mesh.triangles = model.triangles;
  PlyColumns columns;
  const auto put = [&columns](const std::string& name, float value) { columns[name].push_back(value); };
  constexpr const char* kTerms[kModelTerms] = {"kd", "kt", "ks", "kf"};
  constexpr const char* kChannels[3] = {"_r", "_g", "_b"};
  constexpr const char* kAxes[3] = {"_x", "_y", "_z"};
  for (std::size_t i = 0; i < model.size(); ++i) {
    const FittedPoint& point = fit.points[i];
    const PointReflectance& r = point.reflectance;
    mesh.normals.push_back(Direction<AcquisitionSpace>::fromUnit({r.normal[0], r.normal[1], r.normal[2]}));
    const MetallicRoughness m = metallicRoughness(r);
    for (int c = 0; c < 3; ++c) {
      put(std::string("base_color") + kChannels[c], m.base_color[c]);
      put(std::string("tangent") + kAxes[c], r.tangent[c]);
      for (int k = 0; k < kModelTerms; ++k) put(std::string(kTerms[k]) + kChannels[c], r.coefficient[k][c]);
    }
    put("metallic", m.metallic);
    put("roughness", m.roughness);
    put("alpha_x", r.alpha_x);
    put("alpha_y", r.alpha_y);
    put("gate", point.gate);
    put("indirect", point.indirect);
    put("indirect_shadow", point.indirect_shadow);
    if (model.kind == ModelKind::surfels) put("radius", model.radius[i]);
  }
  writePly(file, mesh, columns);
}

}  // namespace srf
