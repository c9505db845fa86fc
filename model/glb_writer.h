// A binary glTF under construction: its JSON and the one buffer that it describes.
#pragma once

#include <cstddef>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <vector>

#include "base/json.h"

namespace srf {

class GlbWriter {
 public:
  static constexpr int kFloat = 5126, kUnsigned = 5125, kVertices = 34962, kIndices = 34963;
  Json json = {{"asset", {{"version", "2.0"}, {"generator", "srf " SRF_VERSION}}}};

  /// Appends values of four bytes each as an accessor and returns its number. `width`: values of one element.
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
  /// Positions, whose accessor tells their bounds.
  int addPositions(const std::vector<float>& positions);
  /// Names one mesh of these primitives and puts it in the scene.
  void showMesh(const std::string& name, Json primitives);
  /// Appears when whole. Throws bad_input where it would be larger than a .glb can be.
  void write(const std::filesystem::path& file);

 private:
  std::vector<std::byte> binary_;
};

}  // namespace srf
