#include "tests/support/hard_case.h"

#include <gtest/gtest.h>

#include <cstdio>
#include <cstdlib>
#include <nlohmann/json.hpp>

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

}  // namespace srf::test
