// Linear colour spaces by name, and the way from one to another: by a 3x3 matrix for the spaces of this project, by the
// configuration that the environment variable OCIO names where it is set. color.cpp includes OpenImageIO's OpenColorIO
// front.
#pragma once

#include <memory>
#include <string>
#include <vector>

#include "base/image.h"
#include "base/vec.h"

namespace srf {

inline constexpr Vec3 kLuminance{0.2126, 0.7152, 0.0722};  ///< of linear Rec.709

/// "lin_rec709", "ACEScg", "ACES2065-1": the spaces known without a configuration.
const std::vector<std::string>& knownColorSpaces();
/// XYZ from linear RGB of one of them (CIE 1931, its own white: D65, or ACES white near D60). Throws usage where the
/// name is none of them nor an alias (lin_srgb, lin_ap1, lin_ap0 ...).
Mat3 xyzFromColorSpace(const std::string& name);
/// The matrix between two of them: primaries, and white by Bradford's adaptation (SMPTE RP 177; Lindbloom).
Mat3 colorMatrix(const std::string& from, const std::string& to);

/// A conversion of whole images. Values may be negative or above 1; NaN in a channel makes all three NaN.
class ColorConversion {
 public:
  /// Names are those of OCIO's configuration where $OCIO is set (ours are looked up there under their usual aliases
  /// first); names that it lacks are ours. Throws usage for a name that neither knows, listing those that are known,
  /// and bad_input where $OCIO cannot be read.
  ColorConversion(const std::string& from, const std::string& to);
  ~ColorConversion();
  ColorConversion(ColorConversion&&) noexcept;
  /// Converts the first three channels of an image with 3 or 4; grey is left as it is.
  void apply(ImageF& image) const;
  bool identity() const;
  /// "matrix", "OCIO /path/config.ocio" or "none", for the record.
  const std::string& means() const;

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace srf
