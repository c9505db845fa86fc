// Image files. image_io.cpp is the one place that includes OpenImageIO and OpenEXR (but for colour: color.h).
#pragma once

#include <array>
#include <filesystem>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "base/image.h"

namespace srf {

/// How integer (8/16-bit) files encode light. EXR, HDR and float TIFF are always linear.
enum class Transfer { srgb, linear };

struct LoadedImage {
  ImageF pixels;           ///< linear; 1, 3 or 4 channels (grey, RGB, premultiplied RGBA)
  bool has_alpha = false;  ///< the last channel is alpha
  int bits = 32;           ///< of the file: 8, 16 or 32
  bool is_float = true;    ///< half or float samples in the file
};

/// Reads a whole image, first part, channels by name (R G B A, else Y, else in file order); of an EXR its display
/// window, black where the file holds nothing. NaN and Inf are passed on as they are. Throws bad_input that names the
/// file: missing, unreadable, truncated.
LoadedImage readImage(const std::filesystem::path& file, Transfer integer_transfer = Transfer::srgb);

/// A photograph with what its camera says about it. Samples are as the file stores them: integer ones from 0 to 1 in
/// their own encoding, RAW and float ones linear.
struct Photograph {
  ImageF pixels;           ///< 1 or 3 channels, turned upright as the file's orientation says
  int bits = 8;            ///< of a sample
  bool is_linear = false;  ///< RAW, EXR, HDR and other float files
  bool is_raw = false;
  std::optional<double> seconds, f_number, iso;       ///< of the exposure
  std::optional<std::array<float, 4>> white_balance;  ///< RAW: the multipliers of R, G, B and the second G, green 1
};
/// Reads a photograph. RAW files are made linear Rec.709 from the sensor's values without tone curve, automatic
/// brightness or maximum: 1 is the sensor's full well after white balance. `white_balance`: the multipliers to use;
/// without them the file's own (as shot). Throws bad_input as readImage does.
Photograph readPhotograph(const std::filesystem::path& file,
                          const std::optional<std::array<float, 4>>& white_balance = std::nullopt);
/// The image turned as EXIF's orientation 1 to 8 says it has to be to stand upright.
ImageF uprightImage(const ImageF& image, int orientation);
/// Width and height without decoding the pixels.
struct ImageSize {
  int width = 0, height = 0;
};
ImageSize readImageSize(const std::filesystem::path& file);
/// A mask: 8-bit coverage; one channel, or the alpha of an RGBA file, or the mean of RGB. No transfer curve.
Image8 readMask(const std::filesystem::path& file);

/// One named channel of an EXR frame.
struct ExrChannel {
  std::string name;             ///< "R", "P.X", "view.0" ..
  const float* data = nullptr;  ///< width * height values, `stride` floats apart
  std::ptrdiff_t stride = 1;
  bool full_float = false;  ///< 32-bit float instead of half
  bool masked = false;      ///< half only: NaN marks samples without a value and stays
};
using Attributes = std::map<std::string, std::string>;  ///< string attributes of the header

/// Writes beside `file` and renames; values beyond half range are clamped and counted (the count is returned); NaN
/// never passes: it is a broken promise of the caller and is written as 0 and counted too. The attribute
/// `framesPerSecond`, a number, is written as OpenEXR's own rational.
std::size_t writeExr(const std::filesystem::path& file, int width, int height, const std::vector<ExrChannel>& channels,
                     const Attributes& attributes = {});
/// RGB or RGBA or grey float image as half EXR.
std::size_t writeExr(const std::filesystem::path& file, const ImageF& image, const Attributes& attributes = {});
/// The same for a photograph of a capture, in which NaN marks samples that were not measured (saturated, out of the
/// picture): it is written as it is and not counted.
std::size_t writeMaskedExr(const std::filesystem::path& file, const ImageF& image, const Attributes& attributes = {});
/// 8-bit PNG of display values (1, 3 or 4 channels), written beside and renamed.
void writePng(const std::filesystem::path& file, const Image8& image);
/// 16-bit PNG; values 0..1 are scaled to 0..65535.
void writePng16(const std::filesystem::path& file, const ImageF& image);
/// sRGB transfer curve of IEC 61966-2-1, and its inverse.
float srgbFromLinear(float linear);
float linearFromSrgb(float encoded);
/// Display image of a linear one: exposure, clip, sRGB, 8 bits.
Image8 displayImage(const ImageF& linear, double exposure = 1.0);
/// Every channel of an EXR by name, as floats (for AOV layers).
std::map<std::string, ImageF> readExrChannels(const std::filesystem::path& file);
/// String attributes of an EXR header.
Attributes readExrAttributes(const std::filesystem::path& file);

/// IEEE half conversions, round to nearest even; finite values beyond 65504 clamp to it.
std::uint16_t halfFromFloat(float value);
float floatFromHalf(std::uint16_t half);

}  // namespace srf
