#include "base/color.h"

#include <gtest/gtest.h>

#include <cmath>
#include <cstdlib>
#include <random>

#include "base/error.h"
#include "base/files.h"
#include "tests/support/test_support.h"

namespace srf {
namespace {

/// Sets OCIO for the life of the object.
struct Ocio {
  explicit Ocio(const std::string& file) { setenv("OCIO", file.c_str(), 1); }
  ~Ocio() { unsetenv("OCIO"); }
};

double largestDifference(const Mat3& a, const Mat3& b) {
  double most = 0;
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) most = std::max(most, std::fabs(a.row[i][j] - b.row[i][j]));
  return most;
}

TEST(Color, MatricesAreThosePublished) {
  // IEC 61966-2-1, and the ACES reference implementation (AP0 to XYZ; AP1 to AP0).
  const Mat3 rec709{{Vec3{0.4124, 0.3576, 0.1805}, Vec3{0.2126, 0.7152, 0.0722}, Vec3{0.0193, 0.1192, 0.9505}}};
  EXPECT_LT(largestDifference(xyzFromColorSpace("lin_rec709"), rec709), 1e-4);
  const Mat3 ap0{
      {Vec3{0.9525523959, 0, 0.0000936786}, Vec3{0.3439664498, 0.7281660966, -0.0721325464}, Vec3{0, 0, 1.0088251844}}};
  EXPECT_LT(largestDifference(xyzFromColorSpace("ACES2065-1"), ap0), 1e-8);
  const Mat3 ap1_to_ap0{{Vec3{0.6954522414, 0.1406786965, 0.1638690622}, Vec3{0.0447945634, 0.8596711185, 0.0955343182},
                         Vec3{-0.0055258826, 0.0040252103, 1.0015006723}}};
  EXPECT_LT(largestDifference(colorMatrix("ACEScg", "ACES2065-1"), ap1_to_ap0), 1e-8);
  // OpenColorIO's configuration for ACES, AP1 to linear Rec.709, white adapted by Bradford.
  const Mat3 ap1_to_rec709{
      {Vec3{1.70505, -0.62179, -0.08326}, Vec3{-0.13026, 1.14080, -0.01055}, Vec3{-0.02400, -0.12897, 1.15297}}};
  EXPECT_LT(largestDifference(colorMatrix("ACEScg", "lin_rec709"), ap1_to_rec709), 2e-5);
}

TEST(Color, EveryPairComesBackAndWhiteStaysWhite) {
  for (const std::string& a : knownColorSpaces())
    for (const std::string& b : knownColorSpaces()) {
      EXPECT_LT(largestDifference(colorMatrix(a, b) * colorMatrix(b, a), Mat3{}), 1e-14) << a << " " << b;
      const Vec3 white = colorMatrix(a, b) * Vec3{1, 1, 1};
      EXPECT_LT(length(white - Vec3{1, 1, 1}), 1e-12) << a << " " << b;
    }
  std::mt19937_64 random(1);
  std::uniform_real_distribution<float> value(-0.1f, 4.f);
  ImageF image(9, 7, 3);
  for (float& v : image.data()) v = value(random);
  image.at(4, 4, 2) = NAN;
  ImageF turned = image;
  ColorConversion("ACEScg", "lin_rec709").apply(turned);
  ColorConversion("lin_rec709", "ACEScg").apply(turned);
  for (int y = 0; y < 7; ++y)
    for (int x = 0; x < 9; ++x)
      for (int c = 0; c < 3; ++c)
        if (x == 4 && y == 4)
          EXPECT_TRUE(std::isnan(turned.at(x, y, c)));
        else
          EXPECT_NEAR(turned.at(x, y, c), image.at(x, y, c), 1e-5);
}

TEST(Color, UnknownNamesAreRefused) {
  unsetenv("OCIO");
  for (const auto& [from, to] :
       {std::pair{"sRGB-ish", "ACEScg"}, std::pair{"ACEScg", "Rec.2020"}, std::pair{"nothing", "nothing"}}) {
    try {
      ColorConversion conversion(from, to);
      ADD_FAILURE() << from << " " << to;
    } catch (const Error& e) {
      EXPECT_EQ(e.kind(), ErrorKind::usage);
      EXPECT_NE(std::string(e.what()).find("lin_rec709, ACEScg, ACES2065-1"), std::string::npos) << e.what();
    }
  }
}

TEST(Color, AConfigurationNamedByOcioIsHonoured) {
  const test::TemporaryFolder folder;
  // A space that is twice as bright as its reference, and one of ours by an alias.
  writeTextFile(folder / "config.ocio", R"(ocio_profile_version: 1
search_path: ""
roles:
  default: lin_srgb
  scene_linear: lin_srgb
displays:
  sRGB:
    - !<View> {name: Raw, colorspace: lin_srgb}
colorspaces:
  - !<ColorSpace>
    name: lin_srgb
    isdata: false
  - !<ColorSpace>
    name: Stage B camera
    isdata: false
    to_reference: !<MatrixTransform> {matrix: [2, 0, 0, 0, 0, 2, 0, 0, 0, 0, 2, 0, 0, 0, 0, 1]}
)");
  const Ocio ocio(folder / "config.ocio");
  ImageF image(3, 2, 3, 0.25f);
  const ColorConversion conversion("Stage B camera", "lin_rec709");
  EXPECT_EQ(conversion.means(), "OCIO " + (folder / "config.ocio").string());
  conversion.apply(image);
  for (const float v : image.data()) EXPECT_NEAR(v, 0.5f, 1e-6);
  // A pair that only we know is ours still.
  EXPECT_EQ(ColorConversion("ACEScg", "lin_rec709").means(), "matrix");
  try {
    ColorConversion("Stage C camera", "lin_rec709");
    ADD_FAILURE();
  } catch (const Error& e) {
    EXPECT_NE(std::string(e.what()).find("Stage B camera"), std::string::npos) << e.what();
  }
  setenv("OCIO", "/nowhere/config.ocio", 1);
  EXPECT_THROW(ColorConversion("ACEScg", "lin_rec709"), Error);
}

}  // namespace
}  // namespace srf
