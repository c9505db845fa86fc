#include "apps/field_variants.h"

#include <algorithm>
#include <bit>
#include <cmath>

#include "acquire/acquire_field.h"
#include "acquire/visual_hull.h"
#include "base/files.h"
#include "base/parallel.h"
#include "base/text.h"
#include "field/srf_folder.h"
#include "model/deformable_model.h"
#include "model/reflectance_fit.h"

namespace srf {
namespace {

namespace fs = std::filesystem;

// Planning figures, seconds of one thread: a channel triple of a texel under one light decoded and encoded in all
// levels; a sample of a point's reflectance gathered and fitted.
constexpr double kCodedTexel = 60e-9, kFittedSample = 150e-9;
constexpr int kFewestCells = 16;
constexpr std::size_t kFewestSurfels = 500;

void shareViews(const fs::path& from, const SrfManifest& manifest, const fs::path& to) {
  for (const StoredView& view : manifest.views)
    if (!view.file.empty()) linkOrCopy(from / view.file, to / view.file);
}

void shareFiles(const fs::path& from, const std::vector<StoredFile>& files, const fs::path& to) {
  for (const StoredFile& file : files) linkOrCopy(from / file.file, to / file.file);
}

void recode(const fs::path& from, SrfManifest manifest, const fs::path& to, const StoreCoding& coding,
            Reporter& reporter) {
  shareFiles(from, manifest.shapes, to);
  shareFiles(from, manifest.models, to);
  shareFiles(from, manifest.fits, to);
  Reporter::Stage stage(reporter, "recode views", manifest.views.size());
  parallelFor(manifest.views.size(), 1, [&](std::size_t v, std::size_t) {
    StoredView& view = manifest.views[v];
    if (!view.file.empty()) view.hash = recodeStore(ReflectanceStore(from / view.file), to / view.file, coding);
    stage.advance();
  });
  writeManifest(to, manifest);
}

// The silhouettes that the field holds, whole pictures.
std::vector<SilhouetteView> silhouettesOf(const fs::path& srf_folder, const SrfManifest& manifest) {
  std::vector<SilhouetteView> views;
  for (const StoredView& view : manifest.views) {
    const ReflectanceStore store(srf_folder / view.file);
    const StoreGeometry& geometry = store.geometry();
    Image8 mask(geometry.image_width, geometry.image_height, 1);
    const int right = std::min(mask.width() - geometry.crop_x, geometry.cropWidth());
    const int bottom = std::min(mask.height() - geometry.crop_y, geometry.cropHeight());
    for (int y = std::max(0, -geometry.crop_y); y < bottom; ++y)
      for (int x = std::max(0, -geometry.crop_x); x < right; ++x)
        mask.at(geometry.crop_x + x, geometry.crop_y + y) = store.coverage().at(x, y);
    views.push_back({view.name, view.camera, std::move(mask)});
  }
  return views;
}

// The field with another model in place of its own.
void remodel(const fs::path& from, SrfManifest manifest, const fs::path& to, const FieldVariant& variant,
             std::size_t memory_bytes, Reporter& reporter) {
  const DeformableModel own = loadModel(from, manifest);
  const std::string name = manifest.active_model;
  const bool fitted = manifest.fit(name) != nullptr;
  AcquisitionMesh surface = own.restMesh();
  double positional_error = own.positional_error;
  ModelOptions options{own.kind, own.kind == ModelKind::surfels ? own.size() : 0};
  if (variant.kind == FieldVariant::Kind::hull) {
    HullOptions hull_options;
    hull_options.resolution = variant.hull_cells;
    VisualHull hull = carveVisualHull(silhouettesOf(from, manifest), hull_options, reporter);
    manifest.shapes = {storeHull(hull.mesh, to)};
    surface = std::move(hull.mesh);
    positional_error = 0.5 * hull.cell;
  } else {
    shareFiles(from, manifest.shapes, to);
    options = {ModelKind::surfels, variant.surfels};
  }
  shareViews(from, manifest, to);
  manifest.models.clear(), manifest.fits.clear(), manifest.active_model.clear();
  writeManifest(to, manifest);
  const DeformableModel model = buildModel(surface, own.shape, positional_error, manifest, options, reporter);
  storeModel(to, model, name);
  if (!fitted) return;
  if (const auto fit = fitReflectance(to, readManifest(to), model, {memory_bytes}, reporter)) storeFit(to, *fit, name);
}

// Texels that a block holds, times their lights.
double storedTexels(const fs::path& srf_folder, const SrfManifest& manifest, Compression& compression) {
  double texels = 0;
  for (const StoredView& view : manifest.views) {
    if (view.file.empty()) continue;
    const ReflectanceStore store(srf_folder / view.file);
    compression = std::max(compression, store.fidelity().compression);
    const auto tiles = static_cast<std::uint32_t>(store.geometry().tileCount());
    double stored = 0;
    for (std::uint32_t tile = 0; tile < tiles; ++tile) stored += store.hasTile(tile);
    texels += stored * kTile * kTile * store.geometry().light_count;
  }
  return texels;
}

// Samples of a point's reflectance that a fit takes.
double samplesAPoint(const SrfManifest& manifest, const DeformableModel& model) {
  if (!manifest.fit(manifest.active_model)) return 0;
  std::size_t seen = 0;
  for (const std::uint64_t word : model.visible.words()) seen += static_cast<std::size_t>(std::popcount(word));
  const double views = static_cast<double>(seen) / static_cast<double>(model.size());
  return std::min<double>(views, FitOptions{}.most_views) * static_cast<double>(manifest.lights.size());
}

int cellsOf(const DeformableModel& model) {
  const auto box = model.bounds();
  return static_cast<int>(std::lround(maxComponent(box.max - box.min) / (2 * model.positional_error)));
}

}  // namespace

std::vector<FieldKnob> fieldKnobs(const fs::path& srf_folder, bool keeps_vertices, double seconds, Reporter& reporter) {
  using Kind = FieldVariant::Kind;
  const SrfManifest manifest = readManifest(srf_folder);
  const DeformableModel model = loadModel(srf_folder, manifest);
  Compression compression = Compression::none;
  const double threads = threadCount(), texels = storedTexels(srf_folder, manifest, compression);
  std::vector<FieldKnob> knobs;
  const auto add = [&](FieldKnob knob, double takes) {
    if (knob.variants.empty()) return;
    if (takes > seconds)
      reporter.result(
          format("the knob %s is not turned: making the field anew would take about %.0f s; a longer "
                 "--budget allows it",
                 knob.name.c_str(), takes));
    else
      knobs.push_back(std::move(knob));
  };
  if (compression != Compression::pca) {
    FieldKnob knob{"Compression",
                   "principal components: error allowed",
                   compression == Compression::none ? "none" : "lossless",
                   {}};
    for (const double error : {0.002, 0.005, 0.02})
      knob.variants.push_back(
          {Kind::coding, format("%g %%", 100 * error), format("pca-%g.srf", error), {Compression::pca, error}});
    add(std::move(knob), texels * kCodedTexel / threads);
  }
  const double fit = samplesAPoint(manifest, model) * kFittedSample / threads;
  const bool silhouettes = std::none_of(manifest.views.begin(), manifest.views.end(),
                                        [](const StoredView& view) { return view.file.empty(); });
  if (model.shape == "hull" && model.positional_error > 0 && silhouettes && !keeps_vertices) {
    const int cells = cellsOf(model);
    FieldKnob knob{"Hull", "cells along the object", std::to_string(cells), {}};
    for (int fewer = cells / 2; fewer >= kFewestCells && knob.variants.size() < 3; fewer /= 2)
      knob.variants.push_back({Kind::hull, std::to_string(fewer), format("hull-%d.srf", fewer), {}, fewer});
    add(std::move(knob), static_cast<double>(model.size()) * fit);
  }
  const bool mesh = model.kind == ModelKind::mesh;
  FieldKnob knob{
      "Surfels", mesh ? "surfels in place of triangles" : "surfels", mesh ? "mesh" : std::to_string(model.size()), {}};
  for (std::size_t count = mesh ? model.size() : model.size() / 4; count >= kFewestSurfels && knob.variants.size() < 3;
       count /= 4)
    knob.variants.push_back({Kind::surfels, std::to_string(count), format("surfels-%zu.srf", count), {}, 0, count});
  add(std::move(knob), static_cast<double>(model.size()) * fit);
  return knobs;
}

void makeVariant(const fs::path& srf_folder, const FieldVariant& variant, const fs::path& out, std::size_t memory_bytes,
                 Reporter& reporter) {
  const fs::path part = out.string() + ".part";
  fs::remove_all(part);
  fs::create_directories(part);
  const SrfManifest manifest = readManifest(srf_folder);
  try {
    if (variant.kind == FieldVariant::Kind::coding)
      recode(srf_folder, manifest, part, variant.coding, reporter);
    else
      remodel(srf_folder, manifest, part, variant, memory_bytes, reporter);
  } catch (...) {
    std::error_code code;
    fs::remove_all(part, code);
    throw;
  }
  fs::rename(part, out);
}

}  // namespace srf
