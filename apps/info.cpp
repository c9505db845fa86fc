// `srf info`: what a file or folder holds: a field, a capture, a scene, a picture, a mesh. One description is made as
// JSON and printed as it is (--json) or as indented text.
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <limits>
#include <map>
#include <nlohmann/json.hpp>
#include <set>

#include "acquire/camera_import.h"
#include "acquire/capture_drawing.h"
#include "apps/fit_pictures.h"
#include "apps/program.h"
#include "base/error.h"
#include "base/files.h"
#include "base/image_io.h"
#include "base/mesh_io.h"
#include "base/text.h"
#include "field/capture_file.h"
#include "field/reflectance_store.h"
#include "field/srf_folder.h"
#include "model/deformable_model.h"
#include "render/scene.h"

namespace fs = std::filesystem;

namespace srf {
namespace {

Json triple(const Vec3& a) {
  return Json::array({a.x, a.y, a.z});
}

Json lightsInfo(const std::vector<CaptureLight>& lights) {
  static constexpr const char* kKinds[] = {"directional", "point", "captured"};
  Json info;
  info["count"] = lights.size();
  for (const CaptureLight& light : lights) {
    Json& count = info[kKinds[static_cast<int>(light.kind)]];
    count = count.is_null() ? 1 : count.get<int>() + 1;
  }
  return info;
}

std::string sizeText(int width, int height) {
  return std::to_string(width) + " x " + std::to_string(height);
}

Json meshInfo(const AcquisitionMesh& mesh) {
  Json info;
  info["vertices"] = mesh.positions.size();
  info["triangles"] = mesh.triangles.size();
  info["normals"] = !mesh.normals.empty();
  const auto box = mesh.bounds();
  if (!box.empty()) {
    info["min"] = triple(box.min);
    info["max"] = triple(box.max);
    info["diameter"] = box.diameter();
  }
  if (mesh.triangles.empty()) return info;
  const MeshTopology topology = meshTopology(mesh);
  info["closed"] = topology.closed;
  info["manifold"] = topology.manifold;
  info["oriented"] = topology.oriented;
  info["components"] = topology.components;
  info["euler_characteristic"] = topology.euler_characteristic;
  info["area"] = meshArea(mesh);
  if (topology.closed) info["volume"] = meshVolume(mesh);
  return info;
}

// What the stores' compression saved and lost.
Json compressionInfo(const fs::path& folder, const SrfManifest& field) {
  static constexpr const char* kNames[] = {"none", "lossless", "pca"};
  std::set<std::string> used;
  double halves = 0, stored = 0, squares = 0, most = 0, largest = 0;
  std::size_t views = 0;
  for (const StoredView& view : field.views) {
    if (view.file.empty()) continue;
    const ReflectanceStore store(folder / view.file);
    const StoreFidelity& fidelity = store.fidelity();
    used.insert(kNames[std::min<std::size_t>(static_cast<std::size_t>(fidelity.compression), 2)]);
    std::size_t covered = 0;
    for (int y = 0; y < store.coverage().height(); ++y)
      for (int x = 0; x < store.coverage().width(); ++x) covered += store.coverage().at(x, y) > 0;
    halves += static_cast<double>(covered) * 3 * sizeof(std::uint16_t) * store.geometry().light_count;
    stored += static_cast<double>(store.bytesOnDisk());
    squares += fidelity.relative_error * fidelity.relative_error;
    most = std::max(most, fidelity.relative_error), largest = std::max(largest, fidelity.largest_error);
    ++views;
  }
  Json info;
  if (views == 0) return info;
  info["kind"] = used;
  info["ratio_to_halves"] = halves / stored;
  info["relative_error"] = std::sqrt(squares / static_cast<double>(views));
  info["relative_error_of_worst_view"] = most;
  info["largest_error"] = largest;
  return info;
}

/// `pictures`: where those of the fit go; empty: none.
Json srfInfo(const fs::path& folder, const fs::path& pictures) {
  const SrfManifest field = readManifest(folder);
  Json info;
  info["type"] = "srf";
  info["version"] = kSrfVersion;
  info["source"] = field.source;
  info["command"] = field.command;
  info["units"] = field.units;
  info["color_space"] = field.color_space;
  info["unknown_illumination"] = field.unknownIllumination();
  info["lights"] = lightsInfo(field.lights);

  std::set<std::vector<LightId>> light_sets;
  std::uintmax_t bytes = 0;
  std::size_t silhouettes_only = 0;
  Json views = Json::array();
  for (const StoredView& view : field.views) {
    const std::uintmax_t size = view.file.empty() ? 0 : fs::file_size(folder / view.file);
    bytes += size;
    silhouettes_only += view.file.empty();
    if (!view.file.empty()) light_sets.insert(view.lights);
    views.push_back({{"name", view.name},
                     {"size", sizeText(view.camera.lens.width, view.camera.lens.height)},
                     {"lights", view.lights.size()},
                     {"bytes", size},
                     {"iou", view.silhouette_iou}});
  }
  info["views"] = {{"count", field.views.size()},
                   {"silhouette_only", silhouettes_only},
                   {"light_sets", light_sets.size()},
                   {"bytes", bytes},
                   {"compression", compressionInfo(folder, field)},
                   {"each", std::move(views)}};
  for (const StoredFile& shape : field.shapes) {
    info["shapes"][shape.name] = meshInfo(readMesh(folder / shape.file));
    info["shapes"][shape.name]["bytes"] = fs::file_size(folder / shape.file);
  }
  for (const StoredFile& model : field.models)
    info["models"][model.name] = {{"kind", model.kind}, {"bytes", fs::file_size(folder / model.file)}};
  if (!field.active_model.empty()) {
    const DeformableModel model = loadModel(folder, field);
    info["active_model"] = {{"name", field.active_model},
                            {"shape", model.shape},
                            {"points", model.size()},
                            {"triangles", model.triangles.size()},
                            {"positional_error", model.positional_error}};
    const std::optional<ReflectanceFit> fit = loadFit(folder, field, model);
    if (fit) {
      info["fit"] = fitInfo(*fit);
      info["fit"]["bytes"] = fs::file_size(folder / field.fit(field.active_model)->file);
    }
    if (fit && !pictures.empty()) info["fit"]["pictures"] = writeFitPictures(field, model, *fit, pictures);
  }
  if (!pictures.empty() && !info.contains("fit"))
    throw badInput(folder.string(), "has no fitted reflectance model to show; run srf model, or leave --pictures out");
  return info;
}

/// What is asked for besides the words.
struct Wanted {
  fs::path pictures;  ///< folder for those of a field's fit; empty: none
  fs::path drawing;   ///< file for that of a capture; empty: none
  CameraAxes axes = CameraAxes::opencv;
};

Json captureInfo(const Capture& capture, const Wanted& wanted) {
  if (!wanted.drawing.empty()) writeTextFile(wanted.drawing, captureDrawing(capture, wanted.axes));
  Json info;
  info["type"] = "capture";
  info["units"] = capture.units;
  info["color_space"] = capture.color_space;
  info["unknown_illumination"] = capture.unknownIllumination();
  info["lights"] = lightsInfo(capture.lights);
  std::set<std::string> sizes, models;
  std::set<std::vector<LightId>> light_sets;
  std::size_t photos = 0, masks = 0;
  for (const CaptureView& view : capture.views) {
    sizes.insert(sizeText(view.camera.lens.width, view.camera.lens.height));
    models.insert(cameraModelName(view.camera.lens.model));
    photos += view.photos.size();
    masks += !view.mask_file.empty();
    std::vector<LightId> lights;
    for (const Photo& photo : view.photos)
      if (photo.light) lights.push_back(*photo.light);
    if (!lights.empty()) light_sets.insert(lights);
  }
  info["views"] = {{"count", capture.views.size()},
                   {"with_mask", masks},
                   {"light_sets", light_sets.size()},
                   {"sizes", sizes},
                   {"camera_models", models}};
  info["photographs"] = photos;
  if (capture.bounds) info["bounds"] = {{"min", triple(capture.bounds->min)}, {"max", triple(capture.bounds->max)}};
  return info;
}

Json sceneInfo(const fs::path& file, Reporter& reporter) {
  const Scene scene = readScene(file, {}, reporter);
  Json info;
  info["type"] = "scene";
  info["srf"] = scene.srf.string();
  info["output"] = scene.output;
  const auto camera = scene.cameraAt(scene.frames.front());
  info["size"] = sizeText(camera.lens.width, camera.lens.height);
  info["samples"] = scene.samples;
  info["frames"] = {{"count", scene.frames.size()},
                    {"first", scene.frames.front()},
                    {"last", scene.frames.back()},
                    {"fps", scene.fps}};
  const JsonNode root = readJsonFile(file);
  const auto types = [&](const char* key) {
    Json list = Json::array();
    if (const auto node = root.find(key))
      for (std::size_t i = 0; i < node->size(); ++i) list.push_back(node->at(i)["type"].string());
    return list;
  };
  info["deformation"] = types("deformation");
  info["deformation_animated"] = !scene.deformation.constant();
  info["lights"] = types("lights");
  return info;
}

Json channelInfo(const ImageF& image, int channel) {
  double least = std::numeric_limits<double>::infinity(), most = -least, sum = 0;
  std::size_t nan = 0, infinite = 0, finite = 0;
  for (int y = 0; y < image.height(); ++y)
    for (int x = 0; x < image.width(); ++x) {
      const double value = image.at(x, y, channel);
      if (std::isnan(value)) {
        ++nan;
      } else if (std::isinf(value)) {
        ++infinite;
      } else {
        least = std::min(least, value), most = std::max(most, value), sum += value;
        ++finite;
      }
    }
  Json info;
  if (finite > 0) info = {{"min", least}, {"max", most}, {"mean", sum / static_cast<double>(finite)}};
  info["nan"] = nan;
  info["infinite"] = infinite;
  return info;
}

Json imageInfo(const fs::path& file) {
  Json info;
  info["type"] = "image";
  if (file.extension() == ".exr") {
    const auto channels = readExrChannels(file);
    for (const auto& [name, image] : channels) {
      info["size"] = sizeText(image.width(), image.height());
      info["channels"][name] = channelInfo(image, 0);
    }
    for (const auto& [name, value] : readExrAttributes(file)) info["attributes"][name] = value;
    return info;
  }
  const LoadedImage image = readImage(file, Transfer::linear);
  info["size"] = sizeText(image.pixels.width(), image.pixels.height());
  info["bits"] = image.bits;
  static constexpr const char* kNames[] = {"R", "G", "B", "A"};
  for (int c = 0; c < image.pixels.channels(); ++c)
    info["channels"][image.pixels.channels() == 1 ? "Y" : kNames[c]] = channelInfo(image.pixels, c);
  return info;
}

Json describe(const fs::path& path, const Wanted& wanted, Reporter& reporter) {
  if (!fs::exists(path)) throw badInput(path.string(), "does not exist; check the path");
  if (fs::is_directory(path) && !fs::exists(path / "manifest.json"))
    return captureInfo(openCapture(path, reporter), wanted);
  const std::string suffix = path.extension().string();
  if (suffix == ".json") {
    const JsonNode root = readJsonFile(path);
    const auto frames = root.find("frames");
    if (frames && frames->isArray()) return captureInfo(readCapture(path), wanted);
  }
  if (!wanted.drawing.empty())
    throw Error(ErrorKind::usage, path.string() + " is no capture; a drawing is made of its cameras and lights",
                "--drawing");
  if (fs::is_directory(path)) return srfInfo(path, wanted.pictures);
  if (suffix == ".json") return sceneInfo(path, reporter);
  if (suffix == ".ply" || suffix == ".obj") {
    Json info = {{"type", "mesh"}};
    info.update(meshInfo(readMesh(path)));
    return info;
  }
  return imageInfo(path);
}

std::string valueText(const Json& value) {
  if (value.is_string()) return value.get<std::string>();
  if (value.is_array()) {
    std::string text;
    for (const Json& entry : value) text += (text.empty() ? "" : ", ") + valueText(entry);
    return text.empty() ? "none" : text;
  }
  if (value.is_number_float()) return shortNumber(value.get<double>());
  return value.dump();
}

// Objects are indented under their key; a list of objects is one line an entry.
void print(const Json& info, int indent) {
  for (const auto& [key, value] : info.items()) {
    std::printf("%*s", indent, "");
    const bool rows = value.is_array() && !value.empty() && value[0].is_object();
    if (!value.is_object() && !rows) {
      std::printf("%-*s %s\n", 26 - indent, key.c_str(), valueText(value).c_str());
      continue;
    }
    std::printf("%s\n", key.c_str());
    if (!rows) {
      print(value, indent + 2);
      continue;
    }
    for (const Json& row : value) {
      std::printf("%*s", indent + 2, "");
      for (const auto& [name, entry] : row.items()) std::printf("%s %s  ", name.c_str(), valueText(entry).c_str());
      std::printf("\n");
    }
  }
}

}  // namespace
}  // namespace srf

int main(int argc, char** argv) {
  srf::Program program("info",
                       "Says what a file or folder holds: a field (X.srf), a capture, a scene, a picture, a mesh.");
  std::string path;
  srf::Wanted wanted;
  bool as_json = false;
  program.app().add_option("path", path, "file or folder")->required();
  program.app().add_flag("--json", as_json, "print JSON");
  program.app().add_option("--pictures", wanted.pictures,
                           "of a field: folder for pictures of the fitted reflectance model (gate, roughness, normal, "
                           "base_color ..) from the first camera");
  CLI::Option* drawing = program.app().add_option(
      "--drawing", wanted.drawing, "of a capture: SVG file for a drawing of its cameras, lights and box");
  program.app()
      .add_option("--camera-axes", wanted.axes, "that the drawing shows: opencv (y down, z forward) or opengl")
      ->transform(CLI::CheckedTransformer(std::map<std::string, srf::CameraAxes>{{"opencv", srf::CameraAxes::opencv},
                                                                                 {"opengl", srf::CameraAxes::opengl}}))
      ->default_str("opencv")
      ->needs(drawing);
  return program.run(argc, argv, [&](srf::Reporter& reporter) {
    const srf::Json info = srf::describe(path, wanted, reporter);
    if (as_json)
      std::printf("%s\n", info.dump(1, ' ', false, srf::Json::error_handler_t::replace).c_str());
    else
      srf::print(info, 0);
  });
}
