#include "model/gltf_file.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>
#include <functional>
#include <limits>
#include <nlohmann/json.hpp>
#include <set>

#include "base/error.h"
#include "base/files.h"
#include "base/json.h"

static_assert(std::endian::native == std::endian::little, "buffers are little-endian and read as they are");

namespace srf {
namespace {

namespace fs = std::filesystem;

constexpr long kMostCount = std::numeric_limits<std::int32_t>::max();
// Numbers decoded from one file in all: many accessors may name the same few bytes, or none, and would otherwise ask
// for any amount of memory.
constexpr std::size_t kMostNumbers = std::size_t{1} << 27;
constexpr long kMostJointSets = 16;

using Bytes = std::vector<std::byte>;

struct Parts {
  JsonNode root;
  std::optional<Bytes> binary;  ///< second chunk of a .glb
  std::uint64_t hash;
};

std::uint32_t word(const Bytes& bytes, std::size_t at) {
  std::uint32_t value;
  std::memcpy(&value, &bytes[at], sizeof value);
  return value;
}

Parts readParts(const fs::path& file) {
  const Bytes bytes = readBinaryFile(file);
  const std::uint64_t hash = contentHash(bytes.data(), bytes.size());
  const auto text = [&](std::size_t from, std::size_t size) {
    return std::string(reinterpret_cast<const char*>(bytes.data()) + from, size);
  };
  const auto broken = [&](const std::string& what) {
    return badInput(file.string(), what + "; expected a glTF 2.0 file, export it again");
  };
  constexpr std::uint32_t kMagic = 0x46546C67, kJson = 0x4E4F534A, kBinary = 0x004E4942;
  if (bytes.size() < 4 || word(bytes, 0) != kMagic)
    return {parseJson(text(0, bytes.size()), file.string()), std::nullopt, hash};
  if (bytes.size() < 20) throw broken("ends within its header");
  if (word(bytes, 4) != 2) throw broken("has version " + std::to_string(word(bytes, 4)));
  if (word(bytes, 8) > bytes.size())
    throw broken("says it has " + std::to_string(word(bytes, 8)) + " bytes, yet has " + std::to_string(bytes.size()));
  const std::size_t end = word(bytes, 8);
  std::optional<std::string> json;
  std::optional<Bytes> binary;
  for (std::size_t at = 12; at + 8 <= end;) {
    const std::size_t size = word(bytes, at);
    const std::uint32_t type = word(bytes, at + 4);
    at += 8;
    if (size > end - at) throw broken("a chunk at byte " + std::to_string(at - 8) + " ends beyond the file");
    if (!json) {
      if (type != kJson) throw broken("does not begin with a JSON chunk");
      json = text(at, size);
    } else if (type == kBinary && !binary) {
      binary = Bytes(bytes.begin() + static_cast<std::ptrdiff_t>(at),
                     bytes.begin() + static_cast<std::ptrdiff_t>(at + size));
    }
    at += size;
  }
  if (!json) throw broken("has no JSON chunk");
  return {parseJson(*json, file.string()), std::move(binary), hash};
}

std::optional<Bytes> decodeBase64(std::string_view text) {
  Bytes bytes;
  bytes.reserve(text.size() / 4 * 3);
  while (text.ends_with('=')) text.remove_suffix(1);
  std::uint32_t held = 0;
  int bits = 0;
  for (const char c : text) {
    const int value = c >= 'A' && c <= 'Z'   ? c - 'A'
                      : c >= 'a' && c <= 'z' ? c - 'a' + 26
                      : c >= '0' && c <= '9' ? c - '0' + 52
                      : c == '+' || c == '-' ? 62
                      : c == '/' || c == '_' ? 63
                                             : -1;
    if (value < 0) return std::nullopt;
    held = (held << 6 | static_cast<std::uint32_t>(value)) & 0xffffffu;
    bits += 6;
    if (bits < 8) continue;
    bits -= 8;
    bytes.push_back(static_cast<std::byte>(held >> bits & 0xff));
  }
  return bytes;
}

/// A file beside the glTF: percent signs decoded; no scheme, no root.
fs::path besideFile(const JsonNode& uri, const fs::path& folder) {
  const std::string text = uri.string();
  std::string name;
  for (std::size_t i = 0; i < text.size(); ++i) {
    const auto digit = [&](std::size_t k) {
      const char c = k < text.size() ? text[k] : ' ';
      return c >= '0' && c <= '9'   ? c - '0'
             : c >= 'a' && c <= 'f' ? c - 'a' + 10
             : c >= 'A' && c <= 'F' ? c - 'A' + 10
                                    : -1;
    };
    if (text[i] == '%' && digit(i + 1) >= 0 && digit(i + 2) >= 0) {
      name += static_cast<char>(digit(i + 1) * 16 + digit(i + 2));
      i += 2;
    } else {
      name += text[i];
    }
  }
  if (name.find("://") != std::string::npos || name.find('\0') != std::string::npos || fs::path(name).is_absolute())
    throw uri.error("found '" + text + "', expected a file beside the glTF or a data URI");
  std::error_code ignored;
  if (!fs::is_regular_file(folder / name, ignored))
    throw uri.error("the file '" + (folder / name).string() + "' is not there; keep it beside the glTF");
  return folder / name;
}

class Reader {
 public:
  explicit Reader(const fs::path& file) : parts_(readParts(file)), root_(parts_.root) {
    gltf_.file = file;
    gltf_.content_hash = parts_.hash;
  }

  Gltf read() {
    const JsonNode asset = root_["asset"];
    if (const std::string version = asset["version"].string(); !version.starts_with("2."))
      throw asset["version"].error("found '" + version + "', expected 2.0");
    checkExtensions();
    readBuffers();
    readCameras();
    readLights();
    each("nodes", [&](const JsonNode& node) { gltf_.nodes.push_back({nameOf(node)}); });
    each("meshes", [&](const JsonNode& node) { readMesh(node); });
    each("skins", [&](const JsonNode& node) { readSkin(node); });
    std::size_t index = 0;
    each("nodes", [&](const JsonNode& node) { readNode(node, index++); });
    orderNodes();
    each("animations", [&](const JsonNode& node) { readAnimation(node); });
    return std::move(gltf_);
  }

 private:
  static std::string nameOf(const JsonNode& node) {
    const auto name = node.find("name");
    return name ? name->string() : "";
  }
  static double numberOr(const JsonNode& node, const char* key, double otherwise) {
    const auto value = node.find(key);
    return value ? value->number() : otherwise;
  }
  void each(const char* key, const std::function<void(const JsonNode&)>& visit) const {
    const auto list = root_.find(key);
    for (std::size_t i = 0; list && i < list->size(); ++i) visit(list->at(i));
  }
  /// An index into a list of `count`.
  static int index(const JsonNode& node, std::size_t count, const char* what) {
    const long i = node.integer(0, kMostCount);
    if (static_cast<std::size_t>(i) >= count)
      throw node.error("found " + std::to_string(i) + ", yet the file has " + std::to_string(count) + " " + what);
    return static_cast<int>(i);
  }

  void checkExtensions() const {
    each("extensionsRequired", [](const JsonNode& node) {
      const std::string name = node.string();
      // What changes looks alone is no matter here.
      for (const char* harmless :
           {"KHR_materials_", "KHR_texture_", "EXT_texture_", "KHR_lights_punctual", "KHR_mesh_quantization"})
        if (name.starts_with(harmless)) return;
      throw node.error("found '" + name +
                       "', which this program does not read; export without it (no compression of meshes)");
    });
  }

  void readBuffers() {
    each("buffers", [&](const JsonNode& node) {
      const auto length = static_cast<std::size_t>(node["byteLength"].integer(0, std::numeric_limits<long>::max()));
      Bytes bytes;
      if (!node.has("uri")) {
        if (!buffers_.empty() || !parts_.binary) throw node.error("has no uri, and there is no binary chunk for it");
        bytes = std::move(*parts_.binary);
      } else {
        const JsonNode uri = node["uri"];
        const std::string& text = uri.raw().is_string() ? uri.raw().get_ref<const std::string&>() : uri.string();
        if (text.starts_with("data:")) {
          const std::size_t comma = text.find(";base64,");
          const auto decoded =
              comma == std::string::npos ? std::nullopt : decodeBase64(std::string_view(text).substr(comma + 8));
          if (!decoded) throw uri.error("is no base64 data URI");
          bytes = *decoded;
        } else {
          bytes = readBinaryFile(besideFile(uri, gltf_.file.parent_path()));
          gltf_.content_hash = contentHash(bytes.data(), bytes.size(), gltf_.content_hash);
        }
      }
      if (bytes.size() < length)
        throw node.error("promises " + std::to_string(length) + " bytes, only " + std::to_string(bytes.size()) +
                         " are there; the file is cut off");
      bytes.resize(length);
      buffers_.push_back(std::move(bytes));
    });
  }

  /// The bytes of `count` elements of `size` bytes from a buffer view, `stride` apart.
  struct Run {
    const std::byte* first = nullptr;
    std::size_t stride = 0;
  };
  Run run(const JsonNode& from, std::size_t count, std::size_t size, bool may_stride) const {
    const JsonNode views = root_["bufferViews"];
    const JsonNode view = views.at(static_cast<std::size_t>(index(from["bufferView"], views.size(), "buffer views")));
    const Bytes& buffer = buffers_[static_cast<std::size_t>(index(view["buffer"], buffers_.size(), "buffers"))];
    const auto bytesOr = [](const JsonNode& node, const char* key, long otherwise) {
      const auto value = node.find(key);
      return static_cast<std::size_t>(value ? value->integer(0, std::numeric_limits<long>::max()) : otherwise);
    };
    const std::size_t begin = bytesOr(view, "byteOffset", 0), length = bytesOr(view, "byteLength", 0);
    if (begin > buffer.size() || length > buffer.size() - begin)
      throw view.error("ends beyond its buffer of " + std::to_string(buffer.size()) + " bytes");
    Run run;
    run.stride = size;
    if (may_stride && view.has("byteStride")) {
      run.stride = static_cast<std::size_t>(view["byteStride"].integer(1, 1 << 16));
      if (run.stride < size)
        throw view["byteStride"].error("found " + std::to_string(run.stride) + ", expected at least the " +
                                       std::to_string(size) + " bytes of an element");
    }
    const std::size_t offset = bytesOr(from, "byteOffset", 0);
    const bool fits = count == 0 || (offset <= length && size <= length - offset &&
                                     (length - offset - size) / run.stride >= count - 1);
    if (!fits)
      throw from.error("reads " + std::to_string(count) + " elements beyond the end of its buffer view of " +
                       std::to_string(length) + " bytes");
    run.first = buffer.data() + begin + (count ? offset : 0);
    return run;
  }

  static std::size_t componentBytes(const JsonNode& node, int* type) {
    *type = static_cast<int>(node.integer(0, kMostCount));
    switch (*type) {
      case 5120:
      case 5121:
        return 1;
      case 5122:
      case 5123:
        return 2;
      case 5125:
      case 5126:
        return 4;
      default:
        throw node.error("found " + std::to_string(*type) + ", expected 5120 to 5123, 5125 or 5126");
    }
  }
  static double component(const std::byte* at, int type, bool normalized) {
    const auto as = [at]<class T>(T value) {
      std::memcpy(&value, at, sizeof value);
      return static_cast<double>(value);
    };
    switch (type) {
      case 5120:
        return normalized ? std::max(as(std::int8_t{}) / 127, -1.0) : as(std::int8_t{});
      case 5121:
        return normalized ? as(std::uint8_t{}) / 255 : as(std::uint8_t{});
      case 5122:
        return normalized ? std::max(as(std::int16_t{}) / 32767, -1.0) : as(std::int16_t{});
      case 5123:
        return normalized ? as(std::uint16_t{}) / 65535 : as(std::uint16_t{});
      case 5125:
        return as(std::uint32_t{});
      default:
        return as(float{});
    }
  }

  struct Numbers {
    JsonNode node;               ///< the accessor, for errors
    int components;              ///< of an element
    std::vector<double> values;  ///< [element][component]; finite
    std::size_t count() const { return values.size() / static_cast<std::size_t>(components); }
  };
  /// The accessor that `at` names, of one of `types`; `integers`: not floats, and not normalized.
  Numbers numbers(const JsonNode& at, std::initializer_list<std::string_view> types, bool integers = false) {
    const JsonNode list = root_["accessors"];
    const JsonNode node = list.at(static_cast<std::size_t>(index(at, list.size(), "accessors")));
    static constexpr std::pair<std::string_view, int> kTypes[] = {{"SCALAR", 1}, {"VEC2", 2}, {"VEC3", 3}, {"VEC4", 4},
                                                                  {"MAT2", 4},   {"MAT3", 9}, {"MAT4", 16}};
    const std::string type = node["type"].string();
    if (std::find(types.begin(), types.end(), type) == types.end())
      throw node["type"].error("found '" + type + "', expected " + std::string(*types.begin()) + " where " +
                               at.pointer() + " uses it");
    Numbers result{node, 0, {}};
    for (const auto& [name, components] : kTypes)
      if (name == type) result.components = components;
    int component_type;
    const std::size_t bytes = componentBytes(node["componentType"], &component_type);
    const bool normalized = node.has("normalized") && node["normalized"].boolean();
    if (integers && (component_type == 5126 || normalized))
      throw node["componentType"].error("found floats or normalized numbers, expected whole ones where " +
                                        at.pointer() + " uses it");
    const auto count = static_cast<std::size_t>(node["count"].integer(0, kMostCount));
    const auto width = static_cast<std::size_t>(result.components);
    numbers_left_ -= std::min(numbers_left_, count * width);
    if (numbers_left_ == 0)
      throw node["count"].error("found " + std::to_string(count) + "; the file holds more than " +
                                std::to_string(kMostNumbers) + " numbers, simplify it");
    const auto decode = [&](const Run& run, std::size_t i, std::size_t to) {
      for (std::size_t c = 0; c < width; ++c) {
        const double value = component(run.first + i * run.stride + c * bytes, component_type, normalized);
        if (!std::isfinite(value))
          throw node.error("element " + std::to_string(to) + " is not finite, expected numbers");
        result.values[to * width + c] = value;
      }
    };
    std::optional<Run> dense;  // before the memory is asked for: the bytes must be there
    if (node.has("bufferView")) dense = run(node, count, width * bytes, true);
    result.values.assign(count * width, 0);
    for (std::size_t i = 0; dense && i < count; ++i) decode(*dense, i, i);
    if (const auto sparse = node.find("sparse")) {
      const auto changed = static_cast<std::size_t>((*sparse)["count"].integer(0, kMostCount));
      const JsonNode where = (*sparse)["indices"];
      int index_type;
      const std::size_t index_bytes = componentBytes(where["componentType"], &index_type);
      if (index_type == 5126) throw where["componentType"].error("found floats, expected whole numbers");
      const Run indices = run(where, changed, index_bytes, false);
      const Run values = run((*sparse)["values"], changed, width * bytes, false);
      for (std::size_t i = 0; i < changed; ++i) {
        const double to = component(indices.first + i * index_bytes, index_type, false);
        if (!(to >= 0 && to < static_cast<double>(count)))
          throw where.error("index " + std::to_string(i) + " is " + std::to_string(static_cast<long>(to)) +
                            ", the accessor has " + std::to_string(count) + " elements");
        decode(values, i, static_cast<std::size_t>(to));
      }
    }
    return result;
  }
  std::vector<Vec3> triples(const JsonNode& at) {
    const Numbers found = numbers(at, {"VEC3"});
    std::vector<Vec3> triples(found.count());
    for (std::size_t i = 0; i < triples.size(); ++i)
      triples[i] = {found.values[3 * i], found.values[3 * i + 1], found.values[3 * i + 2]};
    return triples;
  }

  void readMesh(const JsonNode& node) {
    GltfMesh mesh;
    mesh.name = nameOf(node);
    const JsonNode primitives = node["primitives"];
    for (std::size_t p = 0; p < primitives.size(); ++p) readPrimitive(primitives.at(p), mesh, p == 0);
    rest_weights_.emplace_back();
    if (const auto weights = node.find("weights"))
      rest_weights_.back() = weights->numbers(mesh.targets.size());
    else
      rest_weights_.back().assign(mesh.targets.size(), 0);
    gltf_.meshes.push_back(std::move(mesh));
  }

  void readPrimitive(const JsonNode& node, GltfMesh& mesh, bool first) {
    const JsonNode attributes = node["attributes"];
    const std::size_t before = mesh.positions.size();
    const std::vector<Vec3> positions = triples(attributes["POSITION"]);
    mesh.positions.insert(mesh.positions.end(), positions.begin(), positions.end());
    const std::size_t total = mesh.positions.size();
    const auto sameCount = [&](const JsonNode& at, std::size_t count) {
      if (count != positions.size())
        throw at.error("has " + std::to_string(count) + " elements, POSITION has " + std::to_string(positions.size()));
    };

    const auto targets = node.find("targets");
    const std::size_t target_count = targets ? targets->size() : 0;
    if (first) mesh.targets.resize(target_count);
    if (mesh.targets.size() != target_count)
      throw node.error("has " + std::to_string(target_count) + " morph targets, the first primitive has " +
                       std::to_string(mesh.targets.size()));
    for (std::size_t t = 0; t < target_count; ++t) {
      const JsonNode target = targets->at(t);
      std::vector<Vec3> moves(positions.size());
      if (const auto position = target.find("POSITION")) {
        moves = triples(*position);
        sameCount(*position, moves.size());
      }
      mesh.targets[t].insert(mesh.targets[t].end(), moves.begin(), moves.end());
    }

    readTriangles(node, mesh, before);
    readInfluences(attributes, mesh, before, sameCount);

    const auto carrier = [&](std::initializer_list<const char*> names, std::initializer_list<std::string_view> types,
                             std::vector<double>& into) {
      for (const char* name : names) {
        const auto at = attributes.find(name);
        if (!at || into.size() != before) continue;
        const Numbers found = numbers(*at, types);
        sameCount(*at, found.count());
        for (std::size_t i = 0; i < found.count(); ++i)
          into.push_back(found.values[i * static_cast<std::size_t>(found.components)]);
      }
      if (into.size() != total) into.clear();
    };
    // Older exporters put one more underscore before a custom attribute.
    carrier({"_SRF_INDEX", "__SRF_INDEX"}, {"SCALAR"}, mesh.srf_index);
    carrier({"TEXCOORD_1"}, {"VEC2"}, mesh.texture_index);
  }

  void readTriangles(const JsonNode& node, GltfMesh& mesh, std::size_t before) {
    const long mode = node.has("mode") ? node["mode"].integer(0, 6) : 4;
    if (mode < 4) return;  // points and lines: vertices that other things may follow, no surface
    const std::size_t vertices = mesh.positions.size() - before;
    std::vector<std::uint32_t> corners;
    if (const auto at = node.find("indices")) {
      const Numbers found = numbers(*at, {"SCALAR"}, true);
      for (std::size_t i = 0; i < found.count(); ++i) {
        if (!(found.values[i] >= 0 && found.values[i] < static_cast<double>(vertices)))
          throw found.node.error("element " + std::to_string(i) + " is " +
                                 std::to_string(static_cast<long>(found.values[i])) + ", the primitive has " +
                                 std::to_string(vertices) + " vertices");
        corners.push_back(static_cast<std::uint32_t>(before + static_cast<std::size_t>(found.values[i])));
      }
    } else {
      for (std::size_t i = 0; i < vertices; ++i) corners.push_back(static_cast<std::uint32_t>(before + i));
    }
    const std::size_t count = mode == 4 ? corners.size() / 3 : corners.size() < 3 ? 0 : corners.size() - 2;
    for (std::size_t t = 0; t < count; ++t) {
      if (mode == 4) {
        mesh.triangles.push_back({corners[3 * t], corners[3 * t + 1], corners[3 * t + 2]});
      } else if (mode == 5) {  // a strip turns at every step
        mesh.triangles.push_back({corners[t], corners[t + 1 + t % 2], corners[t + 2 - t % 2]});
      } else {
        mesh.triangles.push_back({corners[t + 1], corners[t + 2], corners[0]});
      }
    }
  }

  void readInfluences(const JsonNode& attributes, GltfMesh& mesh, std::size_t before,
                      const std::function<void(const JsonNode&, std::size_t)>& sameCount) {
    std::vector<Numbers> joints, weights;
    for (long set = 0; set <= kMostJointSets; ++set) {
      const auto joint = attributes.find("JOINTS_" + std::to_string(set));
      if (!joint) break;
      if (set == kMostJointSets) throw joint->error("is one set of joints too many; reduce the influences of a vertex");
      const JsonNode weight = attributes["WEIGHTS_" + std::to_string(set)];
      joints.push_back(numbers(*joint, {"VEC4"}, true));
      weights.push_back(numbers(weight, {"VEC4"}));
      sameCount(*joint, joints.back().count());
      sameCount(weight, weights.back().count());
    }
    const std::size_t total = mesh.positions.size();
    const auto influences = std::max<std::size_t>(static_cast<std::size_t>(mesh.influences), 4 * joints.size());
    if (influences == 0) return;
    if (influences * total > numbers_left_) throw attributes.error("has too many influences; simplify the mesh");
    // The primitives before this one may have had fewer: they get more of weight 0.
    if (const auto old = static_cast<std::size_t>(mesh.influences); old < influences) {
      std::vector<std::uint16_t> all_joints(before * influences, 0);
      std::vector<double> all_weights(before * influences, 0);
      for (std::size_t v = 0; old > 0 && v < before; ++v)
        for (std::size_t k = 0; k < old; ++k) {
          all_joints[v * influences + k] = mesh.joints[v * old + k];
          all_weights[v * influences + k] = mesh.joint_weights[v * old + k];
        }
      mesh.influences = static_cast<int>(influences);
      mesh.joints = std::move(all_joints);
      mesh.joint_weights = std::move(all_weights);
    }
    mesh.joints.resize(total * influences, 0);
    mesh.joint_weights.resize(total * influences, 0);
    for (std::size_t v = before; v < total; ++v) {
      double sum = 0;
      for (std::size_t k = 0; k < 4 * joints.size(); ++k) {
        const std::size_t at = 4 * (v - before) + k % 4;
        const double joint = joints[k / 4].values[at], weight = weights[k / 4].values[at];
        if (!(joint >= 0 && joint <= 65535))
          throw joints[k / 4].node.error("element " + std::to_string(v - before) + " names joint " +
                                         std::to_string(joint) + ", expected 0 to 65535");
        if (!(weight >= 0)) throw weights[k / 4].node.error("element " + std::to_string(v - before) + " is negative");
        mesh.joints[v * influences + k] = static_cast<std::uint16_t>(joint);
        mesh.joint_weights[v * influences + k] = weight;
        sum += weight;
      }
      // They sum to 1 but for rounding; a vertex without any stays with its node.
      for (std::size_t k = 0; sum > 0 && k < influences; ++k) mesh.joint_weights[v * influences + k] /= sum;
    }
  }

  static AffineTransform matrixFrom(const JsonNode& node, const double* m) {  // column-major
    const auto row = [m](int i) { return Vec3{m[i], m[4 + i], m[8 + i]}; };
    for (int c = 0; c < 4; ++c)
      if (std::fabs(m[4 * c + 3] - (c == 3)) > 1e-5)
        throw node.error("has a matrix whose last row is not 0 0 0 1, expected an affine one");
    return {{{row(0), row(1), row(2)}}, {m[12], m[13], m[14]}};
  }

  void readSkin(const JsonNode& node) {
    GltfSkin skin;
    const JsonNode joints = node["joints"];
    for (std::size_t i = 0; i < joints.size(); ++i)
      skin.joints.push_back(index(joints.at(i), gltf_.nodes.size(), "nodes"));
    if (skin.joints.empty()) throw joints.error("is empty, expected nodes");
    skin.inverse_bind.resize(skin.joints.size());
    if (const auto at = node.find("inverseBindMatrices")) {
      const Numbers found = numbers(*at, {"MAT4"});
      if (found.count() < skin.joints.size())
        throw at->error("has " + std::to_string(found.count()) + " matrices for " + std::to_string(skin.joints.size()) +
                        " joints");
      for (std::size_t i = 0; i < skin.joints.size(); ++i)
        skin.inverse_bind[i] = matrixFrom(found.node, &found.values[16 * i]);
    }
    gltf_.skins.push_back(std::move(skin));
  }

  static std::optional<Quaternion> unitQuaternion(const double* q) {  // x y z w
    const double norm = std::sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
    if (!(norm > 1e-12 && std::isfinite(norm))) return std::nullopt;
    return Quaternion{q[3] / norm, q[0] / norm, q[1] / norm, q[2] / norm};
  }

  void readNode(const JsonNode& json, std::size_t self) {
    GltfNode& node = gltf_.nodes[self];
    const auto indexOr = [&](const JsonNode& at, const char* key, std::size_t count) {
      const auto value = at.find(key);
      return value ? index(*value, count, key) : -1;
    };
    node.mesh = indexOr(json, "mesh", gltf_.meshes.size());
    node.skin = indexOr(json, "skin", gltf_.skins.size());
    node.camera = indexOr(json, "camera", gltf_.cameras.size());
    if (const auto extensions = json.find("extensions"))
      if (const auto light = extensions->find("KHR_lights_punctual"))
        node.light = index((*light)["light"], gltf_.lights.size(), "lights");
    if (const auto children = json.find("children"))
      for (std::size_t i = 0; i < children->size(); ++i) {
        GltfNode& child = gltf_.nodes[static_cast<std::size_t>(index(children->at(i), gltf_.nodes.size(), "nodes"))];
        if (child.parent >= 0)
          throw children->at(i).error("is already the child of node " + std::to_string(child.parent));
        child.parent = static_cast<int>(self);
      }
    if (const auto matrix = json.find("matrix")) {
      node.matrix = matrixFrom(*matrix, matrix->numbers(16).data());
    } else {
      if (const auto value = json.find("translation")) node.translation = value->vec3();
      if (const auto value = json.find("scale")) node.scale = value->vec3();
      if (const auto value = json.find("rotation")) {
        const auto unit = unitQuaternion(value->numbers(4).data());
        if (!unit) throw value->error("has length 0, expected a unit quaternion");
        node.rotation = *unit;
      }
    }
    if (node.mesh >= 0) checkMeshNode(json, node);
  }

  void checkMeshNode(const JsonNode& json, GltfNode& node) const {
    const GltfMesh& mesh = gltf_.meshes[static_cast<std::size_t>(node.mesh)];
    node.weights = rest_weights_[static_cast<std::size_t>(node.mesh)];
    if (const auto weights = json.find("weights")) node.weights = weights->numbers(mesh.targets.size());
    if (node.skin < 0) return;
    if (mesh.influences == 0) throw json["skin"].error("has a mesh without JOINTS_0 and WEIGHTS_0");
    const std::size_t joints = gltf_.skins[static_cast<std::size_t>(node.skin)].joints.size();
    const auto influences = static_cast<std::size_t>(mesh.influences);
    for (std::size_t i = 0; i < mesh.joints.size(); ++i)
      if (mesh.joint_weights[i] > 0 && mesh.joints[i] >= joints)
        throw json["skin"].error("vertex " + std::to_string(i / influences) + " of its mesh follows joint " +
                                 std::to_string(mesh.joints[i]) + ", the skin has " + std::to_string(joints));
  }

  void orderNodes() {
    const std::size_t count = gltf_.nodes.size();
    std::vector<std::vector<int>> children(count);
    for (std::size_t i = 0; i < count; ++i) {
      const int parent = gltf_.nodes[i].parent;
      if (parent < 0)
        gltf_.order.push_back(static_cast<int>(i));
      else
        children[static_cast<std::size_t>(parent)].push_back(static_cast<int>(i));
    }
    for (std::size_t k = 0; k < gltf_.order.size(); ++k)
      for (const int child : children[static_cast<std::size_t>(gltf_.order[k])]) gltf_.order.push_back(child);
    if (gltf_.order.size() != count)
      throw root_["nodes"].error("has nodes that are their own descendants; expected a tree");
  }

  void readAnimation(const JsonNode& node) {
    GltfAnimation animation{nameOf(node), {}};
    const JsonNode channels = node["channels"], samplers = node["samplers"];
    std::set<std::pair<int, GltfPath>> driven;
    for (std::size_t i = 0; i < channels.size(); ++i) {
      const JsonNode target = channels.at(i)["target"];
      if (!target.has("node") || target["path"].string() == "pointer") continue;  // an extension's business
      GltfChannel channel;
      channel.node = index(target["node"], gltf_.nodes.size(), "nodes");
      channel.path = static_cast<GltfPath>(target["path"].choice({"translation", "rotation", "scale", "weights"}));
      const GltfNode& moved = gltf_.nodes[static_cast<std::size_t>(channel.node)];
      if (moved.matrix && channel.path != GltfPath::weights)
        throw target["node"].error("has a matrix and cannot be animated; expected translation, rotation, scale");
      if (!driven.insert({channel.node, channel.path}).second) throw target.error("is driven twice by one animation");
      channel.components = channel.path == GltfPath::rotation  ? 4
                           : channel.path == GltfPath::weights ? static_cast<int>(moved.weights.size())
                                                               : 3;
      if (channel.components == 0) throw target["node"].error("has no morph targets whose weights could move");
      const JsonNode sampler =
          samplers.at(static_cast<std::size_t>(index(channels.at(i)["sampler"], samplers.size(), "samplers")));
      readSampler(sampler, channel);
      animation.channels.push_back(std::move(channel));
    }
    gltf_.animations.push_back(std::move(animation));
  }

  void readSampler(const JsonNode& node, GltfChannel& channel) {
    const auto way = node.find("interpolation");
    channel.interpolation = way ? static_cast<GltfInterpolation>(way->choice({"STEP", "LINEAR", "CUBICSPLINE"}))
                                : GltfInterpolation::linear;
    Numbers input = numbers(node["input"], {"SCALAR"});
    channel.times = std::move(input.values);
    if (channel.times.empty()) throw input.node.error("has no times");
    for (std::size_t i = 1; i < channel.times.size(); ++i)
      if (!(channel.times[i] > channel.times[i - 1]))
        throw input.node.error("element " + std::to_string(i) + " is not above the one before it; times must rise");
    const JsonNode output_node = node["output"];
    Numbers output = channel.path == GltfPath::weights    ? numbers(output_node, {"SCALAR"})
                     : channel.path == GltfPath::rotation ? numbers(output_node, {"VEC4"})
                                                          : numbers(output_node, {"VEC3"});
    channel.values = std::move(output.values);
    const std::size_t keys = channel.times.size() * (channel.interpolation == GltfInterpolation::cubic ? 3 : 1);
    const std::size_t expected = keys * static_cast<std::size_t>(channel.components);
    if (channel.values.size() != expected)
      throw output_node.error("holds " + std::to_string(channel.values.size()) + " numbers, expected " +
                              std::to_string(expected) + " for " + std::to_string(channel.times.size()) + " times");
    if (channel.path != GltfPath::rotation) return;
    const std::size_t step = channel.interpolation == GltfInterpolation::cubic ? 12 : 4;
    for (std::size_t i = step == 12 ? 4 : 0; i < channel.values.size(); i += step)
      if (!unitQuaternion(&channel.values[i]))
        throw output_node.error("key " + std::to_string(i / step) + " is a rotation of length 0");
  }

  void readCameras() {
    each("cameras", [&](const JsonNode& node) {
      GltfCamera camera{nameOf(node), node["type"].choice({"perspective", "orthographic"}) == 0, 0};
      camera.yfov = camera.perspective ? node["perspective"]["yfov"].positiveNumber()
                                       : node["orthographic"]["ymag"].positiveNumber();
      if (camera.perspective && !(camera.yfov < 3.14159))
        throw node["perspective"]["yfov"].error("expected an angle below a half turn, in radians");
      gltf_.cameras.push_back(camera);
    });
  }

  void readLights() {
    const auto extensions = root_.find("extensions");
    const auto punctual = extensions ? extensions->find("KHR_lights_punctual") : std::nullopt;
    if (!punctual) return;
    const JsonNode lights = (*punctual)["lights"];
    for (std::size_t i = 0; i < lights.size(); ++i) {
      const JsonNode node = lights.at(i);
      GltfLight light;
      light.name = nameOf(node);
      light.type = node["type"].string();
      if (const auto colour = node.find("color")) light.colour = colour->vec3();
      light.intensity = numberOr(node, "intensity", 1);
      light.ranged = node.has("range");
      gltf_.lights.push_back(light);
    }
  }

  Parts parts_;
  JsonNode root_;
  std::vector<Bytes> buffers_;
  std::vector<std::vector<double>> rest_weights_;  ///< of each mesh: its morph targets' own weights
  std::size_t numbers_left_ = kMostNumbers;
  Gltf gltf_;
};

/// The one candidate that is meant; the list of names makes the message.
int chosen(const std::vector<int>& candidates, const std::vector<std::string>& names, const std::string& asked,
           const std::string& where, const std::string& what) {
  std::string list;
  for (std::size_t i = 0; i < names.size() && i < 16; ++i) list += (i ? ", '" : "'") + names[i] + "'";
  if (names.size() > 16) list += ", .. (" + std::to_string(names.size()) + " in all)";
  if (candidates.size() == 1) return candidates.front();
  if (names.empty()) throw badInput(where, "the glTF has no " + what);
  if (asked.empty()) throw badInput(where, "names no " + what + "; the glTF has " + list);
  if (!candidates.empty())
    throw badInput(where, "'" + asked + "' fits " + std::to_string(candidates.size()) + " of the glTF's " + list +
                              "; rename them apart");
  const std::string near = nearestWord(asked, names);
  throw badInput(where, "found '" + asked + "', expected a " + what + " of the glTF: " + list +
                            (near.empty() ? "" : "; did you mean '" + near + "'?"));
}

/// The node that carries something called `asked`, by the thing's name or else by the node's own.
int carrier(const Gltf& gltf, const std::string& asked, const std::string& where, const std::string& what,
            const std::function<const std::string*(const GltfNode&)>& carried) {
  std::vector<int> by_thing, by_node;
  std::vector<std::string> names;
  for (std::size_t i = 0; i < gltf.nodes.size(); ++i) {
    const std::string* name = carried(gltf.nodes[i]);
    if (!name) continue;
    names.push_back(name->empty() ? gltf.nodes[i].name : *name);
    if (asked.empty() || *name == asked) by_thing.push_back(static_cast<int>(i));
    if (gltf.nodes[i].name == asked) by_node.push_back(static_cast<int>(i));
  }
  // Two nodes may carry one thing; then the node's name tells which is meant.
  return chosen(by_thing.size() != 1 && by_node.size() == 1 ? by_node : by_thing, names, asked, where, what);
}

}  // namespace

const GltfAnimation* Gltf::animation(const std::string& name, const std::string& where) const {
  if (name.empty() && animations.empty()) return nullptr;
  std::vector<int> candidates;
  std::vector<std::string> names;
  for (std::size_t i = 0; i < animations.size(); ++i) {
    names.push_back(animations[i].name);
    if (name.empty() || animations[i].name == name) candidates.push_back(static_cast<int>(i));
  }
  return &animations[static_cast<std::size_t>(chosen(candidates, names, name, where, "animation"))];
}

int Gltf::meshNode(const std::string& name, const std::string& where) const {
  return carrier(*this, name, where, "mesh", [this](const GltfNode& node) {
    return node.mesh < 0 ? nullptr : &meshes[static_cast<std::size_t>(node.mesh)].name;
  });
}
int Gltf::cameraNode(const std::string& name, const std::string& where) const {
  return carrier(*this, name, where, "camera", [this](const GltfNode& node) {
    return node.camera < 0 ? nullptr : &cameras[static_cast<std::size_t>(node.camera)].name;
  });
}
int Gltf::lightNode(const std::string& name, const std::string& where) const {
  return carrier(*this, name, where, "light", [this](const GltfNode& node) {
    return node.light < 0 ? nullptr : &lights[static_cast<std::size_t>(node.light)].name;
  });
}

Gltf readGltf(const std::filesystem::path& file) {
  return Reader(file).read();
}

}  // namespace srf
