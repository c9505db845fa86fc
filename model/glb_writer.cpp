#include "model/glb_writer.h"

#include <algorithm>
#include <cmath>
#include <cstdint>

#include "base/error.h"
#include "base/files.h"

namespace srf {

int GlbWriter::addPositions(const std::vector<float>& positions) {
  std::vector<float> low(3, INFINITY), high(3, -INFINITY);
  for (std::size_t i = 0; i < positions.size(); ++i) {
    low[i % 3] = std::min(low[i % 3], positions[i]);
    high[i % 3] = std::max(high[i % 3], positions[i]);
  }
  const int accessor = add(positions, kFloat, "VEC3", 3, kVertices);
  json["accessors"].back()["min"] = low;
  json["accessors"].back()["max"] = high;
  return accessor;
}

void GlbWriter::showMesh(const std::string& name, Json primitives) {
  json["meshes"] = Json::array({{{"name", name}, {"primitives", std::move(primitives)}}});
  json["nodes"] = Json::array({{{"name", name}, {"mesh", 0}}});
  json["scenes"] = Json::array({{{"nodes", {0}}}});
  json["scene"] = 0;
}

void GlbWriter::write(const std::filesystem::path& file) {
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

}  // namespace srf
