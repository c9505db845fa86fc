#include "base/mesh_io.h"

#include <algorithm>
#include <bit>
#include <cctype>
#include <charconv>
#include <cmath>
#include <cstring>
#include <limits>
#include <optional>
#include <string_view>

#include "base/check.h"
#include "base/error.h"
#include "base/files.h"

namespace srf {
namespace {

using Normal = Vector<AcquisitionSpace>;
constexpr std::size_t kMostVertices = 0xfffffffe;

// Directions from what a file gave: all or nothing, except that a mesh mends single useless ones from its triangles.
void setNormals(AcquisitionMesh& mesh, const std::vector<Normal>& raw) {
  if (raw.size() != mesh.positions.size()) return;
  std::vector<Direction<AcquisitionSpace>> normals(raw.size()), from_triangles;
  for (std::size_t i = 0; i < raw.size(); ++i) {
    auto normal = normalize(raw[i]);
    if (!normal) {
      if (mesh.triangles.empty()) return;
      if (from_triangles.empty()) from_triangles = vertexNormals(mesh);
      normal = from_triangles[i];
    }
    normals[i] = *normal;
  }
  mesh.normals = std::move(normals);
}

std::string_view nextToken(std::string_view& text) {
  constexpr std::string_view kSpace = " \t\r\n\v\f";
  text.remove_prefix(std::min(text.find_first_not_of(kSpace), text.size()));
  const std::string_view token = text.substr(0, std::min(text.find_first_of(kSpace), text.size()));
  text.remove_prefix(token.size());
  return token;
}

template <class Number>
std::optional<Number> parse(std::string_view token) {
  if (!token.empty() && token[0] == '+') token.remove_prefix(1);
  Number value{};
  const auto [end, code] = std::from_chars(token.data(), token.data() + token.size(), value);
  if (code != std::errc() || end != token.data() + token.size()) return std::nullopt;
  return value;
}

// --- PLY ---------------------------------------------------------------------------------------------------------

enum class PlyType { int8, uint8, int16, uint16, int32, uint32, float32, float64 };

struct PlyProperty {
  std::string name;
  PlyType type;
  std::optional<PlyType> count_type;  // set: a list
};
struct PlyElement {
  std::string name;
  std::uint64_t count;
  std::vector<PlyProperty> properties;
};

std::optional<PlyType> plyType(std::string_view name) {
  constexpr std::pair<std::string_view, PlyType> kNames[] = {
      {"char", PlyType::int8},      {"int8", PlyType::int8},       {"uchar", PlyType::uint8},
      {"uint8", PlyType::uint8},    {"short", PlyType::int16},     {"int16", PlyType::int16},
      {"ushort", PlyType::uint16},  {"uint16", PlyType::uint16},   {"int", PlyType::int32},
      {"int32", PlyType::int32},    {"uint", PlyType::uint32},     {"uint32", PlyType::uint32},
      {"float", PlyType::float32},  {"float32", PlyType::float32}, {"double", PlyType::float64},
      {"float64", PlyType::float64}};
  for (const auto& [text, type] : kNames)
    if (text == name) return type;
  return std::nullopt;
}

class PlyReader {
 public:
  PlyReader(const std::filesystem::path& file, std::string_view content) : file_(file.string()), rest_(content) {}

  AcquisitionMesh read() {
    readHeader();
    AcquisitionMesh mesh;
    bool has_vertices = false;
    for (const PlyElement& element : elements_) {
      // Every row takes at least a byte, so that a count cannot ask for more memory than the file is long.
      if (!element.properties.empty() && element.count > rest_.size())
        throw badInput(file_, "the header promises " + std::to_string(element.count) + " rows of \"" + element.name +
                                  "\" but only " + std::to_string(rest_.size()) +
                                  " bytes are left; the file is cut off");
      if (element.name == "vertex" && !has_vertices) {
        has_vertices = true;
        readVertices(element, mesh);
      } else if (element.name == "face" || element.name == "tristrips") {
        readFaces(element, mesh);
      } else if (element.name == "camera" && element.count == 1) {
        readSensor(element);
      } else if (!element.properties.empty()) {
        readRows(
            element, [](std::size_t, double) {}, [] {});
      }
    }
    if (!has_vertices) throw badInput(file_, "has no element \"vertex\"; expected a mesh or a point cloud");
    for (const Triangle& t : mesh.triangles)
      for (const std::uint32_t v : t)
        if (v >= mesh.positions.size())
          throw badInput(file_, "a face names vertex " + std::to_string(v) + " of " +
                                    std::to_string(mesh.positions.size()) + " (the first is 0)");
    setNormals(mesh, normals_);
    return mesh;
  }
  const std::optional<Point<AcquisitionSpace>>& sensor() const { return sensor_; }

 private:
  void readSensor(const PlyElement& element) {
    constexpr std::string_view kNames[3] = {"view_px", "view_py", "view_pz"};
    double values[3] = {NAN, NAN, NAN};
    readRows(
        element,
        [&](std::size_t k, double v) {
          for (int i = 0; i < 3; ++i)
            if (element.properties[k].name == kNames[i]) values[i] = v;
        },
        [] {});
    const Point<AcquisitionSpace> place(values[0], values[1], values[2]);
    if (isFinite(place)) sensor_ = place;
  }

  void readHeader() {
    bool has_format = false;
    nextLine();  // "ply"
    for (int number = 2;; ++number) {
      const auto fail = [&](const std::string& what) {
        return badInput(file_ + " line " + std::to_string(number), what);
      };
      if (rest_.empty()) throw fail("the PLY header does not end (\"end_header\" is missing)");
      std::string_view line = nextLine();
      const std::string_view all = line, key = nextToken(line);
      if (key == "end_header") break;
      if (key == "format") {
        const std::string_view format = nextToken(line);
        if (format != "ascii" && format != "binary_little_endian" && format != "binary_big_endian")
          throw fail("unknown PLY format \"" + std::string(format.substr(0, 40)) + "\"");
        ascii_ = format == "ascii";
        swap_ = !ascii_ && (format == "binary_big_endian") == (std::endian::native == std::endian::little);
        has_format = true;
      } else if (key == "element") {
        const std::string_view name = nextToken(line);
        const auto count = parse<std::uint64_t>(nextToken(line));
        if (name.empty() || !count) throw fail("expected \"element <name> <count>\"");
        elements_.push_back({std::string(name), *count, {}});
      } else if (key == "property") {
        std::string_view type = nextToken(line);
        PlyProperty property{};
        if (type == "list") {
          property.count_type = plyType(nextToken(line));
          if (!property.count_type) throw fail("expected \"property list <type> <type> <name>\"");
          type = nextToken(line);
        }
        const auto value_type = plyType(type);
        property.name = nextToken(line);
        if (!value_type || property.name.empty()) throw fail("expected \"property <type> <name>\" with a type of PLY");
        if (elements_.empty()) throw fail("a property stands before the first element");
        property.type = *value_type;
        elements_.back().properties.push_back(property);
      } else if (key != "comment" && key != "obj_info" && !key.empty()) {
        throw fail("unknown PLY header line \"" + std::string(all.substr(0, 40)) + "\"");
      }
    }
    if (!has_format) throw badInput(file_, "the PLY header has no \"format\" line");
  }

  std::string_view nextLine() {
    const std::size_t end = rest_.find('\n');
    std::string_view line = rest_.substr(0, end);
    rest_.remove_prefix(end == std::string_view::npos ? rest_.size() : end + 1);
    if (!line.empty() && line.back() == '\r') line.remove_suffix(1);
    return line;
  }

  template <class T>
  double binary() {
    char bytes[sizeof(T)];
    if (rest_.size() < sizeof(T)) throw cutOff();
    std::memcpy(bytes, rest_.data(), sizeof(T));
    rest_.remove_prefix(sizeof(T));
    if (swap_) std::reverse(std::begin(bytes), std::end(bytes));
    T value;
    std::memcpy(&value, bytes, sizeof(T));
    return static_cast<double>(value);
  }

  double number(PlyType type) {
    if (ascii_) {
      const std::string_view token = nextToken(rest_);
      if (token.empty()) throw cutOff();
      const auto value = parse<double>(token);
      if (!value) throw badInput(place(), "found \"" + std::string(token.substr(0, 40)) + "\", expected a number");
      return *value;
    }
    switch (type) {
      case PlyType::int8:
        return binary<std::int8_t>();
      case PlyType::uint8:
        return binary<std::uint8_t>();
      case PlyType::int16:
        return binary<std::int16_t>();
      case PlyType::uint16:
        return binary<std::uint16_t>();
      case PlyType::int32:
        return binary<std::int32_t>();
      case PlyType::uint32:
        return binary<std::uint32_t>();
      case PlyType::float32:
        return binary<float>();
      case PlyType::float64:
        return binary<double>();
    }
    return 0;
  }

  // Passes each number of each row with the index of its property, then calls row_done().
  template <class Value, class RowDone>
  void readRows(const PlyElement& element, const Value& value, const RowDone& row_done) {
    element_ = &element;
    for (row_ = 0; row_ < element.count; ++row_) {
      for (std::size_t k = 0; k < element.properties.size(); ++k) {
        const PlyProperty& property = element.properties[k];
        if (!property.count_type) {
          value(k, number(property.type));
          continue;
        }
        const double count = number(*property.count_type);
        if (!(count >= 0) || count != std::floor(count))
          throw badInput(place(), "a list of " + std::to_string(count) + " entries");
        for (double i = 0; i < count; ++i) value(k, number(property.type));
      }
      row_done();
    }
  }

  void readVertices(const PlyElement& element, AcquisitionMesh& mesh) {
    constexpr std::string_view kNames[6] = {"x", "y", "z", "nx", "ny", "nz"};
    if (element.count > kMostVertices) throw badInput(file_, "has more vertices than 2^32 - 2");
    std::vector<int> slot_of(element.properties.size(), -1);
    bool found[6] = {};
    for (std::size_t k = 0; k < slot_of.size(); ++k)
      for (int slot = 0; slot < 6; ++slot)
        if (element.properties[k].name == kNames[slot] && !element.properties[k].count_type && !found[slot])
          slot_of[k] = slot, found[slot] = true;
    if (!found[0] || !found[1] || !found[2]) throw badInput(file_, "the vertices have no properties x, y, z");
    const bool has_normals = found[3] && found[4] && found[5];
    double values[6] = {};
    readRows(
        element,
        [&](std::size_t k, double v) {
          if (slot_of[k] >= 0) values[slot_of[k]] = v;
        },
        [&] {
          mesh.positions.emplace_back(values[0], values[1], values[2]);
          if (has_normals) normals_.emplace_back(values[3], values[4], values[5]);
        });
  }

  // Polygons are fanned from their first corner. "tristrips" are strips with -1 between them, every second triangle
  // turned (the Stanford and Cyberware scans).
  void readFaces(const PlyElement& element, AcquisitionMesh& mesh) {
    std::size_t list = element.properties.size();
    for (std::size_t k = 0; k < element.properties.size(); ++k)
      if (element.properties[k].count_type &&
          (element.properties[k].name == "vertex_indices" || element.properties[k].name == "vertex_index"))
        list = k;
    if (list == element.properties.size() && element.count > 0)
      throw badInput(file_, "the faces have no list \"vertex_indices\"");
    const bool strips = element.name == "tristrips";
    std::vector<std::uint32_t> corners;
    const auto finishStrip = [&] {
      for (std::size_t i = 2; i < corners.size(); ++i) {
        const std::uint32_t a = corners[i - 2], b = corners[i - 1], c = corners[i];
        mesh.triangles.push_back(i % 2 == 0 ? Triangle{a, b, c} : Triangle{b, a, c});
      }
      corners.clear();
    };
    readRows(
        element,
        [&](std::size_t k, double v) {
          if (k != list) return;
          if (strips && v == -1) return finishStrip();
          if (!(v >= 0 && v <= kMostVertices) || v != std::floor(v))
            throw badInput(place(), "names vertex " + std::to_string(v) + " (the first is 0)");
          corners.push_back(static_cast<std::uint32_t>(v));
        },
        [&] {
          if (strips) return finishStrip();
          for (std::size_t i = 2; i < corners.size(); ++i)
            mesh.triangles.push_back({corners[0], corners[i - 1], corners[i]});
          corners.clear();
        });
  }

  std::string place() const { return file_ + " " + element_->name + " " + std::to_string(row_); }
  Error cutOff() const {
    return badInput(place(), "the file ends here, the header promises " + std::to_string(element_->count) +
                                 " of them; copy or export it again");
  }

  std::string file_;
  std::string_view rest_;
  bool ascii_ = true, swap_ = false;
  std::vector<PlyElement> elements_;
  std::vector<Normal> normals_;
  const PlyElement* element_ = nullptr;
  std::uint64_t row_ = 0;
  std::optional<Point<AcquisitionSpace>> sensor_;
};

// --- OBJ ---------------------------------------------------------------------------------------------------------

// The vertices keep the file's order and number (mesh sequences rely on it): where the corners of a vertex name
// different normals, it gets their mean.
class ObjReader {
 public:
  ObjReader(const std::filesystem::path& file, std::string_view content) : file_(file.string()), rest_(content) {}

  AcquisitionMesh read() {
    while (!rest_.empty()) {
      const std::size_t end = rest_.find('\n');
      const std::string_view line = rest_.substr(0, end);
      rest_.remove_prefix(end == std::string_view::npos ? rest_.size() : end + 1);
      ++line_;
      readLine(line.substr(0, line.find('#')));
    }
    if (mesh_.positions.empty()) throw badInput(file_, "has no vertices (lines \"v x y z\")");
    // A normal per corner was given for every face: sum them at their vertices. Without faces they go by order.
    if (mesh_.triangles.empty()) {
      setNormals(mesh_, normals_);
    } else if (all_corners_have_normals_) {
      std::vector<Normal> sums(mesh_.positions.size());
      for (const auto& [vertex, normal] : corner_normals_)
        if (const auto unit = normalize(normals_[normal])) sums[vertex] += *unit;
      setNormals(mesh_, sums);
    }
    return std::move(mesh_);
  }

 private:
  void readLine(std::string_view line) {
    const std::string_view key = nextToken(line);
    if (key == "v" || key == "vn") {
      double xyz[3];
      for (double& value : xyz) {
        const auto parsed = parse<double>(nextToken(line));
        if (!parsed) throw fail("expected \"" + std::string(key) + " x y z\"");
        value = *parsed;
      }
      if (key == "v")
        mesh_.positions.emplace_back(xyz[0], xyz[1], xyz[2]);
      else
        normals_.emplace_back(xyz[0], xyz[1], xyz[2]);
      if (mesh_.positions.size() > kMostVertices) throw fail("more vertices than 2^32 - 2");
    } else if (key == "f") {
      readFace(line);
    }
  }

  void readFace(std::string_view line) {
    std::vector<std::uint32_t> corners;
    for (std::string_view token = nextToken(line); !token.empty(); token = nextToken(line)) {
      const std::size_t slash = token.find('/');
      corners.push_back(index(token.substr(0, slash), mesh_.positions.size(), "vertex"));
      const std::size_t second = slash == token.npos ? token.npos : token.find('/', slash + 1);
      if (second == token.npos || second + 1 == token.size())
        all_corners_have_normals_ = false;
      else
        corner_normals_.emplace_back(corners.back(), index(token.substr(second + 1), normals_.size(), "normal"));
    }
    if (corners.size() < 3) throw fail("a face of " + std::to_string(corners.size()) + " corners, expected 3 or more");
    for (std::size_t i = 2; i < corners.size(); ++i)
      mesh_.triangles.push_back({corners[0], corners[i - 1], corners[i]});
  }

  // From 1 on, or backwards from the latest one with -1.
  std::uint32_t index(std::string_view token, std::size_t count, const char* what) const {
    const auto value = parse<std::int64_t>(token);
    const auto limit = static_cast<std::int64_t>(count);
    if (!value || *value == 0 || *value > limit || *value < -limit)
      throw fail("a face names " + std::string(what) + " \"" + std::string(token.substr(0, 40)) + "\", of " +
                 std::to_string(count) + " given so far (the first is 1)");
    return static_cast<std::uint32_t>(*value > 0 ? *value - 1 : limit + *value);
  }

  Error fail(const std::string& what) const { return badInput(file_ + " line " + std::to_string(line_), what); }

  std::string file_;
  std::string_view rest_;
  std::size_t line_ = 0;
  AcquisitionMesh mesh_;
  std::vector<Normal> normals_;
  std::vector<std::pair<std::uint32_t, std::uint32_t>> corner_normals_;  // vertex, normal
  bool all_corners_have_normals_ = true;
};

void put(std::vector<char>& bytes, const void* value, std::size_t size) {
  bytes.insert(bytes.end(), static_cast<const char*>(value), static_cast<const char*>(value) + size);
}

}  // namespace

AcquisitionMesh readMesh(const std::filesystem::path& file) {
  const std::string content = readTextFile(file);
  if (content.starts_with("ply\n") || content.starts_with("ply\r")) return PlyReader(file, content).read();
  std::string extension = file.extension().string();
  for (char& c : extension) c = static_cast<char>(std::tolower(static_cast<unsigned char>(c)));
  if (extension == ".obj") return ObjReader(file, content).read();
  if (extension == ".ply") throw badInput(file.string(), "does not begin with \"ply\"; it is damaged or no PLY file");
  throw badInput(file.string(), "is no mesh that is read here; expected a PLY or an OBJ file");
}

RangeView readRangeView(const std::filesystem::path& file) {
  const std::string content = readTextFile(file);
  if (!content.starts_with("ply\n") && !content.starts_with("ply\r")) return {readMesh(file), std::nullopt};
  PlyReader reader(file, content);
  RangeView view{reader.read(), std::nullopt};
  view.sensor = reader.sensor();
  return view;
}

void writeRangeView(const std::filesystem::path& file, const RangeView& view) {
  std::string header = "ply\nformat binary_little_endian 1.0\nelement vertex " +
                       std::to_string(view.points.positions.size()) +
                       "\nproperty double x\nproperty double y\nproperty double z\n";
  if (view.sensor)
    header += "element camera 1\nproperty double view_px\nproperty double view_py\nproperty double view_pz\n";
  header += "end_header\n";
  std::vector<char> bytes(header.begin(), header.end());
  std::vector<Point<AcquisitionSpace>> all = view.points.positions;
  if (view.sensor) all.push_back(*view.sensor);
  for (const auto& p : all) put(bytes, &p.raw(), 3 * sizeof(double));
  PartialFile out(file);
  out.write(bytes.data(), bytes.size());
  out.commit();
}

void writePly(const std::filesystem::path& file, const AcquisitionMesh& mesh, const PlyColumns& extra) {
  static_assert(std::endian::native == std::endian::little);
  const bool has_normals = !mesh.normals.empty();
  SRF_CHECK(!has_normals || mesh.normals.size() == mesh.positions.size());
  std::string header = "ply\nformat binary_little_endian 1.0\nelement vertex " + std::to_string(mesh.positions.size()) +
                       "\nproperty double x\nproperty double y\nproperty double z\n";
  if (has_normals) header += "property float nx\nproperty float ny\nproperty float nz\n";
  for (const auto& [name, column] : extra) {
    SRF_CHECK(column.size() == mesh.positions.size());
    header += "property float " + name + "\n";
  }
  if (!mesh.triangles.empty())
    header += "element face " + std::to_string(mesh.triangles.size()) + "\nproperty list uchar int vertex_indices\n";
  header += "end_header\n";

  std::vector<char> bytes(header.begin(), header.end());
  bytes.reserve(header.size() + mesh.positions.size() * (36 + 4 * extra.size()) + mesh.triangles.size() * 13);
  for (std::size_t i = 0; i < mesh.positions.size(); ++i) {
    const Vec3 p = mesh.positions[i].raw();
    for (int k = 0; k < 3; ++k) {
      const double value = p[k];
      put(bytes, &value, sizeof value);
    }
    for (int k = 0; has_normals && k < 3; ++k) {
      const float value = static_cast<float>(mesh.normals[i].raw()[k]);
      put(bytes, &value, sizeof value);
    }
    for (const auto& [name, column] : extra) put(bytes, &column[i], sizeof(float));
  }
  for (const Triangle& t : mesh.triangles) {
    bytes.push_back(3);
    put(bytes, t.data(), sizeof t);
  }
  PartialFile out(file);
  out.write(bytes.data(), bytes.size());
  out.commit();
}

}  // namespace srf
