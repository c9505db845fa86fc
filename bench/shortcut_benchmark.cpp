// What `srf explain` promises of a scene's shortcut (one vector of light weights for a rigid frame) beside what it
// brings: the frame rendered both ways. Prints a row of Markdown; run it several times, for times scatter.
#include <cstdio>
#include <nlohmann/json.hpp>

#include "apps/explain_plan.h"
#include "apps/program.h"
#include "base/error.h"

int main(int argc, char** argv) {
  using namespace srf;
  Program program("shortcut-benchmark", "what explain promises of a shortcut, and what it brings");
  std::string scene_file;
  std::vector<std::string> overrides;
  AnimationOptions options;
  program.app().add_option("scene", scene_file, "scene.json, at rest or moved rigidly")->required();
  program.app().add_option("--srf", options.srf, "the field; default: the scene's");
  program.app().add_option("--set", overrides, "/json/pointer=value")->allow_extra_args(false);
  return program.run(argc, argv, [&](Reporter& reporter) {
    options.memory_bytes = program.memoryBudget();
    const Scene scene = readScene(scene_file, overrides, reporter);
    const int frame = scene.frames.front();
    const Json plan = planOfFrame(scene, options, frame, reporter);
    for (const Json& row : plan["plan"])
      if (row.contains("factor")) {
        const double promised = row["factor"], measured = measuredFactor(scene, options, frame);
        std::printf("| promised | measured | ratio |\n|---|---|---|\n| %.2f | %.2f | %.2f |\n", promised, measured,
                    promised / measured);
        return;
      }
    throw badInput(scene_file,
                   "has no shortcut whose factor explain promises: it needs distant lights (nine where guided), and "
                   "no deformation or a rigid one");
  });
}
