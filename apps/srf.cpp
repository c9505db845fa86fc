// `srf COMMAND ...` runs the program srf-COMMAND that lies beside this one.
#include <unistd.h>

#include <algorithm>
#include <cstdio>
#include <filesystem>
#include <string>
#include <vector>

#include "base/json.h"

namespace {

struct Command {
  const char* name;
  const char* does;
};
constexpr Command kCommands[] = {
    {"synth", "write a synthetic capture by formula, or the exact picture of a scene of it"},
    {"calibrate", "photographs to a capture's cameras and lights, or a calibration board to print"},
    {"import", "other programs' files and data sets' layouts to a capture"},
    {"export", "a capture to other programs' files"},
    {"check", "examine a capture and say what is wrong, where, and how to mend it"},
    {"acquire", "capture to SRF: silhouettes, visual hull, registered views"},
    {"model", "make the deformable model inside an SRF"},
    {"render", "render a scene to frames"},
    {"explain", "which effects a scene calls for, why, and what each costs; how a pixel comes about"},
    {"study", "what accuracy costs in time on a scene, and the settings worth using"},
    {"pipeline", "photographs to animation in one go, with a report"},
    {"info", "say what a file holds"},
    {"compare", "measure the difference of two images"},
};

void printHelp(FILE* out) {
  std::fputs(
      "Usage: srf COMMAND [options]\n\nTurns photographs of an object under many lights into a model that can be bent, "
      "animated and relit.\n\n",
      out);
  for (const Command& c : kCommands) std::fprintf(out, "  %-10s %s\n", c.name, c.does);
  std::fputs("\n`srf COMMAND --help` tells the options of a command.\n", out);
}

}  // namespace

int main(int argc, char** argv) {
  const std::string word = argc > 1 ? argv[1] : "";
  if (word.empty() || word == "--help" || word == "-h" || word == "help") {
    printHelp(word.empty() ? stderr : stdout);
    return word.empty() ? 2 : 0;
  }
  if (word == "--version") {
    std::printf("srf %s\n", SRF_VERSION);
    return 0;
  }
  std::vector<std::string> known;
  for (const Command& c : kCommands) known.emplace_back(c.name);
  if (std::find(known.begin(), known.end(), word) == known.end()) {
    const std::string near = srf::nearestWord(word, known);
    std::fprintf(stderr, "srf: unknown command '%s'%s\n", word.c_str(),
                 near.empty() ? "; see srf --help" : ("; did you mean '" + near + "'?").c_str());
    return 2;
  }
  std::error_code code;
  const auto self = std::filesystem::read_symlink("/proc/self/exe", code);
  const auto program = (code ? std::filesystem::path(argv[0]) : self).parent_path() / ("srf-" + word);
  argv[1] = const_cast<char*>(program.c_str());
  ::execv(program.c_str(), argv + 1);
  std::fprintf(stderr, "srf: %s could not be started: build it, or install it beside this program\n", program.c_str());
  return 1;
}
