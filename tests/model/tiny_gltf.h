// Small glTF files put together in a test.
#pragma once

#include <cstring>
#include <map>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "base/files.h"
#include "base/json.h"

namespace srf::test {

class TinyGltf {
 public:
  Json json = {{"asset", {{"version", "2.0"}}}};

  /// Adds an accessor over its own buffer view; returns its number.
  template <class T>
  int add(const std::string& type, int component_type, const std::vector<T>& values) {
    static const std::map<std::string, std::size_t> kWidth{
        {"SCALAR", 1}, {"VEC2", 2}, {"VEC3", 3}, {"VEC4", 4}, {"MAT4", 16}};
    const int buffer_view = view(values);  // first: it may move what json["accessors"] refers to
    json["accessors"].push_back({{"bufferView", buffer_view},
                                 {"componentType", component_type},
                                 {"count", values.size() / kWidth.at(type)},
                                 {"type", type}});
    return static_cast<int>(json["accessors"].size()) - 1;
  }
  int floats(const std::string& type, const std::vector<float>& values) { return add(type, 5126, values); }
  template <class T>
  int view(const std::vector<T>& values) {
    while (bytes.size() % 4) bytes.push_back(std::byte{0});
    const std::size_t at = bytes.size(), size = values.size() * sizeof(T);
    bytes.resize(at + size);
    if (size) std::memcpy(&bytes[at], values.data(), size);
    json["bufferViews"].push_back({{"buffer", 0}, {"byteOffset", at}, {"byteLength", size}});
    return static_cast<int>(json["bufferViews"].size()) - 1;
  }
  /// Adds an animation of one channel.
  void animate(int node, const std::string& path, const std::string& way, const std::vector<float>& times,
               const std::vector<float>& values) {
    const std::string type = path == "weights" ? "SCALAR" : path == "rotation" ? "VEC4" : "VEC3";
    const int input = floats("SCALAR", times), output = floats(type, values);
    json["animations"].push_back({{"channels", {{{"sampler", 0}, {"target", {{"node", node}, {"path", path}}}}}},
                                  {"samplers", {{{"input", input}, {"output", output}, {"interpolation", way}}}}});
  }

  std::vector<std::byte> bytes;

  /// As .gltf with a data URI.
  std::string text() const {
    static constexpr char kDigits[] = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    std::string base64;
    for (std::size_t i = 0; i < bytes.size(); i += 3) {
      std::uint32_t three = 0;
      for (std::size_t k = 0; k < 3; ++k)
        three = three << 8 | (i + k < bytes.size() ? static_cast<std::uint32_t>(bytes[i + k]) : 0);
      for (std::size_t k = 0; k < 4; ++k) base64 += i + k > bytes.size() ? '=' : kDigits[three >> (18 - 6 * k) & 63];
    }
    Json whole = json;
    if (!bytes.empty())
      whole["buffers"] = {{{"byteLength", bytes.size()}, {"uri", "data:application/octet-stream;base64," + base64}}};
    return whole.dump();
  }
  /// As .glb.
  std::vector<std::byte> binary() const {
    Json whole = json;
    whole["buffers"] = {{{"byteLength", bytes.size()}}};
    std::string head = whole.dump();
    while (head.size() % 4) head += ' ';
    std::vector<std::byte> file;
    const auto word = [&file](std::size_t value) {
      for (int k = 0; k < 4; ++k) file.push_back(static_cast<std::byte>(value >> (8 * k) & 0xff));
    };
    word(0x46546C67), word(2), word(28 + head.size() + bytes.size());
    word(head.size()), word(0x4E4F534A);
    for (const char c : head) file.push_back(static_cast<std::byte>(c));
    word(bytes.size()), word(0x004E4942);
    file.insert(file.end(), bytes.begin(), bytes.end());
    return file;
  }

  /// A triangle (0,0,0) (1,0,0) (0,1,0) at node 0.
  static TinyGltf triangle() {
    TinyGltf tiny;
    const int position = tiny.floats("VEC3", {0, 0, 0, 1, 0, 0, 0, 1, 0});
    tiny.json["meshes"] = {{{"name", "part"}, {"primitives", {{{"attributes", {{"POSITION", position}}}}}}}};
    tiny.json["nodes"] = {{{"name", "holder"}, {"mesh", 0}}};
    return tiny;
  }
  /// The triangle with its third vertex on joint 1 (node 2, child of joint 0 at node 1).
  static TinyGltf skinned() {
    TinyGltf tiny = triangle();
    Json& attributes = tiny.json["meshes"][0]["primitives"][0]["attributes"];
    attributes["JOINTS_0"] = tiny.add<std::uint8_t>("VEC4", 5121, {0, 0, 0, 0, 0, 0, 0, 0, 1, 0, 0, 0});
    attributes["WEIGHTS_0"] = tiny.floats("VEC4", {1, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0});
    tiny.json["nodes"][0]["skin"] = 0;
    tiny.json["nodes"].push_back({{"children", {2}}});
    tiny.json["nodes"].push_back({{"translation", {0, 1, 0}}});
    const int bind = tiny.floats("MAT4", {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0,  0, 1,  //
                                          1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, -1, 0, 1});
    tiny.json["skins"] = {{{"joints", {1, 2}}, {"inverseBindMatrices", bind}}};
    return tiny;
  }
};

}  // namespace srf::test
