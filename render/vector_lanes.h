// How the arrays of vector kernels are padded.
#pragma once

#include <cstddef>

namespace srf {

inline constexpr std::size_t kVectorLanes = 16;  ///< floats of the widest instruction set
/// `count` rounded up to whole vectors.
constexpr std::size_t paddedLanes(std::size_t count) {
  return (count + kVectorLanes - 1) / kVectorLanes * kVectorLanes;
}

}  // namespace srf
