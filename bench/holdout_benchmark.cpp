// How well a real one-light capture predicts photographs it was not given: every n-th view is left out, the rest goes
// the whole way, and each left-out view is rendered and compared with its photograph inside its silhouette; beside it,
// on the same hull, the nearest visible photograph alone and the plain average of the four nearest. Prints rows of
// Markdown; with --sheet a picture as well: photographs above what was rendered.
#include <unistd.h>

#include <cstdio>

#include "acquire/acquire_field.h"
#include "acquire/camera_import.h"
#include "apps/contact_sheet.h"
#include "apps/holdout.h"
#include "apps/make_model.h"
#include "apps/program.h"
#include "base/image_io.h"
#include "base/numeric.h"
#include "render/frame_renderer.h"

namespace srf {
namespace {

ImageF photograph(const Capture& capture, std::size_t view) {
  return readImage(capture.views[view].photos.at(0).file, capture.integer_transfer).pixels;
}

Vec3 bilinear(const ImageF& image, const Vec2& pixel) {
  const double x = std::clamp(pixel.x - 0.5, 0.0, image.width() - 1.001),
               y = std::clamp(pixel.y - 0.5, 0.0, image.height() - 1.001);
  const int ix = static_cast<int>(x), iy = static_cast<int>(y);
  Vec3 value;
  for (int c = 0; c < 3; ++c)
    value[c] = lerp(lerp(image.at(ix, iy, c), image.at(ix + 1, iy, c), x - ix),
                    lerp(image.at(ix, iy + 1, c), image.at(ix + 1, iy + 1, c), x - ix), y - iy);
  return value;
}

// A square about the silhouette, premultiplied by it, of one size for all.
ImageF aroundSilhouette(const ImageF& image, const ImageF& inside) {
  constexpr int kSide = 240;
  int left = inside.width(), right = 0, top = inside.height(), bottom = 0;
  for (int y = 0; y < inside.height(); ++y)
    for (int x = 0; x < inside.width(); ++x)
      if (inside.at(x, y) > 0) {
        left = std::min(left, x), right = std::max(right, x + 1);
        top = std::min(top, y), bottom = std::max(bottom, y + 1);
      }
  const double side = 1.05 * std::max(right - left, bottom - top);
  ImageF out(kSide, kSide, 4);
  constexpr int kTaps = 4;  // a pixel's mean is taken of kTaps x kTaps places
  for (int y = 0; y < kSide; ++y)
    for (int x = 0; x < kSide; ++x)
      for (int tap = 0; tap < kTaps * kTaps; ++tap) {
        const int u = static_cast<int>(
            std::floor(0.5 * (left + right) + side * ((x + (tap % kTaps + 0.5) / kTaps) / kSide - 0.5)));
        const int v = static_cast<int>(
            std::floor(0.5 * (top + bottom) + side * ((y + (tap / kTaps + 0.5) / kTaps) / kSide - 0.5)));
        if (u < 0 || v < 0 || u >= inside.width() || v >= inside.height() || !(inside.at(u, v) > 0)) continue;
        for (int c = 0; c < 3; ++c) out.at(x, y, c) += image.at(u, v, c) / (kTaps * kTaps);
        out.at(x, y, 3) += 1.f / (kTaps * kTaps);
      }
  return out;
}

// The mean of the `most` nearest photographs that see each hit, by angle alone.
ImageF averageOfNearest(const SrfManifest& field, const DeformedModel& deformed, const std::vector<ImageF>& photographs,
                        const Camera<ObjectSpace>& camera, std::size_t most) {
  ImageF image(camera.lens.width, camera.lens.height, 3);
  for (int y = 0; y < camera.lens.height; ++y) {
    std::vector<Ray<ObjectSpace>> rays;
    std::vector<int> column;  // of each ray; a distorted lens may have none for a pixel
    for (int x = 0; x < camera.lens.width; ++x)
      if (const auto ray = camera.ray({x + 0.5, y + 0.5})) rays.push_back(*ray), column.push_back(x);
    std::vector<SurfaceHit> hits(rays.size());
    deformed.intersect(rays, hits);
    for (std::size_t r = 0; r < rays.size(); ++r) {
      const SurfaceHit& hit = hits[r];
      if (hit.count == 0) continue;
      std::vector<std::pair<double, std::size_t>> nearest;
      for (std::size_t i = 0; i < field.views.size(); ++i)
        if (deformed.model().visible.get(hit.point[0], i) && field.views[i].camera.project(hit.p0))
          nearest.emplace_back(
              angleBetweenUnit(field.views[i].camera.viewDirection(hit.p0).raw(), -rays[r].direction.raw()), i);
      std::sort(nearest.begin(), nearest.end());
      if (nearest.size() > most) nearest.resize(most);
      Vec3 sum;
      for (const auto& [angle, i] : nearest)
        sum += bilinear(photographs[i], field.views[i].camera.project(hit.p0)->pixel) /
               static_cast<double>(nearest.size());
      for (int c = 0; c < 3; ++c) image.at(column[r], y, c) = static_cast<float>(sum[c]);
    }
  }
  return image;
}

}  // namespace
}  // namespace srf

int main(int argc, char** argv) {
  using namespace srf;
  Program program("holdout-benchmark", "predicts left-out views of a one-light capture",
                  "GPL-3.0-or-later (links CGAL)");
  std::string folder, sheet;
  int every = 4, tolerance = 0;
  std::vector<double> bounds;
  bool grab_cut = false;
  program.app().add_option("CAPTURE", folder, "a capture of one unknown illumination")->required();
  program.app().add_option("--every", every, "every n-th view is left out")->check(CLI::Range(2, 1000));
  program.app().add_option("--tolerance", tolerance, "views that may disagree at a point without carving it away");
  program.app().add_option("--bounds", bounds, "as of srf acquire: x0,y0,z0,x1,y1,z1")->delimiter(',')->expected(6);
  program.app().add_flag("--grabcut", grab_cut, "as of srf acquire; the masks of all views, also of those left out");
  program.app().add_option("--sheet", sheet, "PNG: up to six photographs that were left out, below each what was made");
  return program.run(argc, argv, [&](Reporter& reporter) {
    Capture all = openCapture(folder, reporter);
    if (!bounds.empty())
      all.bounds = Box<AcquisitionSpace>{{bounds[0], bounds[1], bounds[2]}, {bounds[3], bounds[4], bounds[5]}};
    const auto work = std::filesystem::temp_directory_path() / ("srf-holdout-" + std::to_string(::getpid()));
    if (grab_cut) {
      SilhouetteOptions options;
      options.source = SilhouetteSource::grab_cut;
      const auto cut = silhouettes(all, options, reporter);
      for (std::size_t i = 0; i < cut.size(); ++i) {
        all.views[i].mask_file = work / "masks" / (std::to_string(i) + ".png");
        writePng(all.views[i].mask_file, cut[i].mask);
      }
    }
    Capture kept = all;
    kept.views.clear();
    std::vector<std::size_t> held_out;
    std::vector<ImageF> photographs;
    for (std::size_t i = 0; i < all.views.size(); ++i) {
      if (i % every == static_cast<std::size_t>(every) - 1) {
        held_out.push_back(i);
      } else {
        kept.views.push_back(all.views[i]);
        photographs.push_back(photograph(all, i));
      }
    }
    const auto srf_folder = work / "x.srf";
    AcquireOptions options;
    options.memory_bytes = program.memoryBudget();
    options.hull.tolerance = tolerance;
    acquireField(kept, srf_folder, options, reporter);
    makeModel(srf_folder, "hull", {}, std::nullopt, reporter);
    const SrfManifest field = readManifest(srf_folder);
    const DeformableModel model = loadModel(srf_folder, field);
    DeformedModel deformed(model);
    deformed.deform({});
    FrameSettings settings;
    settings.memory_bytes = program.memoryBudget();
    FrameRenderer renderer(srf_folder, field, model, settings, reporter);
    const FrameLights lights = asSceneLight(field, LightId{0});
    // Of all views at once, as acquisition makes them: the threshold is steadier than one view's own.
    const std::vector<SilhouetteView> masks = silhouettes(all, options.silhouette, reporter);
    double sums[3] = {}, flips[3] = {};
    std::vector<ImageF> taken, made;  // about the silhouettes
    const std::size_t every_shown = (held_out.size() + 5) / 6;
    std::size_t scored = 0;
    std::printf("| view | interpolated, dB / FLIP | nearest photograph | average of four |\n|---|---|---|---|\n");
    for (const std::size_t view : held_out) {
      const Camera<ObjectSpace> camera = atRest(all.views[view].camera);
      const Frame frame = renderer.render(camera, deformed, lights);
      ImageF inside(camera.lens.width, camera.lens.height, 1);
      for (int y = 0; y < inside.height(); ++y)
        for (int x = 0; x < inside.width(); ++x) inside.at(x, y) = masks[view].mask.at(x, y) == 255 ? 1.f : 0.f;
      const ImageF truth = photograph(all, view);
      const ImageF images[3] = {frame.rgba, averageOfNearest(field, deformed, photographs, camera, 1),
                                averageOfNearest(field, deformed, photographs, camera, 4)};
      std::printf("| %s ", all.views[view].name.c_str());
      for (int i = 0; i < 3; ++i) {
        const MetricFigures figures = scorePrediction(images[i], truth, inside).figures;
        sums[i] += figures.psnr / static_cast<double>(held_out.size());
        flips[i] += figures.flip / static_cast<double>(held_out.size());
        std::printf("| %.2f / %.3f ", figures.psnr, figures.flip);
      }
      std::printf("|\n");
      std::fflush(stdout);
      if (scored++ % every_shown != 0) continue;
      taken.push_back(aroundSilhouette(truth, inside)), made.push_back(aroundSilhouette(frame.rgba, inside));
    }
    if (!sheet.empty()) {
      const int columns = static_cast<int>(taken.size());
      taken.insert(taken.end(), made.begin(), made.end());
      writePng(sheet, contactSheet(taken, columns, 240, displayExposure(taken)));
    }
    std::printf("| mean | **%.2f / %.3f** | %.2f / %.3f | %.2f / %.3f |\n", sums[0], flips[0], sums[1], flips[1],
                sums[2], flips[2]);
    std::filesystem::remove_all(work);
  });
}
