#include "acquire/develop.h"

#include <gtest/gtest.h>

#include <cmath>
#include <cstdio>
#include <random>

#include "base/error.h"
#include "base/files.h"
#include "base/numeric.h"
#include "tests/support/test_support.h"

namespace srf {
namespace {

// A camera of full well 1 with shot noise, read noise and 12 bits.
float shoot(double radiance, double amount, std::mt19937_64& random) {
  std::normal_distribution<double> normal;
  const double x = radiance * amount;
  const double noisy = x + std::sqrt(x / 8000) * normal(random) + 0.0005 * normal(random);
  return static_cast<float>(std::round(4095 * std::clamp(noisy, 0.0, 1.0)) / 4095);
}

TEST(Develop, ALinearBracketIsLessNoisyThanItsBestExposureAndMasksSaturation) {
  std::mt19937_64 random(3);
  const double amounts[] = {0.25, 0.5, 1, 2, 4};
  std::vector<Exposure> bracket;
  ImageF truth(60, 200, 3);
  for (int y = 0; y < 200; ++y)
    for (int x = 0; x < 60; ++x)
      for (int c = 0; c < 3; ++c)  // from 0.02 to 5: at 3.95 and more the shortest exposure is saturated
        truth.at(x, y, c) = static_cast<float>(0.02 * std::pow(250, y / 199.0));
  for (const double amount : amounts) {
    Exposure e{ImageF(60, 200, 3), amount, true};
    for (std::size_t i = 0; i < truth.data().size(); ++i) e.pixels.data()[i] = shoot(truth.data()[i], amount, random);
    bracket.push_back(e);
  }
  const Merged merged = mergeExposures(bracket, CameraResponse::linear(), {});
  // Row by row: the variance of the merge against the longest exposure that is far from saturated.
  int better = 0, rows = 0;
  double total_bias = 0;
  for (int y = 0; y < 200; ++y) {
    const double t = truth.at(0, y);
    double best_amount = 0;
    std::size_t best = 0;
    for (std::size_t k = 0; k < bracket.size(); ++k)
      if (amounts[k] * t < 0.85 && amounts[k] > best_amount) best_amount = amounts[k], best = k;
    if (best_amount <= 0.25) continue;  // one exposure alone is usable: nothing to gain
    double merged_squares = 0, single_squares = 0, bias = 0;
    for (int x = 0; x < 60; ++x)
      for (int c = 0; c < 3; ++c) {
        merged_squares += square(merged.radiance.at(x, y, c) - t);
        single_squares += square(bracket[best].pixels.at(x, y, c) / best_amount - t);
        bias += (merged.radiance.at(x, y, c) / t - 1) / 180;
      }
    better += merged_squares < single_squares;
    ++rows;
    total_bias += std::fabs(bias);
    EXPECT_LT(merged_squares, 1.1 * single_squares) << y;
  }
  EXPECT_GT(better, 0.9 * rows) << better << " of " << rows;
  EXPECT_LT(total_bias / rows, 2e-3);
  // Saturated everywhere: masked, counted, and nothing but those.
  std::size_t masked = 0;
  for (int y = 0; y < 200; ++y)
    for (int x = 0; x < 60; ++x) {
      const bool nan = std::isnan(merged.radiance.at(x, y, 0));
      masked += nan;
      const double in_shortest = truth.at(x, y) * 0.25;
      EXPECT_TRUE(nan || in_shortest < 1.05) << y;
      EXPECT_TRUE(!nan || in_shortest > 0.9) << y;
    }
  EXPECT_EQ(merged.saturated_pixels, masked);
  EXPECT_GT(masked, 0u);
}

TEST(Develop, SaturatedSamplesAreMaskedNotAveraged) {
  // 4 saturated in the long exposure: an average would pull its radiance down.
  std::vector<Exposure> bracket{{ImageF(1, 1, 3, 0.5f), 1, true}, {ImageF(1, 1, 3, 1.f), 16, true}};
  EXPECT_FLOAT_EQ(mergeExposures(bracket, CameraResponse::linear(), {}).radiance.at(0, 0), 0.5f);
  // Black in the short one: 0 / 1 is no measurement.
  bracket = {{ImageF(1, 1, 3, 0.005f), 1, true}, {ImageF(1, 1, 3, 0.2f), 16, true}};
  EXPECT_FLOAT_EQ(mergeExposures(bracket, CameraResponse::linear(), {}).radiance.at(0, 0), 0.2f / 16);
  // Black in all: what the longest measured, counted.
  bracket = {{ImageF(1, 1, 3, 0.f), 1, true}, {ImageF(1, 1, 3, 0.004f), 16, true}};
  const Merged dark = mergeExposures(bracket, CameraResponse::linear(), {});
  EXPECT_FLOAT_EQ(dark.radiance.at(0, 0), 0.004f / 16);
  EXPECT_EQ(dark.dark_pixels, 1u);
  // One channel saturated in all: the colour is unknown.
  ImageF red(1, 1, 3, 0.3f);
  red.at(0, 0, 0) = 1;
  const Merged clipped = mergeExposures({{red, 1, true}}, CameraResponse::linear(), {});
  for (int c = 0; c < 3; ++c) EXPECT_TRUE(std::isnan(clipped.radiance.at(0, 0, c)));
  EXPECT_EQ(clipped.saturated_pixels, 1u);
}

TEST(Develop, AResponseIsMeasuredFromABracketAndComesBackFromItsFile) {
  // A camera with the curve x^(1/2.2) in 8 bits; a scene of all brightnesses.
  std::mt19937_64 random(5);
  std::normal_distribution<double> normal;
  std::vector<Exposure> bracket;
  const int w = 160, h = 120;
  for (int k = 0; k < 7; ++k) {
    Exposure e{ImageF(w, h, 3), std::pow(2.0, k - 3), false};
    for (int y = 0; y < h; ++y)
      for (int x = 0; x < w; ++x)
        for (int c = 0; c < 3; ++c) {
          const double radiance = 0.02 * std::pow(100, (x + 0.3 * y) / (w + 0.3 * h)) * (1 + 0.2 * c);
          const double z = std::pow(std::min(1.0, radiance * e.amount), 1 / 2.2) + 0.003 * normal(random);
          e.pixels.at(x, y, c) = static_cast<float>(std::round(255 * std::clamp(z, 0.0, 1.0)) / 255);
        }
    bracket.push_back(e);
  }
  const CameraResponse response = measureResponse(bracket);
  for (int c = 0; c < 3; ++c)
    for (const double z : {0.2, 0.35, 0.7, 0.9}) {
      const double expected = std::pow(z / 0.5, 2.2);
      const double got = response.exposure(c, static_cast<float>(z)) / response.exposure(c, 0.5f);
      EXPECT_NEAR(got / expected, 1, 0.05) << c << " at " << z;
    }
  const test::TemporaryFolder folder;
  response.write(folder / "response.csv");
  const CameraResponse back = CameraResponse::read(folder / "response.csv");
  for (int i = 0; i < 256; ++i) EXPECT_EQ(back.exposure(1, i / 255.f), response.exposure(1, i / 255.f));
  // The merge by it is the scene up to one factor.
  const Merged merged = mergeExposures(bracket, response, {});
  double low = INFINITY, high = 0;
  for (int x = 10; x < w - 10; x += 3) {
    const double truth = 0.02 * std::pow(100, (x + 0.3 * 60) / (w + 0.3 * h));
    low = std::min(low, merged.radiance.at(x, 60, 0) / truth);
    high = std::max(high, merged.radiance.at(x, 60, 0) / truth);
  }
  EXPECT_LT(high / low, 1.12);
  EXPECT_THROW(measureResponse({bracket[0]}), Error);
  EXPECT_THROW(measureResponse({bracket[0], bracket[0]}), Error);
  writeTextFile(folder / "broken.csv", "0,1,2\n");
  EXPECT_THROW(CameraResponse::read(folder / "broken.csv"), Error);
}

TEST(Develop, DarkFrameAndFlatFieldAreUndone) {
  const int w = 200, h = 150;
  const auto vignetting = [&](int x, int y) { return 1 - 0.5 * (square((x - 99.5) / 100) + square((y - 74.5) / 100)); };
  std::mt19937_64 random(9);
  std::normal_distribution<double> normal;
  ImageF photo(w, h, 3), dark(w, h, 3), white(w, h, 3);
  for (int y = 0; y < h; ++y)
    for (int x = 0; x < w; ++x)
      for (int c = 0; c < 3; ++c) {
        dark.at(x, y, c) = static_cast<float>(0.01 + 0.02 * ((x * 7 + y * 3) % 11) / 11);  // hot pixels
        photo.at(x, y, c) = static_cast<float>(0.4 * vignetting(x, y) + dark.at(x, y, c));
        white.at(x, y, c) = static_cast<float>(0.8 * vignetting(x, y) * (1 + 0.003 * normal(random)));
      }
  Merged merged = mergeExposures({{photo, 1, true}}, CameraResponse::linear(), {}, {dark});
  divideByFlat(merged.radiance, flatField(white));
  double worst = 0;
  for (const float v : merged.radiance.data()) worst = std::max(worst, std::fabs(v / 0.4 - 1));
  EXPECT_LT(worst, 0.015) << "the corners have the flat field's noise unsmoothed";
  EXPECT_THROW(flatField(ImageF(w, h, 3)), Error);
  EXPECT_THROW(mergeExposures({{photo, 1, true}}, CameraResponse::linear(), {}, {ImageF(3, 3, 3)}), Error);
}

Intrinsics barrel() {
  Intrinsics lens;
  lens.model = CameraModel::opencv;
  lens.width = 160, lens.height = 120;
  lens.fl_x = lens.fl_y = 130, lens.cx = 81, lens.cy = 58;
  lens.k1 = -0.25, lens.k2 = 0.05, lens.p1 = 0.002, lens.p2 = -0.001;
  return lens;
}

// Area of an old pixel in the new picture: the energy of a pixel is its radiance times that.
double areaInPinhole(const Intrinsics& lens, const Intrinsics& pinhole, int x, int y) {
  Vec2 p[4];
  for (int k = 0; k < 4; ++k) {
    const auto d = lens.unproject({x + (k == 1 || k == 2 ? 1.0 : 0.0), y + (k >= 2 ? 1.0 : 0.0)});
    p[k] = *pinhole.project(Point<CameraSpace>(d->raw()));
  }
  double sum = 0;
  for (int k = 0; k < 4; ++k) sum += p[k].x * p[(k + 1) % 4].y - p[(k + 1) % 4].x * p[k].y;
  return 0.5 * std::fabs(sum);
}

TEST(Develop, UndistortionKeepsTheEnergyOfEveryDetail) {
  const Intrinsics lens = barrel();
  const Undistortion undistortion(lens);
  EXPECT_EQ(undistortion.lens().model, CameraModel::pinhole);
  std::mt19937_64 random(1);
  double worst = 0;
  for (int trial = 0; trial < 40; ++trial) {
    ImageF image(160, 120, 3);
    // A single bright pixel, as a highlight: a bilinear fetch may pass it by.
    const int x = 12 + static_cast<int>(random() % 136), y = 12 + static_cast<int>(random() % 96);
    for (int c = 0; c < 3; ++c) image.at(x, y, c) = 1000;
    const ImageF out = undistortion.apply(image);
    double sum = 0;
    for (int v = 0; v < 120; ++v)
      for (int u = 0; u < 160; ++u)
        if (std::isfinite(out.at(u, v, 1))) sum += out.at(u, v, 1);
    worst = std::max(worst, std::fabs(sum / (1000 * areaInPinhole(lens, undistortion.lens(), x, y)) - 1));
  }
  // A pixel's area varies by up to 1 % across it at this lens's corners, where its sides are also bent.
  EXPECT_LT(worst, 5e-3);
  ImageF image(160, 120, 3);
  double before = 0, after = 0;
  for (int y = 10; y < 110; ++y)
    for (int x = 10; x < 150; ++x) {
      image.at(x, y, 0) = static_cast<float>(random() % 1000);
      before += image.at(x, y, 0) * areaInPinhole(lens, undistortion.lens(), x, y);
    }
  const ImageF out = undistortion.apply(image);
  for (std::size_t i = 0; i < out.data().size(); i += 3)
    if (std::isfinite(out.data()[i])) after += out.data()[i];
  EXPECT_NEAR(after / before, 1, 1e-3);
}

TEST(Develop, UndistortionKeepsEvenPicturesAndMasksAndPutsPointsWhereThePinholeSeesThem) {
  const Intrinsics lens = barrel();
  const Undistortion undistortion(lens);
  ImageF even(160, 120, 3, 0.7f);
  even.at(80, 60, 1) = NAN;
  const ImageF out = undistortion.apply(even);
  std::size_t masked = 0;
  for (const float v : out.data())
    if (std::isnan(v))
      ++masked;
    else
      EXPECT_NEAR(v, 0.7f, 1e-6);
  EXPECT_GT(masked, 0u);
  EXPECT_LT(masked, 3u * 16) << "what a NaN touches, no more: this barrel's corners stay inside";
  // A spot of 3 x 3 pixels comes to lie where the pinhole camera projects its ray.
  Image8 mask(160, 120, 1);
  const Vec3 ray{0.35, -0.25, 1};
  const Vec2 from = *lens.project(Point<CameraSpace>(ray));
  ImageF spot(160, 120, 1);
  for (int dy = -2; dy <= 2; ++dy)
    for (int dx = -2; dx <= 2; ++dx) {
      const int x = static_cast<int>(from.x) + dx, y = static_cast<int>(from.y) + dy;
      spot.at(x, y) = static_cast<float>(std::max(0.0, 1 - std::fabs(x + 0.5 - from.x) / 2) *
                                         std::max(0.0, 1 - std::fabs(y + 0.5 - from.y) / 2));
      mask.at(x, y) = 255;
    }
  const ImageF moved = undistortion.apply(spot);
  double sum = 0, sx = 0, sy = 0;
  for (int y = 0; y < 120; ++y)
    for (int x = 0; x < 160; ++x)
      if (moved.at(x, y) > 0) sum += moved.at(x, y), sx += moved.at(x, y) * (x + 0.5), sy += moved.at(x, y) * (y + 0.5);
  const Vec2 to = *undistortion.lens().project(Point<CameraSpace>(ray));
  EXPECT_GT(std::hypot(to.x - from.x, to.y - from.y), 2) << "the lens must bend something for the check to count";
  EXPECT_NEAR(sx / sum, to.x, 0.05);
  EXPECT_NEAR(sy / sum, to.y, 0.05);
  double area = 0;
  const Image8 moved_mask = undistortion.apply(mask);
  for (const std::uint8_t v : moved_mask.data()) area += v / 255.0;
  double expected = 0;
  for (int y = 0; y < 120; ++y)
    for (int x = 0; x < 160; ++x)
      if (mask.at(x, y) > 0) expected += areaInPinhole(lens, undistortion.lens(), x, y);
  EXPECT_NEAR(area / expected, 1, 2e-3);
}

// ---- Debevec and Malik's church ----

TEST(Develop, MemorialChurchMergesToThePublishedRadiance) {
  SRF_REQUIRE_DATA(data, "hdr-memorial");
  std::vector<Exposure> bracket;
  for (int i = 61; i <= 68; ++i) {
    const Photograph photo = readPhotograph(data / ("memorial00" + std::to_string(i) + ".png"));
    bracket.push_back({photo.pixels, 32 / std::pow(2.0, i - 61), false});
  }
  MergeOptions options;
  options.ignored = {{0, 0, 1}};
  const CameraResponse response = measureResponse(bracket, options.ignored);
  const Merged merged = mergeExposures(bracket, response, options);
  const ImageF published = readImage(data / "memorial.hdr").pixels;
  ASSERT_EQ(published.width(), merged.radiance.width());
  double n = 0, a = 0, b = 0, aa = 0, bb = 0, ab = 0;
  for (int y = 0; y < published.height(); ++y)
    for (int x = 0; x < published.width(); ++x) {
      bool border = false;
      for (const Exposure& e : bracket)
        border = border || (e.pixels.at(x, y, 0) == 0 && e.pixels.at(x, y, 1) == 0 && e.pixels.at(x, y, 2) == 1);
      for (int c = 0; c < 3 && !border; ++c) {
        const double u = merged.radiance.at(x, y, c), v = published.at(x, y, c);
        if (!(u > 0) || !(v > 0)) continue;
        const double p = std::log(u), q = std::log(v);
        ++n, a += p, b += q, aa += p * p, bb += q * q, ab += p * q;
      }
    }
  const double correlation = (n * ab - a * b) / std::sqrt((n * aa - a * a) * (n * bb - b * b));
  std::printf("memorial church: correlation of log radiance %.4f over %.0f samples; %zu pixels saturated in all 8\n",
              correlation, n, merged.saturated_pixels);
  EXPECT_GE(correlation, 0.98);
}

}  // namespace
}  // namespace srf
