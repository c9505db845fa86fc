// `srf compare`: the difference of two images.
#include <cstdio>
#include <nlohmann/json.hpp>

#include "apps/heat_image.h"
#include "apps/program.h"
#include "base/error.h"
#include "base/image_io.h"
#include "base/image_metrics.h"
#include "base/json.h"

namespace srf {
namespace {

void print(const ImageDifference& d) {
  const auto line = [](const char* name, const MetricFigures& f) {
    std::printf("%-7s %9zu %9.3f %13.6f %9.5f %9.5f\n", name, f.pixels, f.psnr, f.relative_mse, f.ssim, f.flip);
  };
  std::printf("%-7s %9s %9s %13s %9s %9s\n", "", "pixels", "PSNR dB", "relative MSE", "SSIM", "FLIP");
  line("inside", d.inside);
  line("full", d.full);
  std::printf("peak %.6g, display white %.6g, bias inside %+.5f, pixels not finite %zu\n", d.peak, d.white, d.bias,
              d.not_finite);
  std::printf("relative error of a pixel: mean %.4g %%, 99.9th percentile %.4g %%\n", 100 * d.relative_error,
              100 * d.relative_error_tail);
}

void printJson(const ImageDifference& d) {
  Json out;
  out["pixels_in"] = d.inside.pixels;
  out["nonfinite"] = d.not_finite;
  out["peak"] = d.peak;
  const auto put = [&](const std::string& name, const MetricFigures& f) {
    out[name + "_psnr"] = f.psnr;
    out[name + "_relmse"] = f.relative_mse;
    out[name + "_ssim"] = f.ssim;
    out[name + "_flip"] = f.flip;
  };
  put("in", d.inside);
  put("full", d.full);
  out["in_bias"] = d.bias;
  out["relative_error_mean"] = d.relative_error;
  out["relative_error_p99_9"] = d.relative_error_tail;
  std::printf("%s\n", out.dump().c_str());
}

/// The first channel, or alpha where the file has one.
ImageF readCoverage(const std::string& file) {
  const LoadedImage mask = readImage(file, Transfer::linear);
  ImageF coverage(mask.pixels.width(), mask.pixels.height(), 1);
  const int channel = mask.has_alpha ? mask.pixels.channels() - 1 : 0;
  for (int y = 0; y < coverage.height(); ++y)
    for (int x = 0; x < coverage.width(); ++x) coverage.at(x, y) = mask.pixels.at(x, y, channel);
  return coverage;
}

}  // namespace
}  // namespace srf

int main(int argc, char** argv) {
  using namespace srf;
  Program program(
      "compare",
      "Measures the difference of two images: PSNR and relative MSE in linear light; SSIM and FLIP as a display "
      "shows them, the reference's 99th percentile as white. 'inside' is the mask eroded by 2 pixels.");
  std::string image_file, reference_file, mask_file, heat_file;
  bool json = false;
  program.app().add_option("image", image_file, "the image that is measured")->required();
  program.app().add_option("reference", reference_file, "what it should be")->required();
  program.app().add_option("--mask", mask_file, "coverage of the object; default: where the reference is not black");
  program.app().add_option("--heat", heat_file, "write FLIP as a false-colour PNG");
  program.app().add_flag("--json", json, "print one JSON line");
  return program.run(argc, argv, [&](Reporter&) {
    const ImageF image = readImage(image_file).pixels, reference = readImage(reference_file).pixels;
    const ImageDifference d = [&] {
      try {
        return compareImages(image, reference, mask_file.empty() ? ImageF() : readCoverage(mask_file));
      } catch (const Error& e) {
        throw Error(e.kind(), e.what(), image_file + " against " + reference_file);
      }
    }();
    json ? printJson(d) : print(d);
    if (!heat_file.empty()) writePng(heat_file, heatImage(d.flip_map));
  });
}
