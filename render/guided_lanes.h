// Three arrays as kernels take them (guided_kernels.h): channels, or axes.
#pragma once

#include <array>
#include <cstddef>
#include <vector>

#include "render/guided_kernels.h"

namespace srf {

inline float dot3(const std::array<float, 3>& a, float x, float y, float z) {
  return a[0] * x + a[1] * y + a[2] * z;
}
inline DirectionLanes lanesOf(const std::array<std::vector<float>, 3>& of, std::size_t from = 0) {
  return {of[0].data() + from, of[1].data() + from, of[2].data() + from};
}
template <class Float>
std::array<Float*, 3> channels(std::array<std::vector<float>, 3>& of, std::size_t from = 0) {
  return {of[0].data() + from, of[1].data() + from, of[2].data() + from};
}
inline std::array<const float*, 3> channels(const std::array<std::vector<float>, 3>& of, std::size_t from = 0) {
  return {of[0].data() + from, of[1].data() + from, of[2].data() + from};
}

}  // namespace srf
