// `srf acquire` within its --memory: a capture of ten times what is left of it beside the program itself.
#include <gtest/gtest.h>

#include <cstdlib>
#include <fstream>
#include <iterator>
#include <map>
#include <nlohmann/json.hpp>

#include "base/json.h"
#include "tests/support/test_support.h"

namespace srf {
namespace {

namespace fs = std::filesystem;

constexpr double kMiB = 1 << 20;

class AcquireMemory : public ::testing::Test {
 protected:
  int srf(const std::string& words) const {
    return std::system((std::string(SRF_PROGRAMS) + "/srf " + words + " > /dev/null").c_str());
  }
  /// What the process held at most, MiB.
  double acquire(const std::string& capture, const std::string& out, const std::string& memory) const {
    const fs::path stats = folder_ / (out + ".json");
    EXPECT_EQ(srf("acquire " + (folder_ / capture).string() + " -o " + (folder_ / out).string() + " --memory " +
                  memory + " --stats " + stats.string()),
              0);
    return readJsonFile(stats)["peak_memory_bytes"].number() / kMiB;
  }
  /// The bytes of every store.
  std::map<std::string, std::string> stores(const std::string& srf) const {
    std::map<std::string, std::string> found;
    for (const auto& entry : fs::directory_iterator(folder_ / srf / "views")) {
      std::ifstream in(entry.path(), std::ios::binary);
      found[entry.path().filename().string()] = {std::istreambuf_iterator<char>(in), std::istreambuf_iterator<char>()};
    }
    return found;
  }
  const test::TemporaryFolder folder_;
};

TEST_F(AcquireMemory, IsKeptByACaptureOfTenTimesItAndChangesNoBit) {
  constexpr int kViews = 4, kLights = 32, kMade = 4, kSize = 512;
  const std::string made = " --object sphere --material lambert --supersampling 1 --views " + std::to_string(kViews);
  ASSERT_EQ(srf("synth -o " + (folder_ / "tiny").string() + made + " --lights 4 --size 64"), 0);
  ASSERT_EQ(srf("synth -o " + (folder_ / "large").string() + made + " --lights " + std::to_string(kMade) + " --size " +
                std::to_string(kSize)),
            0);
  // Each photograph is made once and stands under several lights: it is decoded anew for each.
  Json capture = readJsonFile(folder_ / "large" / "transforms.json").raw();
  const Json lights = capture["lights"], frames = capture["frames"];
  for (int copy = 1; copy < kLights / kMade; ++copy) {
    const std::string suffix = "-" + std::to_string(copy);
    for (Json light : lights) {
      light["name"] = light["name"].get<std::string>() + suffix;
      capture["lights"].push_back(light);
    }
    for (Json frame : frames) {
      frame["light"] = frame["light"].get<std::string>() + suffix;
      capture["frames"].push_back(frame);
    }
  }
  writeJsonFile(folder_ / "large" / "transforms.json", capture);

  const double program = acquire("tiny", "tiny.srf", "4G");  // with its libraries
  const double decoded = kViews * kLights * kSize * kSize * 3 * sizeof(float) / kMiB;
  const int budget = static_cast<int>(program + decoded / 10);
  EXPECT_LE(acquire("large", "little.srf", std::to_string(budget) + "M"), budget);
  EXPECT_GT(acquire("large", "plenty.srf", "4G"), budget);  // or the test would say nothing
  EXPECT_TRUE(stores("little.srf") == stores("plenty.srf"));
}

}  // namespace
}  // namespace srf
