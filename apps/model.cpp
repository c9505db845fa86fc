// `srf model`: makes the model inside an SRF, from its hull, a file or a parametric shape (M5, M7, M9).
#include <bit>
#include <cstdio>

#include "apps/make_model.h"
#include "apps/program.h"
#include "base/error.h"
#include "model/fit_export.h"
#include "model/gltf_export.h"
#include "model/surfel_file.h"

namespace srf {
namespace {

void printSummary(const DeformableModel& model) {
  std::size_t seen = 0, unseen = 0;
  for (std::size_t i = 0; i < model.size(); ++i) {
    std::size_t views = 0;
    for (std::size_t w = 0; w < model.visible.wordsPerPoint(); ++w) views += std::popcount(model.visible.row(i)[w]);
    seen += views;
    unseen += views == 0;
  }
  const double points = static_cast<double>(model.size());
  if (model.kind == ModelKind::mesh) {
    std::printf("mesh of %s: %zu points, %zu triangles\n", model.shape.c_str(), model.size(), model.triangles.size());
  } else {
    std::printf("surfels of %s: %zu points, radius %.4g\n", model.shape.c_str(), model.size(), model.radius.front());
  }
  std::printf("surface within %.3g of the object, diameter %.4g\n", model.positional_error, model.bounds().diameter());
  std::printf("a point is seen by %.1f of %zu views on average; %zu points (%.2f %%) by none\n",
              static_cast<double>(seen) / points, model.visible.views(), unseen,
              100 * static_cast<double>(unseen) / points);
}

}  // namespace
}  // namespace srf

int main(int argc, char** argv) {
  using namespace srf;
  Program program("model", "Makes the model inside an SRF", "GPL-3.0-or-later (links CGAL)");
  std::string srf_folder, kind = "mesh", shape = "hull", name, fit = "auto", export_file, surfel_file, parameter_file;
  ModelOptions options;
  CLI::App& app = program.app();
  app.add_option("SRF", srf_folder, "the field, X.srf")->required();
  app.add_option("--kind", kind, "mesh (triangles) or surfels (elliptical splats)")
      ->check(CLI::IsMember({"mesh", "surfels"}))
      ->capture_default_str();
  app.add_option(
         "--shape", shape,
         "hull, a PLY, OBJ or glTF file (mesh or points), a folder of range views (PLY), sphere, box, cylinder, plane "
         "or torus")
      ->capture_default_str();
  app.add_option("--surfels", options.surfels, "about how many surfels; 0: one pixel each, 20000 to 400000")
      ->capture_default_str();
  app.add_option("--visibility-bias", options.visibility_bias,
                 "nearest occluder that hides a point from a view, in parts of the object's diameter")
      ->check(CLI::Range(0.0, 1.0))
      ->capture_default_str();
  app.add_option("--name", name, "name of the model in the field; default: its kind");
  app.add_option("--fit", fit, "auto: fits a reflectance model that guides interpolation, where lights are known; off")
      ->check(CLI::IsMember({"auto", "off"}))
      ->capture_default_str();
  app.add_option(
      "--export", export_file,
      "write the rest mesh, to be rigged elsewhere and to come back as a skin: FILE.glb or FILE.ply; with no "
      "other option, that of the model which is there");
  app.add_option("--export-surfels", surfel_file,
                 "write the surfels as a point cloud, FILE.ply, with normals and radii; with no other option, those of "
                 "the model which is there");
  app.add_option(
      "--export-parameters", parameter_file,
      "write the fitted reflectance of every point, FILE.ply (columns) or FILE.glb (material); with no other "
      "option, that of the model which is there");
  return program.run(argc, argv, [&](Reporter& reporter) {
    options.kind = kind == "mesh" ? ModelKind::mesh : ModelKind::surfels;
    const bool asked = app.count("--kind") + app.count("--shape") + app.count("--surfels") +
                           app.count("--visibility-bias") + app.count("--name") + app.count("--fit") >
                       0;
    std::optional<FitOptions> fitting;
    if (fit == "auto") fitting = FitOptions{program.memoryBudget()};
    const DeformableModel model = (export_file.empty() && surfel_file.empty() && parameter_file.empty()) || asked
                                      ? makeModel(srf_folder, shape, options, fitting, reporter, name)
                                      : loadModel(srf_folder, readManifest(srf_folder));
    printSummary(model);
    if (!export_file.empty()) exportRestMesh(model.restMesh(), export_file);
    if (!surfel_file.empty()) writeSurfels(surfel_file, model);
    if (!parameter_file.empty()) {
      const auto fit = loadFit(srf_folder, readManifest(srf_folder), model);
      if (!fit)
        throw badInput(srf_folder, "has no fitted reflectance model to export (--fit off, or too few known lights)");
      exportFit(model, *fit, parameter_file);
    }
  });
}
