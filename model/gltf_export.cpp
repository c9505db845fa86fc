#include "model/gltf_export.h"

#include <nlohmann/json.hpp>
#include <numeric>

#include "base/error.h"
#include "base/mesh_io.h"
#include "model/glb_writer.h"
#include "model/gltf_file.h"

namespace srf {
namespace {

constexpr std::size_t kMostCounted = std::size_t{1} << 24;

void writeGlb(const AcquisitionMesh& rest, const std::filesystem::path& file) {
  if (rest.positions.size() > kMostCounted)
    throw Error(ErrorKind::usage,
                "a .glb numbers at most 16777216 vertices, the model has " + std::to_string(rest.positions.size()) +
                    "; export a .ply",
                "--export");
  std::vector<float> positions, normals, index, texture;
  std::vector<std::uint32_t> corners;
  const auto append = [](std::vector<float>& to, const Vec3& p) {
    for (int a = 0; a < 3; ++a) to.push_back(static_cast<float>(p[a]));
  };
  const auto vertex_normals = vertexNormals(rest);
  for (std::size_t i = 0; i < rest.positions.size(); ++i) {
    append(positions, gltfFromObject(rest.positions[i].raw()));
    append(normals, gltfFromObject(vertex_normals[i].raw()));
    index.push_back(static_cast<float>(i));
    texture.insert(texture.end(), {static_cast<float>(i), 0});
  }
  for (const Triangle& t : rest.triangles) corners.insert(corners.end(), t.begin(), t.end());
  GlbWriter glb;
  Json attributes;
  attributes["POSITION"] = glb.addPositions(positions);
  attributes["NORMAL"] = glb.add(normals, GlbWriter::kFloat, "VEC3", 3, GlbWriter::kVertices);
  // Texture coordinates are numbered without a gap, so the first is there as well.
  attributes["TEXCOORD_0"] = attributes["TEXCOORD_1"] =
      glb.add(texture, GlbWriter::kFloat, "VEC2", 2, GlbWriter::kVertices);
  attributes["_SRF_INDEX"] = glb.add(index, GlbWriter::kFloat, "SCALAR", 1, GlbWriter::kVertices);
  const int triangles = glb.add(corners, GlbWriter::kUnsigned, "SCALAR", 1, GlbWriter::kIndices);
  glb.showMesh(file.stem().string(), Json::array({{{"attributes", attributes}, {"indices", triangles}}}));
  glb.write(file);
}

}  // namespace

void exportRestMesh(const AcquisitionMesh& rest, const std::filesystem::path& file) {
  if (file.extension() == ".glb") return writeGlb(rest, file);
  if (file.extension() != ".ply")
    throw Error(ErrorKind::usage, "found '" + file.string() + "', expected a name that ends in .glb or .ply",
                "--export");
  std::vector<float> index(rest.positions.size());
  std::iota(index.begin(), index.end(), 0.0f);
  AcquisitionMesh mesh = rest;
  mesh.normals = vertexNormals(rest);
  writePly(file, mesh, {{"_SRF_INDEX", index}});
}

}  // namespace srf
