// The whole check of a capture against a bare loop that reads the same photographs and looks at none, in turn.
#include <cstdio>

#include "acquire/capture_check.h"
#include "apps/program.h"
#include "base/image_io.h"
#include "base/parallel.h"
#include "bench/timing.h"
#include "field/capture_file.h"

int main(int argc, char** argv) {
  using namespace srf;
  Program program("check-benchmark", "times the check of a capture beside decoding its photographs");
  std::string folder;
  int repeats = 5;
  program.app().add_option("capture", folder, "folder of the capture")->required();
  program.app().add_option("--repeats", repeats, "timed runs of each");
  return program.run(argc, argv, [&](Reporter&) {
    const Capture capture = readCapture(folder);
    std::vector<std::filesystem::path> files;
    for (const CaptureView& view : capture.views)
      for (const Photo& photo : view.photos) files.push_back(photo.file);
    CheckOptions options;
    options.memory = program.memoryBudget();
    const auto decode = [&] {
      parallelFor(files.size(), 1, [&](std::size_t i, std::size_t) { readImage(files[i], capture.integer_transfer); });
    };
    decode();  // the system's cache holds the files from here on
    bench::Series decoding, checking, photographs;
    for (int i = 0; i < repeats; ++i) {
      decoding.add(bench::milliseconds(decode));
      checking.add(bench::milliseconds(
          [&] { photographs.add(1000 * checkCapture(folder, options, Reporter::silent()).seconds_reading); }));
    }
    const Intrinsics& lens = capture.views.front().camera.lens;
    std::printf("| %zu views x %zu lights, %d x %d pixels | %s | %s | %s | %s |\n", capture.views.size(),
                capture.lights.size(), lens.width, lens.height, bench::shown(decoding).c_str(),
                bench::shown(checking).c_str(), bench::shown(photographs).c_str(),
                bench::shownRatio(bench::ratios(checking, decoding)).c_str());
  });
}
