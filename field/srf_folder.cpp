#include "field/srf_folder.h"

#include <signal.h>

#include <algorithm>
#include <cerrno>
#include <nlohmann/json.hpp>
#include <set>

#include "base/files.h"
#include "field/capture_json.h"

namespace srf {
namespace {

namespace fs = std::filesystem;

constexpr const char* kFolders[] = {"views", "shape", "models"};

std::uint64_t readHash(const JsonNode& node) {
  const std::string text = node.string();
  if (text.size() != 16 || text.find_first_not_of("0123456789abcdef") != std::string::npos)
    throw node.error("found '" + text + "', expected 16 hexadecimal digits");
  return std::stoull(text, nullptr, 16);
}

// A file of one of the store's folders: the manifest must not lead anywhere else.
std::string readFileName(const JsonNode& node, const fs::path& folder) {
  const std::string name = node.string();
  const fs::path path(name);
  const bool inside =
      path.has_filename() && path.lexically_normal().generic_string() == name &&
      std::any_of(std::begin(kFolders), std::end(kFolders), [&](const char* f) { return path.parent_path() == f; });
  if (!inside) throw node.error("found '" + name + "', expected a file in views/, shape/ or models/");
  if (!fs::is_regular_file(folder / path))
    throw node.error("names '" + (folder / path).string() + "', which is missing; run the command again that made it");
  return name;
}

std::vector<StoredFile> readFiles(const JsonNode& list, const fs::path& folder) {
  std::vector<StoredFile> files;
  for (std::size_t i = 0; i < list.size(); ++i) {
    const JsonNode node = list.at(i);
    node.onlyKeys({"name", "kind", "file", "hash"});
    files.push_back(
        {node["name"].string(), node["kind"].string(), readFileName(node["file"], folder), readHash(node["hash"])});
    for (std::size_t k = 0; k < i; ++k)
      if (files[k].name == files[i].name) throw node["name"].error("'" + files[i].name + "' is there twice");
  }
  return files;
}

StoredView readView(const JsonNode& node, const fs::path& folder, std::size_t light_count) {
  node.onlyKeys(
      {"name", "file", "hash", "black_background", "silhouette_iou", "lights", SRF_LENS_KEYS, "transform_matrix"});
  StoredView view;
  view.name = node["name"].string();
  view.camera.lens = readLens({node});
  view.camera.pose = readPose(node["transform_matrix"]);
  view.silhouette_iou = node["silhouette_iou"].number();
  const JsonNode lights = node["lights"];
  for (std::size_t i = 0; i < lights.size(); ++i)
    view.lights.push_back({static_cast<std::uint32_t>(lights.at(i).integer(0, static_cast<long>(light_count) - 1))});
  if (lights.size() == 0) return view;
  view.file = readFileName(node["file"], folder);
  view.hash = readHash(node["hash"]);
  view.black_background = node["black_background"].boolean();
  return view;
}

const StoredFile* named(const std::vector<StoredFile>& files, const std::string& name) {
  const auto it = std::find_if(files.begin(), files.end(), [&](const StoredFile& f) { return f.name == name; });
  return it == files.end() ? nullptr : &*it;
}

Json filesJson(const std::vector<StoredFile>& files) {
  Json list = Json::array();
  for (const StoredFile& f : files)
    list.push_back({{"name", f.name}, {"kind", f.kind}, {"file", f.file}, {"hash", hexHash(f.hash)}});
  return list;
}

bool isSrf(const JsonNode& root) {
  return root.has("format") && root["format"].raw() == "srf";
}

// A file that a running program is still writing (PartialFile).
bool isBeingWritten(const std::string& name) {
  const auto at = name.rfind(".part-");
  if (at == std::string::npos) return false;
  const long pid = std::strtol(name.c_str() + at + 6, nullptr, 10);
  return pid > 0 && (::kill(static_cast<pid_t>(pid), 0) == 0 || errno == EPERM);
}

}  // namespace

const StoredFile* SrfManifest::shape(const std::string& name) const {
  return named(shapes, name);
}
const StoredFile* SrfManifest::model(const std::string& name) const {
  return named(models, name);
}
const StoredFile* SrfManifest::fit(const std::string& name) const {
  return named(fits, name);
}

bool isSrfFolder(const fs::path& folder) {
  try {
    return isSrf(readJsonFile(folder / "manifest.json"));
  } catch (const Error&) {
    return false;
  }
}

SrfManifest readManifest(const fs::path& folder) {
  if (!fs::is_directory(folder))
    throw badInput(folder.string(), "is not a folder, expected an SRF; make one with `srf acquire`");
  const JsonNode root = readJsonFile(folder / "manifest.json");
  if (!isSrf(root)) throw root.error("is not an SRF's manifest; expected \"format\": \"srf\"");
  const long version = root["version"].integer(1, 1000000);
  if (version > kSrfVersion)
    throw root["version"].error("is " + std::to_string(version) + ", this program reads up to " +
                                std::to_string(kSrfVersion) + "; use a newer program or run `srf acquire` again");
  root.onlyKeys({"format", "version", "units", "color_space", "source", "command", "lights", "views", "shapes",
                 "models", "fits", "active_model"});
  SrfManifest manifest;
  manifest.units = root["units"].string();
  manifest.color_space = root["color_space"].string();
  manifest.source = root["source"].string();
  manifest.command = root["command"].string();
  const JsonNode lights = root["lights"], views = root["views"];
  std::set<std::string> names;
  for (std::size_t i = 0; i < lights.size(); ++i) {
    manifest.lights.push_back(readLight(lights.at(i)));
    if (!names.insert(manifest.lights.back().name).second) throw lights.at(i)["name"].error("is there twice");
  }
  for (std::size_t i = 0; i < views.size(); ++i)
    manifest.views.push_back(readView(views.at(i), folder, manifest.lights.size()));
  manifest.shapes = readFiles(root["shapes"], folder);
  manifest.models = readFiles(root["models"], folder);
  if (root.has("fits")) manifest.fits = readFiles(root["fits"], folder);
  manifest.active_model = root["active_model"].string();
  if (!manifest.active_model.empty() && !manifest.model(manifest.active_model))
    throw root["active_model"].error("found '" + manifest.active_model + "', which /models does not have");
  return manifest;
}

void writeManifest(const fs::path& folder, const SrfManifest& manifest) {
  Json root;
  root["format"] = "srf";
  root["version"] = kSrfVersion;
  root["units"] = manifest.units;
  root["color_space"] = manifest.color_space;
  root["source"] = manifest.source;
  root["command"] = manifest.command;
  root["lights"] = Json::array();
  for (const CaptureLight& light : manifest.lights) root["lights"].push_back(lightJson(light));
  root["views"] = Json::array();
  for (const StoredView& v : manifest.views) {
    Json view;
    view["name"] = v.name;
    if (!v.file.empty()) {
      view["file"] = v.file;
      view["hash"] = hexHash(v.hash);
      view["black_background"] = v.black_background;
    }
    view["silhouette_iou"] = v.silhouette_iou;
    writeLens(view, v.camera.lens);
    view["transform_matrix"] = poseJson(v.camera.pose);
    view["lights"] = Json::array();
    for (const LightId light : v.lights) view["lights"].push_back(light.value);
    root["views"].push_back(std::move(view));
  }
  root["shapes"] = filesJson(manifest.shapes);
  root["models"] = filesJson(manifest.models);
  if (!manifest.fits.empty()) root["fits"] = filesJson(manifest.fits);
  root["active_model"] = manifest.active_model;
  writeJsonFile(folder / "manifest.json", root);  // the switch

  std::set<fs::path> named;
  for (const StoredView& v : manifest.views) named.insert(folder / v.file);
  for (const auto* list : {&manifest.shapes, &manifest.models, &manifest.fits})
    for (const StoredFile& f : *list) named.insert(folder / f.file);
  for (const char* name : kFolders) {
    std::error_code code;  // what cannot be removed stays behind and harms nothing
    std::vector<fs::path> unnamed;
    for (const auto& entry : fs::directory_iterator(folder / name, code))
      if (!named.contains(entry.path()) && !isBeingWritten(entry.path().filename().string()))
        unnamed.push_back(entry.path());
    for (const fs::path& file : unnamed) fs::remove(file, code);
  }
}

void verifyFile(const fs::path& folder, const StoredFile& entry) {
  const auto bytes = readBinaryFile(folder / entry.file);
  const std::uint64_t hash = contentHash(bytes.data(), bytes.size());
  if (hash != entry.hash)
    throw badInput((folder / entry.file).string(), "has the checksum " + hexHash(hash) + ", the manifest says " +
                                                       hexHash(entry.hash) + "; the file is damaged: make it again");
}

}  // namespace srf
