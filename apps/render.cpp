// `srf render`: a scene to frames.
#include <cstdio>

#include "apps/frame_lines.h"
#include "apps/program.h"
#include "render/animation.h"

int main(int argc, char** argv) {
  using namespace srf;
  Program program("render", "Renders the frames of a scene: deforms the model, relights it, writes OpenEXR files.");
  std::string scene_file, frames;
  std::vector<std::string> overrides;
  AnimationOptions options;
  CLI::App& app = program.app();
  app.add_option("scene", scene_file, "scene.json")->required();
  app.add_option("--srf", options.srf, "the field, X.srf; default: the scene's");
  app.add_option("-o,--output", options.output, "pattern of the frames, name.####.exr; default: the scene's");
  app.add_option("--frames", frames, "frames instead of the scene's, e.g. 0-10, 0-60x2 or 1,5,9");
  app.add_option("--set", overrides, "/json/pointer=value: changes the scene; may be repeated")
      ->allow_extra_args(false);
  app.add_option("--aovs", options.layers,
                 "layers to add: P, P0, N, L, handedness, stretch, shear, fallback, overlap, V, Z, view, confidence")
      ->delimiter(',');
  app.add_flag("--resume", options.resume, "keep frames that the same input and settings have finished");
  return program.run(argc, argv, [&](Reporter& reporter) {
    options.memory_bytes = program.memoryBudget();
    options.command = program.commandLine();
    if (!frames.empty()) options.frames = parseFrames(frames, "--frames");
    const Scene scene = readScene(scene_file, overrides, reporter);
    options.finished = FrameLines(reporter);
    double seconds = 0;
    std::size_t rendered = 0;
    for (const RenderedFrame& frame : renderAnimation(scene, options, reporter))
      if (!frame.kept) seconds += frame.seconds, ++rendered;
    if (rendered > 1) std::printf("%zu frames, %.3f s each\n", rendered, seconds / static_cast<double>(rendered));
  });
}
