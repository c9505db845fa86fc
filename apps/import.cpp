// srf import: other programs' files and data sets' layouts to a capture.
#include "acquire/import_capture.h"
#include "apps/program.h"
#include "base/error.h"
#include "field/capture_file.h"

int main(int argc, char** argv) {
  srf::Program program("import",
                       "Writes transforms.json for a capture in another format. Photographs are named where they lie; "
                       "nothing is re-centred or re-scaled.");
  std::string format, source, output;
  srf::ImportOptions options;
  program.app().add_option("source", source, "file or folder of the other format")->required();
  program.app().add_option("-o,--output", output, "folder for transforms.json")->required();
  program.app()
      .add_option("--format", format, "default: told by the files")
      ->check(CLI::IsMember(srf::importFormats()));
  program.app().add_option("--images", options.images, "folder of the photographs; default: beside the file");
  program.app().add_option("--lights", options.lights, "openillumination: light_pos.npy");
  program.app()
      .add_option("--pixel-center", options.pixel_center,
                  "projections: coordinate of the first pixel's centre (OpenCV 0, COLMAP 0.5, MATLAB 1)")
      ->capture_default_str();
  return program.run(argc, argv, [&](srf::Reporter& reporter) {
    if (format.empty()) format = srf::guessFormat(source);
    const srf::Capture capture = srf::importCapture(format, source, options, reporter);
    if (std::filesystem::exists(std::filesystem::path(output) / "transforms.json"))
      throw srf::Error(srf::ErrorKind::usage, "holds a transforms.json already; name another folder", output);
    srf::writeCapture(output, capture);
    std::size_t photos = 0;
    for (const srf::CaptureView& view : capture.views) photos += view.photos.size();
    reporter.result(output + ": " + format + ", " + std::to_string(capture.views.size()) + " views, " +
                    (capture.unknownIllumination() ? "one unknown illumination"
                                                   : std::to_string(capture.lights.size()) + " lights") +
                    ", " + std::to_string(photos) + " photographs");
  });
}
