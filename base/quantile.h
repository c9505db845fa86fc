// The value below which a share of the others lie.
#pragma once

#include <algorithm>
#include <cstddef>
#include <vector>

namespace srf {

/// Reorders the values, of which there must be one; `share` from 0 (the least) to 1 (the greatest).
template <class T>
T quantile(std::vector<T>& values, double share) {
  const auto at = values.begin() + static_cast<std::ptrdiff_t>(share * static_cast<double>(values.size() - 1));
  std::nth_element(values.begin(), at, values.end());
  return *at;
}

}  // namespace srf
