#include "tests/support/hard_case.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <nlohmann/json.hpp>

#include "base/image_io.h"

namespace srf::test {

void recordHardCase(int row, const std::string& what, double measured, Bound bound) {
  if (bound.at_least)
    EXPECT_GE(measured, bound.value) << "hard case " << row << ": " << what;
  else
    EXPECT_LE(measured, bound.value) << "hard case " << row << ": " << what;
  const char* file = std::getenv("SRF_HARD_CASES");
  if (!file) return;
  const auto* info = ::testing::UnitTest::GetInstance()->current_test_info();
  const nlohmann::json line{{"row", row},
                            {"what", what},
                            {"test", std::string(info->test_suite_name()) + "." + info->name()},
                            {"measured", measured},  // null where it is no number
                            {"bound", bound.value},
                            {"full_size", nightly()},
                            {"at_least", bound.at_least}};
  // One write a line: test programs may run side by side.
  FILE* out = std::fopen(file, "a");
  if (!out) {
    ADD_FAILURE() << "SRF_HARD_CASES: " << file << " cannot be written";
    return;
  }
  std::fputs((line.dump() + "\n").c_str(), out);
  std::fclose(out);
}

bool nightly() {
  const char* set = std::getenv("SRF_NIGHTLY");
  return set && std::string(set) == "1";
}

std::optional<std::filesystem::path> hardCasePictures() {
  const char* folder = std::getenv("SRF_HARD_CASE_PICTURES");
  if (!folder) return std::nullopt;
  return folder;
}

void showHardCase(int row, const std::string& name, const ImageF& rgba, const std::vector<ShownLayer>& layers) {
  const auto folder = hardCasePictures();
  if (!folder) return;
  static constexpr double kStops[4][3] = {{50, 20, 110}, {180, 40, 110}, {245, 125, 50}, {250, 240, 140}};
  const int width = rgba.width(), height = rgba.height();
  Image8 out(width * (1 + static_cast<int>(layers.size())), height, 3, 255);
  for (int y = 0; y < height; ++y)
    for (int x = 0; x < width; ++x) {
      if (rgba.at(x, y, 3) == 0) continue;
      for (int c = 0; c < 3; ++c) {
        const double linear = std::clamp(1.5 * rgba.at(x, y, c), 0.0, 1.0);
        out.at(x, y, c) = static_cast<std::uint8_t>(std::lround(255 * std::pow(linear, 1 / 2.2)));
        for (std::size_t l = 0; l < layers.size(); ++l) {
          const auto& [values, low, high] = layers[l];
          const double t = 3 * std::clamp((values->at(x, y) - low) / (high - low), 0.0, 1.0);
          const int i = std::min(2, static_cast<int>(t));
          out.at(x + width * static_cast<int>(l + 1), y, c) =
              static_cast<std::uint8_t>(std::lround(std::lerp(kStops[i][c], kStops[i + 1][c], t - i)));
        }
      }
    }
  writePng(*folder / ((row < 10 ? "0" : "") + std::to_string(row) + "_" + name + ".png"), out);
}

}  // namespace srf::test
