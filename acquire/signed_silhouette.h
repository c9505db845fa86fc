// The signed distance to a silhouette's contour, in pixels: negative inside, zero where the coverage is one half.
#pragma once

#include <algorithm>
#include <cmath>

#include "base/image.h"

namespace srf {

/// Sub-pixel distances of one mask, kept for the box around its silhouette. Immutable and thread-safe.
class SignedSilhouette {
 public:
  /// `mask`: coverage, 0 outside, 255 inside; neither empty nor all inside. On a straight edge of exact coverage the
  /// contour is met within 0.06 pixels; masks without soft values are smoothed a little more.
  explicit SignedSilhouette(const Image8& mask);

  /// The distance at a pixel position (bilinear; the first pixel's centre is at 0.5, 0.5). Beyond the kept box a lower
  /// bound that continues it without a jump, from the distances to that box and to the silhouette's own.
  double at(double x, double y) const {
    const double u = x - 0.5 - left_, v = y - 0.5 - top_;
    const double cu = u < 0 ? 0 : u > last_x_ ? last_x_ : u, cv = v < 0 ? 0 : v > last_y_ ? last_y_ : v;
    const int i = cu < last_x_ ? static_cast<int>(cu) : static_cast<int>(last_x_) - 1;
    const int j = cv < last_y_ ? static_cast<int>(cv) : static_cast<int>(last_y_) - 1;
    const double s = cu - i, t = cv - j;
    const float* row = distance_.data().data() + static_cast<std::size_t>(j) * distance_.width() + i;
    const float* next = row + distance_.width();
    const double upper = row[0] + s * (row[1] - row[0]), lower = next[0] + s * (next[1] - next[0]);
    const double inside = upper + t * (lower - upper);
    // Half a pixel beyond the outer centres is still the picture.
    const double over_x = positive(std::fabs(u - cu) - 0.5), over_y = positive(std::fabs(v - cv) - 0.5);
    if (over_x == 0 && over_y == 0) return inside;
    const double x_out = positive(std::max(inner_left_ - u, u - inner_right_));
    const double y_out = positive(std::max(inner_top_ - v, v - inner_bottom_));
    return std::max(std::hypot(over_x, over_y, inside), std::hypot(x_out, y_out) - 1);
  }
  /// The same for `count` places, with the same bits.
  void at(const double* x, const double* y, int count, double* distance) const;
  /// Whether the silhouette reaches the picture's edge: the object may go on outside.
  bool cropped() const { return cropped_; }

 private:
  static double positive(double x) { return std::max(x, 0.0); }

  ImageF distance_;
  double left_ = 0, top_ = 0, last_x_ = 0, last_y_ = 0;                         ///< of the kept box, pixels
  double inner_left_ = 0, inner_top_ = 0, inner_right_ = 0, inner_bottom_ = 0;  ///< of the silhouette in it
  bool cropped_ = false;
};

}  // namespace srf
