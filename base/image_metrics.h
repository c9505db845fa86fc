// How far a linear image is from a reference: PSNR and relative squared error in linear light; SSIM (Wang et al. 2004)
// and FLIP (Andersson et al. 2020, low dynamic range) as a display would show both.
#pragma once

#include <cstddef>

#include "base/image.h"

namespace srf {

/// Means over a set of pixels.
struct MetricFigures {
  std::size_t pixels = 0;
  double psnr = 0;          ///< dB, linear RGB against ImageDifference::peak; at most that of a mean square of 1e-20
  double relative_mse = 0;  ///< (x - r)^2 / (r^2 + (peak / 100)^2)
  double ssim = 0;          ///< windows of 7 x 7, per channel of the display images
  double flip = 0;          ///< 0 (no difference) to 1
};

struct ImageDifference {
  MetricFigures inside;  ///< the mask eroded by 2 pixels; the mask itself where that leaves fewer than 50
  MetricFigures full;    ///< all pixels
  double peak = 1;       ///< 99.9th percentile of the reference's brightest channel inside
  double white = 1;      ///< its 99th percentile: what the display images show as 1
  double bias = 0;       ///< relative difference of the means inside
  /// Mean and 99.9th percentile of the relative error over the pixels where either picture shows something, whatever
  /// the mask: of a pixel the largest |x - r| of its channels over r_max + peak / 100, r_max being the reference's
  /// brightest channel there. What srf study promises.
  double relative_error = 0, relative_error_tail = 0;
  std::size_t not_finite = 0;  ///< pixels of the image that hold NaN or Inf: measured as 0
  ImageF flip_map;             ///< one channel, as large as the images
};

/// Both of the same size, grey or RGB (alpha is left out); the reference must be finite. `mask`: one channel, inside
/// where above 0.999; empty: where the reference is above 0. Throws bad_input where sizes differ or nothing is inside
/// the mask.
ImageDifference compareImages(const ImageF& image, const ImageF& reference, const ImageF& mask = {});

}  // namespace srf
