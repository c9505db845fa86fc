// *.srfmodel: "SRFMODEL", u32 version, u32 bytes of the header, the header (JSON: what the model is, and type,
// components and length of each array), then the arrays one after another, little-endian. The manifest holds the hash
// of the file.

#include <bit>
#include <cstring>
#include <limits>
#include <nlohmann/json.hpp>

#include "base/error.h"
#include "base/files.h"
#include "base/json.h"
#include "model/deformable_model.h"

static_assert(std::endian::native == std::endian::little, "model files are copied to and from memory as they are");

namespace srf {
namespace {

constexpr char kMagic[8] = {'S', 'R', 'F', 'M', 'O', 'D', 'E', 'L'};
constexpr std::uint32_t kVersion = 1;
constexpr std::size_t kPrefix = sizeof kMagic + 2 * sizeof(std::uint32_t);

// One array of the file: `count` values of `bytes` each, in the order in which `visitArrays` names them.
template <class Model, class Visit>
void visitArrays(Model& model, const Visit& visit) {
  static_assert(sizeof(Point<AcquisitionSpace>) == 24 && sizeof(Vec3) == 24 && sizeof(Triangle) == 12);
  visit("p0", model.p0);                               // acquisition space, 3 doubles
  visit("r0", model.r0);                               // Rodrigues vector, 3 doubles
  visit("triangles", model.triangles);                 // of points, 3 u32
  visit("radius", model.radius);                       // float, units
  visit("rest_positions", model.rest_mesh.positions);  // acquisition space, 3 doubles
  visit("rest_triangles", model.rest_mesh.triangles);  // 3 u32
  visit("anchor_triangle", model.anchor_triangle);     // of the rest mesh, u32
  visit("anchor_weights", model.anchor_weights);       // b1 b2, 2 floats
  visit("visible", model.visible.words());             // a row of u64 words for each point, bit = view
}

void checkName(const std::string& name) {
  const bool plain = !name.empty() && name.size() <= 64 &&
                     name.find_first_not_of(
                         "abcdefghijklmnopqrstuvwxyzABCDEFGHIJK"
                         "LMNOPQRSTUVWXYZ0123456789_-") == std::string::npos;
  if (!plain)
    throw Error(ErrorKind::usage, "found '" + name + "', expected letters, digits, _ and - (at most 64)", "--name");
}

// What the parts promise each other: later code indexes without looking.
void checkModel(const DeformableModel& model, const std::string& file) {
  const auto wrong = [&file](const std::string& what) {
    return badInput(file, "the model inside does not fit together: " + what + "; make it again with srf model");
  };
  const std::size_t points = model.size();
  if (points == 0) throw wrong("no points");
  if (points >= std::numeric_limits<std::uint32_t>::max()) throw wrong("too many points");
  if (model.r0.size() != points) throw wrong("r0 and p0 differ in length");
  for (std::size_t i = 0; i < points; ++i)
    if (!isFinite(model.p0[i]) || !isFinite(model.r0[i])) throw wrong("point " + std::to_string(i) + " is not finite");
  const auto check_triangles = [&](const std::vector<Triangle>& triangles, std::size_t vertices) {
    for (const Triangle& t : triangles)
      for (const std::uint32_t corner : t)
        if (corner >= vertices) throw wrong("a triangle names a point that is not there");
  };
  check_triangles(model.triangles, points);
  check_triangles(model.rest_mesh.triangles, model.rest_mesh.positions.size());
  for (const auto& p : model.rest_mesh.positions)
    if (!isFinite(p)) throw wrong("a vertex of the rest mesh is not finite");
  if (model.kind == ModelKind::mesh) {
    if (model.triangles.empty()) throw wrong("no triangles");
    return;
  }
  if (model.radius.size() != points || model.anchor_triangle.size() != points || model.anchor_weights.size() != points)
    throw wrong("the surfels' arrays differ in length");
  for (std::size_t i = 0; i < points; ++i) {
    if (!(model.radius[i] > 0 && std::isfinite(model.radius[i]))) throw wrong("a surfel's radius is not positive");
    if (model.anchor_triangle[i] >= model.rest_mesh.triangles.size()) throw wrong("a surfel has no triangle");
    for (const float b : model.anchor_weights[i])
      if (!(b >= 0 && b <= 1)) throw wrong("a surfel lies beside its triangle");
  }
}

DeformableModel parseModel(const std::vector<std::byte>& bytes, const std::string& file, std::size_t view_count) {
  const auto damaged = [&file](const std::string& what) {
    return badInput(file, what + "; the file is damaged: make it again with srf model");
  };
  if (bytes.size() < kPrefix || std::memcmp(bytes.data(), kMagic, sizeof kMagic) != 0)
    throw damaged("does not begin as a model file does");
  std::uint32_t version, header_bytes;
  std::memcpy(&version, &bytes[sizeof kMagic], sizeof version);
  std::memcpy(&header_bytes, &bytes[sizeof kMagic + sizeof version], sizeof header_bytes);
  if (version != kVersion)
    throw badInput(file, "has version " + std::to_string(version) + ", this program reads version " +
                             std::to_string(kVersion) + "; make the model again with srf model");
  if (header_bytes > bytes.size() - kPrefix) throw damaged("ends within its header");
  const JsonNode header = parseJson(std::string(reinterpret_cast<const char*>(&bytes[kPrefix]), header_bytes), file);

  DeformableModel model;
  model.kind = header["kind"].choice({"mesh", "surfels"}) == 0 ? ModelKind::mesh : ModelKind::surfels;
  model.shape = header["shape"].string();
  model.positional_error = header["positional_error"].number();
  const std::size_t views = static_cast<std::size_t>(header["views"].integer(0, 1 << 20));
  if (views != view_count)
    throw badInput(file, "was made for " + std::to_string(views) + " views, the field has " +
                             std::to_string(view_count) + "; make it again with srf model");
  std::size_t at = kPrefix + header_bytes;
  visitArrays(model, [&](const char* name, auto& array) {
    using Value = typename std::remove_reference_t<decltype(array)>::value_type;
    const auto count = static_cast<std::size_t>(header["arrays"][name].integer(0, std::numeric_limits<long>::max()));
    if (count > (bytes.size() - at) / sizeof(Value)) throw damaged("ends within '" + std::string(name) + "'");
    array.resize(count);
    if (count > 0) std::memcpy(static_cast<void*>(array.data()), &bytes[at], count * sizeof(Value));
    at += count * sizeof(Value);
  });
  if (at != bytes.size()) throw damaged("has " + std::to_string(bytes.size() - at) + " bytes too many");
  VisibilityBits visible(model.size(), views);
  if (model.visible.words().size() != visible.words().size()) throw damaged("'visible' has the wrong length");
  visible.words() = std::move(model.visible.words());
  model.visible = std::move(visible);
  if (views % 64 != 0)
    for (std::size_t i = 0; i < model.size(); ++i)
      if (model.visible.row(i)[views / 64] >> (views % 64) != 0)
        throw damaged("'visible' names views that are not there");
  checkModel(model, file);
  return model;
}

}  // namespace

void storeModel(const std::filesystem::path& srf_folder, const DeformableModel& model, const std::string& name) {
  checkName(name);
  SrfManifest manifest = readManifest(srf_folder);
  Json header;
  header["kind"] = model.kind == ModelKind::mesh ? "mesh" : "surfels";
  header["shape"] = model.shape;
  header["positional_error"] = model.positional_error;
  header["views"] = model.visible.views();
  visitArrays(model, [&](const char* array_name, const auto& array) { header["arrays"][array_name] = array.size(); });
  const std::string text = header.dump(-1, ' ', false, Json::error_handler_t::replace);

  std::vector<std::byte> bytes;
  const auto append = [&bytes](const void* data, std::size_t size) {
    const auto* from = static_cast<const std::byte*>(data);
    bytes.insert(bytes.end(), from, from + size);
  };
  const auto header_bytes = static_cast<std::uint32_t>(text.size());
  append(kMagic, sizeof kMagic);
  append(&kVersion, sizeof kVersion);
  append(&header_bytes, sizeof header_bytes);
  append(text.data(), text.size());
  visitArrays(model, [&](const char*, const auto& array) { append(array.data(), array.size() * sizeof array[0]); });

  StoredFile entry;
  entry.name = name;
  entry.kind = header["kind"].get<std::string>();
  entry.hash = contentHash(bytes.data(), bytes.size());
  entry.file = "models/" + name + "-" + hexHash(entry.hash) + ".srfmodel";
  writeBinaryFile(srf_folder / entry.file, bytes.data(), bytes.size());
  std::erase_if(manifest.models, [&name](const StoredFile& other) { return other.name == name; });
  manifest.models.push_back(entry);
  // What was fitted to the points of the one before holds no more.
  std::erase_if(manifest.fits, [&name](const StoredFile& fit) { return fit.name == name; });
  manifest.active_model = name;
  writeManifest(srf_folder, manifest);
}

DeformableModel loadModel(const std::filesystem::path& srf_folder, const SrfManifest& manifest) {
  if (manifest.active_model.empty())
    throw badInput(srf_folder.string(), "has no model; make one with: srf model " + srf_folder.string());
  const StoredFile* entry = manifest.model(manifest.active_model);
  if (!entry)
    throw badInput((srf_folder / "manifest.json").string(), "names the active model '" + manifest.active_model +
                                                                "' but has no such model; make one with srf model");
  const std::filesystem::path file = srf_folder / entry->file;
  const std::vector<std::byte> bytes = readBinaryFile(file);
  if (contentHash(bytes.data(), bytes.size()) != entry->hash)
    throw badInput(file.string(),
                   "is damaged: its content is not what the manifest says; make it again with srf model");
  return parseModel(bytes, file.string(), manifest.views.size());
}

}  // namespace srf
