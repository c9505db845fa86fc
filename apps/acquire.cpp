// srf acquire: a capture to an SRF (patent, Fig. 1: acquisition).
#include <algorithm>
#include <cstdio>
#include <map>

#include "acquire/acquire_field.h"
#include "acquire/camera_import.h"
#include "acquire/exact_hull.h"
#include "apps/program.h"
#include "base/error.h"
#include "base/files.h"

namespace {

void printSummary(const srf::SrfManifest& manifest, const std::string& out, const srf::Reporter& reporter) {
  std::printf("%s\n", out.c_str());
  std::printf("  views        %zu\n", manifest.views.size());
  std::printf("  lights       %zu%s\n", manifest.lights.size(),
              manifest.unknownIllumination() ? " (unknown illumination: lights of kind 'captured' alone)" : "");
  const auto figures = reporter.figures();
  if (manifest.shape("hull")) {
    std::printf("  hull         %.6g %s^3, finest cell %.4g %s\n", figures.at("hull.volume"), manifest.units.c_str(),
                figures.at("hull.cell"), manifest.units.c_str());
    std::printf("  silhouettes  agree with the hull to %.4f in the mean (intersection over union); least:",
                figures.at("hull.iou.mean"));
    auto views = manifest.views;
    std::stable_sort(views.begin(), views.end(),
                     [](const auto& a, const auto& b) { return a.silhouette_iou < b.silhouette_iou; });
    for (std::size_t i = 0; i < std::min<std::size_t>(3, views.size()); ++i)
      std::printf("%s %s %.4f", i ? "," : "", views[i].name.c_str(), views[i].silhouette_iou);
    std::printf("\n");
  }
  std::printf("  on disk      %.1f MB\n", static_cast<double>(srf::bytesInFolder(out)) / 1e6);
}

// '#rrggbb' to 0..1.
srf::Vec3 colourOf(const std::string& text) {
  unsigned value = 0;
  int used = 0;
  if (text.size() != 7 || std::sscanf(text.c_str(), "#%6x%n", &value, &used) != 1 || used != 7)
    throw srf::Error(srf::ErrorKind::usage, "found '" + text + "', expected auto or a colour such as '#00b140'",
                     "--chroma-key");
  return {(value >> 16 & 255) / 255.0, (value >> 8 & 255) / 255.0, (value & 255) / 255.0};
}

}  // namespace

int main(int argc, char** argv) {
  srf::Program program("acquire", "Capture to SRF: silhouettes, visual hull, registered views.",
                       "GPL-3.0-or-later (links CGAL)");
  std::string capture, out, clean_plate, chroma_key, polarity = "auto", hull_kind = "carved", mask_pictures;
  srf::ExactHullOptions exact;
  srf::PoseAdjustmentOptions adjustment;
  bool grab_cut = false, mend = false, adjust = false;
  srf::AcquireOptions options;
  std::vector<double> bounds;
  double threshold = 0;
  bool keep_outliers = false, no_hull = false;
  CLI::App& app = program.app();
  app.add_option("capture", capture, "folder with a transforms.json, a Middlebury *_par.txt or a COLMAP model")
      ->required()
      ->type_name("CAPTURE");
  app.add_option("-o,--output", out, "the SRF to write")->required()->type_name("X.srf");
  app.add_option("--hull-resolution", options.hull.resolution,
                 "finest cells along the longest side of the object; 0: one pixel a cell")
      ->check(CLI::Range(0, 4096))
      ->capture_default_str();
  app.add_option("--tolerance", options.hull.tolerance, "views that may disagree at a point without carving it away")
      ->check(CLI::Range(0, 1000))
      ->capture_default_str();
  app.add_flag("--keep-outliers", keep_outliers, "carve with views too whose silhouette contradicts the others");
  app.add_option("--bounds", bounds, "box that holds the object: x0,y0,z0,x1,y1,z1, in the capture's units")
      ->delimiter(',')
      ->expected(6);
  const CLI::Option* threshold_option =
      app.add_option("--background-threshold", threshold,
                     "values above this (0 to 1, as encoded in the file) are the object where no mask tells")
          ->check(CLI::Range(0.0, 1.0));
  CLI::Option* plate_option = app.add_option(
      "--clean-plate", clean_plate,
      "masks from the difference to pictures without the object: a file, or a folder with one for each photograph");
  CLI::Option* key_option =
      app.add_option("--chroma-key", chroma_key, "masks from a screen of one colour: '#rrggbb', or auto")
          ->excludes(plate_option);
  app.add_flag("--grabcut", grab_cut, "masks by GrabCut, from the bounds and the hull of the other views")
      ->excludes(plate_option)
      ->excludes(key_option);
  app.add_flag("--mend-masks", mend, "fill gaps of masks, and cut what is beside them, by the hull of the other views");
  app.add_option("--mask-polarity", polarity, "what is the object in mask files: auto, white or black")
      ->check(CLI::IsMember({"auto", "white", "black"}))
      ->capture_default_str();
  app.add_option("--mask-pictures", mask_pictures, "write a picture of each view's mask, and all on a sheet, here")
      ->type_name("DIR");
  CLI::Option* adjusting = app.add_flag("--adjust-poses", adjust,
                                        "move the cameras a little so that the silhouettes agree; told view by view");
  app.add_option("--pose-uncertainty", adjustment.uncertainty, "how far the poses may be off, in pixels at the object")
      ->needs(adjusting)
      ->check(CLI::Range(0.01, 100.0))
      ->capture_default_str();
  app.add_option("--hull", hull_kind, "carved on a grid, or the exact intersection of the silhouettes' cones")
      ->check(CLI::IsMember({"carved", "exact"}))
      ->capture_default_str();
  app.add_option("--contour-tolerance", exact.tolerance,
                 "of --hull exact: pixels that its contours may be simplified by")
      ->check(CLI::Range(0.0, 100.0))
      ->capture_default_str();
  app.add_flag("--no-hull", no_hull, "carve no hull: the shape will come from elsewhere");
  app.add_option(
         "--compression", options.coding.compression,
         "of the reflectance images: lossless; pca (principal components over the lights, several times smaller "
         "and faster); none")
      ->transform(CLI::CheckedTransformer(std::map<std::string, srf::Compression>{
          {"none", srf::Compression::none}, {"lossless", srf::Compression::lossless}, {"pca", srf::Compression::pca}}))
      ->default_str("lossless");
  app.add_option("--compression-error", options.coding.error,
                 "of pca: root mean square error of a block that is allowed, as a share of the block's own; noise is "
                 "left out even where that makes more")
      ->check(CLI::Range(0.0, 1.0))
      ->capture_default_str();
  return program.run(argc, argv, [&](srf::Reporter& reporter) {
    options.hull.exclude_outliers = !keep_outliers;
    options.make_hull = !no_hull;
    options.memory_bytes = program.memoryBudget();
    options.command = program.commandLine();
    if (threshold_option->count() > 0) options.silhouette.background_threshold = threshold;
    using Source = srf::SilhouetteSource;
    if (!clean_plate.empty()) options.silhouette.source = Source::clean_plate;
    if (!chroma_key.empty()) options.silhouette.source = Source::chroma_key;
    if (grab_cut) options.silhouette.source = Source::grab_cut;
    options.silhouette.clean_plate = clean_plate;
    if (!chroma_key.empty() && chroma_key != "auto") options.silhouette.key = colourOf(chroma_key);
    options.silhouette.mend = mend;
    options.silhouette.polarity = polarity == "auto"    ? srf::MaskPolarity::automatic
                                  : polarity == "white" ? srf::MaskPolarity::white_is_object
                                                        : srf::MaskPolarity::black_is_object;
    options.mask_pictures = mask_pictures;
    if (adjust) options.adjust_poses = adjustment;
    if (hull_kind == "exact")
      options.refine_hull = [&](const auto& views, const srf::VisualHull& carved, srf::Reporter& told) {
        return srf::exactVisualHull(views, carved, exact, told);
      };
    srf::Capture input = srf::openCapture(capture, reporter);
    if (!bounds.empty()) {
      const srf::Box<srf::AcquisitionSpace> box{{bounds[0], bounds[1], bounds[2]}, {bounds[3], bounds[4], bounds[5]}};
      if (!(srf::minComponent(box.max - box.min) > 0))
        throw srf::Error(srf::ErrorKind::usage, "expected x0 < x1, y0 < y1 and z0 < z1", "--bounds");
      input.bounds = box;
    }
    printSummary(srf::acquireField(input, out, options, reporter), out, reporter);
  });
}
