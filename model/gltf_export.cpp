#include "model/gltf_export.h"

#include <nlohmann/json.hpp>
#include <numeric>

#include "base/error.h"
#include "base/files.h"
#include "base/json.h"
#include "base/mesh_io.h"
#include "model/gltf_file.h"

namespace srf {
namespace {

constexpr std::size_t kMostCounted = std::size_t{1} << 24;

/// The binary chunk under construction, and the JSON that describes it.
class Glb {
 public:
  Json json = {{"asset", {{"version", "2.0"}, {"generator", "srf " SRF_VERSION}}}};

  template <class T>
  int add(const std::vector<T>& values, int component_type, const char* type, std::size_t width, int target) {
    const std::size_t bytes = values.size() * sizeof(T);  // a multiple of 4, so that every view is aligned
    Json view{{"buffer", 0}, {"byteOffset", binary_.size()}, {"byteLength", bytes}, {"target", target}};
    Json accessor{{"bufferView", json["bufferViews"].size()},
                  {"componentType", component_type},
                  {"count", values.size() / width},
                  {"type", type}};
    const auto* first = reinterpret_cast<const std::byte*>(values.data());
    binary_.insert(binary_.end(), first, first + bytes);
    json["bufferViews"].push_back(std::move(view));
    json["accessors"].push_back(std::move(accessor));
    return static_cast<int>(json["accessors"].size()) - 1;
  }
  void write(const std::filesystem::path& file) {
    json["buffers"] = Json::array({{{"byteLength", binary_.size()}}});
    std::string head = json.dump();
    head.resize((head.size() + 3) / 4 * 4, ' ');
    const std::size_t total = 12 + 8 + head.size() + 8 + binary_.size();
    if (total > 0xffffffffu) throw badInput(file.string(), "would be larger than the 4 GB of a .glb; export a .ply");
    PartialFile out(file);
    const auto words = [&out](std::initializer_list<std::size_t> values) {
      for (const std::size_t value : values) {
        const auto word = static_cast<std::uint32_t>(value);
        out.write(&word, sizeof word);
      }
    };
    words({0x46546C67, 2, total, head.size(), 0x4E4F534A});
    out.write(head.data(), head.size());
    words({binary_.size(), 0x004E4942});
    out.write(binary_.data(), binary_.size());
    out.commit();
  }

 private:
  std::vector<std::byte> binary_;
};

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
  std::vector<float> low(3, INFINITY), high(3, -INFINITY);
  for (std::size_t i = 0; i < positions.size(); ++i) {
    low[i % 3] = std::min(low[i % 3], positions[i]);
    high[i % 3] = std::max(high[i % 3], positions[i]);
  }

  constexpr int kFloat = 5126, kUnsigned = 5125, kVertices = 34962, kIndices = 34963;
  Glb glb;
  Json attributes;
  attributes["POSITION"] = glb.add(positions, kFloat, "VEC3", 3, kVertices);
  glb.json["accessors"].back()["min"] = low;
  glb.json["accessors"].back()["max"] = high;
  attributes["NORMAL"] = glb.add(normals, kFloat, "VEC3", 3, kVertices);
  // Texture coordinates are numbered without a gap, so the first is there as well.
  attributes["TEXCOORD_0"] = attributes["TEXCOORD_1"] = glb.add(texture, kFloat, "VEC2", 2, kVertices);
  attributes["_SRF_INDEX"] = glb.add(index, kFloat, "SCALAR", 1, kVertices);
  const int triangles = glb.add(corners, kUnsigned, "SCALAR", 1, kIndices);
  const std::string name = file.stem().string();
  glb.json["meshes"] = Json::array(
      {{{"name", name}, {"primitives", Json::array({{{"attributes", attributes}, {"indices", triangles}}})}}});
  glb.json["nodes"] = Json::array({{{"name", name}, {"mesh", 0}}});
  glb.json["scenes"] = Json::array({{{"nodes", {0}}}});
  glb.json["scene"] = 0;
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
