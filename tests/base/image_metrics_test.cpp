// The expected numbers are those of scikit-image 0.26 and NVIDIA's flip-evaluator 1.7 on the same formula images.
#include "base/image_metrics.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>

#include "base/error.h"

namespace srf {
namespace {

constexpr int kWidth = 48, kHeight = 40;

/// A ball with a texture and a highlight, moved by `shift` pixels and brightened by `gain`.
ImageF ball(double shift, double gain) {
  ImageF image(kWidth, kHeight, 3);
  for (int y = 0; y < kHeight; ++y)
    for (int x = 0; x < kWidth; ++x) {
      const double u = x + shift, r2 = std::pow((u - 24) / 18, 2) + std::pow((y - 20) / 15.0, 2);
      const double n = std::sqrt(std::fmax(0, 1 - r2)), highlight = 1.5 * std::pow(n, 30);
      const double colour[3] = {.6 + .3 * std::sin(u / 3), .5 + .3 * std::sin(y / 4.0),
                                .4 + .2 * std::cos((u + y) / 5)};
      for (int c = 0; c < 3; ++c) image.at(x, y, c) = static_cast<float>((n * colour[c] + highlight) * gain);
    }
  return image;
}
ImageF ballMask() {
  ImageF mask(kWidth, kHeight, 1);
  for (int y = 0; y < kHeight; ++y)
    for (int x = 0; x < kWidth; ++x) mask.at(x, y) = std::pow((x - 24) / 18.0, 2) + std::pow((y - 20) / 15.0, 2) < 1;
  return mask;
}

struct Expected {
  double shift, gain;
  MetricFigures inside, full;
  double bias;
};
constexpr Expected kExpected[] = {
    {0, 1.1, {655, 31.9288842, .0099389, .9981153, .1452232}, {1920, 36.4474154, .0042960, .9987241, .0703296}, .1},
    {1.5,
     1,
     {655, 25.2102019, .0444932, .8598242, .2291726},
     {1920, 28.8511429, 1.0334925, .8195332, .1521390},
     -.0053689},
    {.25,
     .97,
     {655, 38.5284632, .0019751, .9905705, .0750076},
     {1920, 42.0376772, .0649244, .9786166, .0471612},
     -.0299297},
};

// The tools work in single precision for FLIP and round to seven digits here.
void expectFigures(const MetricFigures& found, const MetricFigures& expected) {
  EXPECT_EQ(found.pixels, expected.pixels);
  EXPECT_NEAR(found.psnr, expected.psnr, 1e-4);
  EXPECT_NEAR(found.relative_mse, expected.relative_mse, 1e-6);
  EXPECT_NEAR(found.ssim, expected.ssim, 2e-6);
  EXPECT_NEAR(found.flip, expected.flip, 2e-5);
}

TEST(ImageMetrics, AgreeWithTheReferenceTools) {
  const ImageF reference = ball(0, 1), mask = ballMask();
  for (const Expected& e : kExpected) {
    SCOPED_TRACE(testing::Message() << "shift " << e.shift << " gain " << e.gain);
    const ImageDifference d = compareImages(ball(e.shift, e.gain), reference, mask);
    EXPECT_NEAR(d.peak, 2.3501112, 1e-6);
    EXPECT_NEAR(d.bias, e.bias, 1e-6);
    expectFigures(d.inside, e.inside);
    expectFigures(d.full, e.full);
  }
}

TEST(ImageMetrics, EqualImagesHaveNoDifference) {
  const ImageF image = ball(0, 1);
  const ImageDifference d = compareImages(image, image);
  EXPECT_GT(d.full.psnr, 200);
  EXPECT_EQ(d.full.flip, 0);
  EXPECT_NEAR(d.full.ssim, 1, 1e-12);
}

TEST(ImageMetrics, GreyCountsAsThreeEqualChannels) {
  ImageF grey(20, 20, 1), colour(20, 20, 3), brighter(20, 20, 1);
  for (int y = 0; y < 20; ++y)
    for (int x = 0; x < 20; ++x) {
      grey.at(x, y) = static_cast<float>(x + 1) / 20;
      brighter.at(x, y) = 1.1f * grey.at(x, y);
      for (int c = 0; c < 3; ++c) colour.at(x, y, c) = grey.at(x, y);
    }
  EXPECT_EQ(compareImages(brighter, grey).full.flip, compareImages(brighter, colour).full.flip);
}

TEST(ImageMetrics, RelativeErrorIsOverWhatEitherPictureShows) {
  ImageF reference(40, 30, 3), image(40, 30, 3);
  const auto paint = [](ImageF& picture, int x, float r, float g, float b) {
    for (int y = 0; y < 30; ++y) picture.at(x, y, 0) = r, picture.at(x, y, 1) = g, picture.at(x, y, 2) = b;
  };
  for (int x = 0; x < 10; ++x) paint(reference, x, 2, 1, 0.5f), paint(image, x, 2, 1.2f, 0.5f);
  paint(image, 10, 0, 0.01f, 0);  // shown where nothing is
  const ImageDifference d = compareImages(image, reference);
  EXPECT_NEAR(d.peak, 2, 1e-6);
  EXPECT_NEAR(d.relative_error, (10 * 0.2 / 2.02 + 0.01 / 0.02) / 11, 1e-6);
  EXPECT_NEAR(d.relative_error_tail, 0.01 / 0.02, 1e-6);
}

TEST(ImageMetrics, PixelsThatAreNotFiniteAreCountedAndMeasuredAsBlack) {
  const ImageF reference = ball(0, 1);
  ImageF image = reference, holes = reference;
  image.at(24, 20, 0) = std::numeric_limits<float>::quiet_NaN();
  image.at(24, 20, 1) = std::numeric_limits<float>::infinity();
  image.at(30, 20, 2) = -std::numeric_limits<float>::infinity();
  holes.at(24, 20, 0) = holes.at(24, 20, 1) = holes.at(30, 20, 2) = 0;
  const ImageDifference found = compareImages(image, reference), expected = compareImages(holes, reference);
  EXPECT_EQ(found.not_finite, 2u);
  EXPECT_EQ(found.full.psnr, expected.full.psnr);
  EXPECT_EQ(found.full.flip, expected.full.flip);
}

TEST(ImageMetrics, RefusesWhatCannotBeCompared) {
  const ImageF reference = ball(0, 1);
  EXPECT_THROW(compareImages(ImageF(48, 39, 3), reference), Error);
  EXPECT_THROW(compareImages(reference, reference, ImageF(40, 48, 1, 1.f)), Error);
  EXPECT_THROW(compareImages(reference, reference, ImageF(kWidth, kHeight, 1, 0.f)), Error);
  ImageF broken = reference;
  broken.at(3, 3, 1) = std::numeric_limits<float>::quiet_NaN();
  EXPECT_THROW(compareImages(reference, broken), Error);
}

TEST(ImageMetrics, BlackAndTinyImagesGiveFiniteFigures) {
  for (const auto& [width, height] : {std::pair{1, 1}, {2, 9}, {30, 20}}) {
    const ImageDifference d = compareImages(ImageF(width, height, 3, 0.5f), ImageF(width, height, 3));
    for (const MetricFigures* f : {&d.inside, &d.full})
      EXPECT_TRUE(std::isfinite(f->psnr) && std::isfinite(f->relative_mse) && std::isfinite(f->ssim) &&
                  std::isfinite(f->flip));
    EXPECT_EQ(d.inside.pixels, d.full.pixels);
  }
}

}  // namespace
}  // namespace srf
