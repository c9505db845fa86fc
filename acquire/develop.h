// Photographs to linear reflectance images: the camera's response undone, exposures of one picture merged, dark frame
// and flat field, the lens's distortion removed. Samples that were not measured (saturated in every exposure, out of
// the picture) are NaN from here on: registration leaves such pixels out.
#pragma once

#include <array>
#include <filesystem>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "base/camera.h"
#include "base/image_io.h"
#include "base/reporter.h"

namespace srf {

/// What a camera's file values mean: linear exposure as a function of the encoded value from 0 to 1, per channel,
/// rising; 1 at the encoded value 1 for `linear` and `srgb`, at 0.5 for measured ones.
class CameraResponse {
 public:
  static CameraResponse linear();
  static CameraResponse srgb();
  /// A measured curve: exposures at 256 evenly spaced encoded values, made rising where noise makes it fall.
  static CameraResponse measured(const std::array<std::vector<double>, 3>& curves);
  /// A table written by writeResponse. Throws bad_input.
  static CameraResponse read(const std::filesystem::path& file);
  void write(const std::filesystem::path& file) const;

  bool isLinear() const { return curves_[0].empty(); }
  float exposure(int channel, float encoded) const {
    if (isLinear()) return encoded;
    const std::vector<float>& curve = curves_[channel];
    const float at = std::min(std::max(encoded, 0.f), 1.f) * static_cast<float>(curve.size() - 1);
    const std::size_t i = std::min(static_cast<std::size_t>(at), curve.size() - 2);
    const float t = at - static_cast<float>(i);
    return (1 - t) * curve[i] + t * curve[i + 1];
  }

 private:
  std::array<std::vector<float>, 3> curves_;
};

/// One exposure of a picture, as the file stores it (Photograph::pixels).
struct Exposure {
  ImageF pixels;
  double amount = 1;       ///< light gathered: seconds x ISO / f-number^2, in any one unit
  bool is_linear = false;  ///< float and RAW files: no response to undo
};

/// Colour of pixels that are no photograph, as encoded: the border of aligned pictures.
using IgnoredColour = std::optional<std::array<float, 3>>;

/// The response by Debevec and Malik (SIGGRAPH 97) through OpenCV's photo module, from a bracket of 8-bit exposures:
/// 196 pixels spread evenly over the brightness of those that are neither ignored nor clipped in most exposures.
/// Throws bad_input where there are fewer than two exposures, their amounts do not differ, or too few such pixels.
CameraResponse measureResponse(const std::vector<Exposure>& bracket, const IgnoredColour& ignored = std::nullopt);

struct MergeOptions {
  double saturated = 0.985;  ///< encoded values at this or above (of 1) are not measured
  double black = 0.01;       ///< encoded values at this or below are not measured, but by the longest exposure
  IgnoredColour ignored;
};
struct Merged {
  ImageF radiance;                   ///< exposure per amount; NaN in all channels where a channel was never measured
  std::size_t saturated_pixels = 0;  ///< saturated in every exposure in some channel
  std::size_t dark_pixels = 0;       ///< black even in the longest exposure in every channel: kept as it measured them
  std::size_t ignored_pixels = 0;    ///< of the ignored colour in every exposure
};
/// Merges exposures of one picture to radiance. Linear ones: sum of values over sum of amounts, each weighted by a
/// falling flank towards saturation (shot noise makes that the estimate of least variance). Encoded ones: the mean of
/// log exposure with the hat weights of Debevec and Malik, Eq. 6. Clipped samples have no weight. `dark`: linear
/// exposures to subtract (empty: none), of the bracket's own exposures in order or one for all. Throws bad_input where
/// sizes differ.
Merged mergeExposures(const std::vector<Exposure>& bracket, const CameraResponse& response, const MergeOptions& options,
                      const std::vector<ImageF>& dark = {});

/// Linear exposure of a photograph (no merging, no masks).
ImageF linearImage(const Exposure& exposure, const CameraResponse& response);
/// Mean of images of one size: dark frames, flat fields. NaN where one is NaN. Throws bad_input.
ImageF meanImage(const std::vector<ImageF>& images);

/// The gain that undoes vignetting: a linear picture of an even white surface over its mean in the middle tenth, per
/// channel, smoothed over 1/100 of the width against its noise. Throws bad_input where that is dark.
ImageF flatField(const ImageF& white);
/// Divides by a flat field; NaN where it is under 2 % or NaN. Throws bad_input where sizes differ.
void divideByFlat(ImageF& image, const ImageF& flat);

/// Resampling of one lens's pictures to a pinhole camera of the same focal length, size and principal point. Each new
/// pixel is the mean of the old ones that it covers, by the area of its outline (four straight sides) in each: nothing
/// is lost or counted twice. Made once for a lens; applied to every picture.
class Undistortion {
 public:
  explicit Undistortion(const Intrinsics& lens);
  /// The lens of the new pictures.
  static Intrinsics pinholeOf(const Intrinsics& lens);
  const Intrinsics& lens() const { return pinhole_; }
  /// NaN where more than 1e-3 of the area is NaN or outside the old picture. Throws bad_input where the size differs.
  ImageF apply(const ImageF& image) const;
  /// A mask: coverage by area, 0 outside.
  Image8 apply(const Image8& mask) const;

 private:
  struct Share {
    std::uint32_t pixel;
    float area;
  };
  Intrinsics lens_, pinhole_;
  std::vector<std::uint32_t> first_;  ///< of each new pixel in shares_, and the end
  std::vector<Share> shares_;         ///< areas of a new pixel sum to 1 where all of it lies in the old picture
};

}  // namespace srf
