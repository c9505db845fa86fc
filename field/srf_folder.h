// X.srf: a folder of immutable store files (views/, shape/, models/) and one manifest.json. A file is written beside
// and renamed; replacing the manifest by rename is the only switch, so an interrupted run leaves the old state whole.
#pragma once

#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "field/capture.h"

namespace srf {

inline constexpr int kSrfVersion = 1;

struct StoredView {
  std::string name;
  Camera<AcquisitionSpace> camera;
  std::vector<LightId> lights;   ///< light k of the store's texels is lights[k]
  std::string file;              ///< relative to the folder; empty: the view gave its silhouette alone
  std::uint64_t hash = 0;        ///< ReflectanceStore::contentHash
  bool black_background = true;  ///< pixels are premultiplied by coverage; else only taps of coverage >= 0.98 are used
  double silhouette_iou = 0;  ///< agreement of the hull's silhouette with this view's, 0..1; 0 where no hull was made
};

struct StoredFile {
  std::string name;        ///< e.g. "hull", or a model's name
  std::string kind;        ///< "shape", "mesh", "surfels", "fit"
  std::string file;        ///< relative to the folder
  std::uint64_t hash = 0;  ///< contentHash of the file's bytes
};

struct SrfManifest {
  std::string units = "m";
  std::string color_space = "lin_rec709";
  std::vector<CaptureLight> lights;
  std::vector<StoredView> views;
  std::vector<StoredFile> shapes;  ///< "hull" where acquire carved one
  std::vector<StoredFile> models;
  std::vector<StoredFile> fits;  ///< kind "fit": reflectance fitted to the points of the model of the same name
  std::string active_model;      ///< the one `srf render` uses; empty before `srf model`
  std::string source;            ///< the capture's folder name, for people
  std::string command;           ///< what made the field

  bool unknownIllumination() const { return lights.size() == 1 && lights[0].kind == LightKind::captured; }
  const StoredFile* shape(const std::string& name) const;
  const StoredFile* model(const std::string& name) const;
  const StoredFile* fit(const std::string& name) const;
};

/// Whether the folder has the manifest of an SRF, of any version.
bool isSrfFolder(const std::filesystem::path& folder);
/// Reads and validates X.srf/manifest.json (version, keys, files present). Throws bad_input.
SrfManifest readManifest(const std::filesystem::path& srf_folder);
/// Replaces the manifest, then removes store files that no manifest entry names any more.
void writeManifest(const std::filesystem::path& srf_folder, const SrfManifest& manifest);
/// Throws bad_input where the bytes of an entry do not have the hash that the manifest gives.
void verifyFile(const std::filesystem::path& srf_folder, const StoredFile& entry);

}  // namespace srf
