// Images in memory: row-major, channels interleaved, pixel (0,0) top left, pixel centres at +0.5.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "base/check.h"

namespace srf {

template <class T>
class Image {
 public:
  Image() = default;
  Image(int width, int height, int channels, T fill = T{})
      : width_(width),
        height_(height),
        channels_(channels),
        data_(static_cast<std::size_t>(width) * height * channels, fill) {}

  int width() const { return width_; }
  int height() const { return height_; }
  int channels() const { return channels_; }
  bool empty() const { return data_.empty(); }
  T& at(int x, int y, int c = 0) { return data_[index(x, y, c)]; }
  const T& at(int x, int y, int c = 0) const { return data_[index(x, y, c)]; }
  T* row(int y) { return data_.data() + index(0, y, 0); }
  const T* row(int y) const { return data_.data() + index(0, y, 0); }
  std::vector<T>& data() { return data_; }
  const std::vector<T>& data() const { return data_; }

 private:
  std::size_t index(int x, int y, int c) const {
    SRF_DCHECK(x >= 0 && x < width_ && y >= 0 && y < height_ && c >= 0 && c < channels_);
    return (static_cast<std::size_t>(y) * width_ + x) * channels_ + c;
  }
  int width_ = 0, height_ = 0, channels_ = 0;
  std::vector<T> data_;
};

using ImageF = Image<float>;         ///< scene-linear values
using Image8 = Image<std::uint8_t>;  ///< coverage (0 outside, 255 inside) or display values

}  // namespace srf
