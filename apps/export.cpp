// srf export: a capture to other programs' files.
#include "acquire/camera_import.h"
#include "acquire/export_capture.h"
#include "apps/program.h"
#include "base/error.h"

int main(int argc, char** argv) {
  srf::Program program("export",
                       "Writes a capture in another format and tells what that cannot hold. Photographs are put there "
                       "as hard links, or copies where the disk allows none.");
  std::string format, source, output;
  program.app()
      .add_option("capture", source, "folder with transforms.json, a Middlebury *_par.txt or a COLMAP model")
      ->required();
  program.app().add_option("-o,--output", output, "folder to write into")->required();
  program.app().add_option("--format", format, "what to write")->required()->check(CLI::IsMember(srf::exportFormats()));
  return program.run(argc, argv, [&](srf::Reporter& reporter) {
    std::error_code code;
    if (std::filesystem::exists(output, code) && !std::filesystem::is_empty(output, code))
      throw srf::Error(srf::ErrorKind::usage, "is not an empty folder; name another", output);
    srf::exportCapture(format, srf::openCapture(source, reporter), output, reporter);
    reporter.result(output + ": written as " + format);
  });
}
