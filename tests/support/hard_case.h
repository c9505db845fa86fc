// The hard-case suite: every row of the list in doc/hard_cases.md is measured by named tests, each of which says what
// it measured and what is allowed. With SRF_HARD_CASES=FILE in the environment the results are appended to that file,
// from which tools/nightly.sh makes the page.
#pragma once

#include <cmath>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "base/image.h"

namespace srf::test {

struct Bound {
  double value;
  bool at_least = false;
};
inline Bound atMost(double value) {
  return {value, false};
}
inline Bound atLeast(double value) {
  return {value, true};
}

/// Expects `measured` (what and in which unit `what` says) to keep `bound`, and records it under the row. A NaN keeps
/// no bound.
void recordHardCase(int row, const std::string& what, double measured, Bound bound);

/// The largest of some values; NaN once one of them was.
struct Largest {
  double value = 0;
  void add(double x) {
    if (!std::isnan(value) && !(x <= value)) value = x;
  }
};

/// SRF_NIGHTLY=1: run at full size.
bool nightly();
inline int sized(int in_ci, int full) {
  return nightly() ? full : in_ci;
}
/// Where pictures for the page go; nothing outside tools/nightly.sh.
std::optional<std::filesystem::path> hardCasePictures();
/// Makes a picture for the page, where one is being made: `rgba` (linear) and beside it each layer of the same size in
/// false colours from violet (low) to yellow (high), white where alpha is 0.
struct ShownLayer {
  const ImageF* values;
  double low, high;
};
void showHardCase(int row, const std::string& name, const ImageF& rgba, const std::vector<ShownLayer>& layers);

}  // namespace srf::test
