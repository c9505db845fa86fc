#include "acquire/mirror_ball.h"

#include <gtest/gtest.h>

#include <cstdio>
#include <random>

#include "acquire/light_calibration.h"
#include "base/error.h"
#include "base/image_io.h"
#include "base/numeric.h"
#include "tests/acquire/ball_pictures.h"
#include "tests/support/test_support.h"

namespace srf {
namespace {

using test::BallPicture;

Intrinsics wideLens() {
  Intrinsics lens = pinholeFromFov(320, 240, 50);
  lens.model = CameraModel::opencv;
  lens.k1 = -0.12, lens.k2 = 0.03, lens.p1 = 0.001, lens.p2 = -0.002;
  return lens;
}

ImageF meanOf(const std::vector<ImageF>& images) {
  ImageF mean(images[0].width(), images[0].height(), 1);
  for (const ImageF& image : images)
    for (std::size_t i = 0; i < mean.data().size(); ++i)
      mean.data()[i] += image.data()[i] / static_cast<float>(images.size());
  return mean;
}

// A circle near the ball's outline, as a user would click it: off by some pixels.
ImageCircle roughCircle(const Intrinsics& lens, const Ball& ball) {
  ImageCircle circle;
  const auto pixels = outlinePixels(lens, *outlineOfBall(lens, ball), 32);
  for (const Vec2& p : pixels)
    circle.center.x += p.x / static_cast<double>(pixels.size()),
        circle.center.y += p.y / static_cast<double>(pixels.size());
  for (const Vec2& p : pixels)
    circle.radius += std::hypot(p.x - circle.center.x, p.y - circle.center.y) / static_cast<double>(pixels.size());
  circle.center.x += 2.5, circle.center.y -= 2;
  circle.radius *= 1.04;
  return circle;
}

TEST(MirrorBall, OutlineAndBallAreInverse) {
  for (const Intrinsics& lens : {wideLens(), test::orthographicLens(300, 200, 80)}) {
    const Ball ball{Point<CameraSpace>(0.4, -0.3, lens.isOrthographic() ? 0 : 3), 0.5};
    const Ball back = ballFromOutline(lens, *outlineOfBall(lens, ball), 0.5);
    EXPECT_LT(distance(ball.center, back.center), 1e-12);
    EXPECT_NEAR(back.radius, 0.5, 1e-12);
  }
}

TEST(MirrorBall, ReflectionIsTheMirrorLawAtTheBall) {
  const Intrinsics lens = wideLens();
  const Ball ball{Point<CameraSpace>(0.4, -0.3, 3), 0.5};
  const auto pixel = lens.project(Point<CameraSpace>(0.3, -0.2, 2.6));
  const auto r = reflectionAt(lens, ball, *pixel);
  ASSERT_TRUE(r);
  EXPECT_NEAR(distance(r->point, ball.center), 0.5, 1e-12);
  const Vec3 n = (r->point - ball.center).raw() / 0.5, v = -r->point.raw() / length(r->point.raw());
  EXPECT_NEAR(dot(n, v), dot(n, r->direction.raw()), 1e-12);
  EXPECT_NEAR(dot(cross(n, v), r->direction.raw()), 0, 1e-12);
  EXPECT_FALSE(reflectionAt(lens, ball, {2, 2}));
}

TEST(MirrorBall, LightsOfARenderedBallAreFoundToATenthOfADegree) {
  for (const bool orthographic : {false, true}) {
    const Intrinsics lens = orthographic ? test::orthographicLens(320, 240, 150) : wideLens();
    const Ball ball{Point<CameraSpace>(0.35, -0.2, orthographic ? 0 : 2), 0.5};
    std::vector<ImageF> images;
    std::vector<Vec3> lights;
    for (int i = 0; i < 6; ++i) {
      const double z = -0.9 + 0.18 * i, r = std::sqrt(1 - z * z);
      lights.push_back({r * std::cos(1.9 * i), r * std::sin(1.9 * i), z});
      BallPicture picture{lens, ball};
      picture.noise = 0.002;
      picture.seed = 10 + i;
      images.push_back(test::mirrorPicture(picture, [&](const Vec3&, const Vec3& direction) {
        return angleBetweenUnit(direction, lights.back()) < radians(2.0) ? 20.0 : 0.02;
      }));
    }
    const auto fitted = fitOutline(meanOf(images), lens, outlineFromCircle(lens, roughCircle(lens, ball)));
    EXPECT_GT(fitted.covered, 0.9);
    EXPECT_LT(fitted.rms, 0.3);
    const Vec3 off = fitted.outline - *outlineOfBall(lens, ball);
    for (int k = 0; k < 3; ++k) EXPECT_LT(std::fabs(off[k]), 5 * std::sqrt(fitted.covariance.row[k][k]) + 2e-4) << k;
    for (std::size_t i = 0; i < lights.size(); ++i) {
      const auto highlight = findHighlight(images[i], lens, fitted.outline);
      ASSERT_TRUE(highlight) << i;
      MirrorSighting sighting{{lens, {}}, fitted, 1, *highlight};
      const auto estimate = estimateDistant({&sighting, 1});
      ASSERT_TRUE(estimate);
      const double degrees_off = degrees(angleBetweenUnit(estimate->direction.raw(), lights[i]));
      EXPECT_LT(degrees_off, 0.1) << (orthographic ? "orthographic " : "perspective ") << i;
      EXPECT_LT(degrees_off, 4 * degrees(estimate->sigma)) << i;
    }
  }
}

TEST(MirrorBall, ABallWithoutASpotHasNoHighlight) {
  const Intrinsics lens = wideLens();
  const Ball ball{Point<CameraSpace>(0, 0, 2), 0.5};
  BallPicture picture{lens, ball};
  picture.noise = 0.001;
  const ImageF dull = test::mirrorPicture(picture, [](const Vec3&, const Vec3&) { return 0.02; });
  EXPECT_FALSE(findHighlight(dull, lens, *outlineOfBall(lens, ball)));
  EXPECT_FALSE(findHighlight(ImageF(320, 240, 1), lens, *outlineOfBall(lens, ball)));
}

TEST(MirrorBall, MaskedSaturatedPixelsAreTheHighlight) {
  const Intrinsics lens = wideLens();
  const Ball ball{Point<CameraSpace>(0, 0, 2), 0.5};
  ImageF image(320, 240, 1, 0.01f);
  for (int y = 100; y < 103; ++y)
    for (int x = 170; x < 175; ++x) image.at(x, y) = NAN;
  const auto highlight = findHighlight(image, lens, *outlineOfBall(lens, ball));
  ASSERT_TRUE(highlight);
  EXPECT_NEAR(highlight->pixel.x, 172.5, 1e-9);
  EXPECT_NEAR(highlight->pixel.y, 101.5, 1e-9);
}

TEST(MirrorBall, AnEmptyPictureHasNoOutlineAndSaysHowToMendIt) {
  const Intrinsics lens = wideLens();
  try {
    fitOutline(ImageF(320, 240, 1, 0.5f), lens, outlineFromCircle(lens, {{160, 120}, 60}));
    FAIL();
  } catch (const Error& e) {
    EXPECT_NE(std::string(e.what()).find("give a circle nearer to it"), std::string::npos) << e.what();
  }
}

// 40 near lights, each seen in two balls with outlines and highlights drawn about the truth by their stated deviations:
// the squared error over the stated covariance follows chi squared of three degrees of freedom.
TEST(MirrorBall, TwoBallsGiveANearLightWithinItsStatedUncertainty) {
  const Intrinsics lens = wideLens();
  const Ball balls[] = {{Point<CameraSpace>(-0.5, 0.1, 2.2), 0.2}, {Point<CameraSpace>(0.5, -0.1, 2), 0.2}};
  std::mt19937_64 random(5);
  std::normal_distribution<double> normal;
  double chi2 = 0, worst = 0;
  int count = 0;
  for (int i = 0; i < 40; ++i) {
    const Vec3 light{1.2 * std::cos(0.7 * i), 0.9 * std::sin(0.7 * i), 0.4 + 0.01 * i};
    std::vector<MirrorSighting> sightings;
    for (const Ball& ball : balls) {
      MirrorSighting s;
      s.camera.lens = lens;
      s.ball_radius = ball.radius;
      s.outline.outline = *outlineOfBall(lens, ball);
      const double d = 2e-5;
      s.outline.covariance = {{Vec3{d * d, 0, 0}, Vec3{0, d * d, 0}, Vec3{0, 0, d * d}}};
      for (int k = 0; k < 3; ++k) s.outline.outline[k] += d * normal(random);
      s.highlight.pixel = test::highlightPixel(lens, ball, light);
      s.highlight.sigma = 0.1;
      s.highlight.pixel.x += 0.1 * normal(random);
      s.highlight.pixel.y += 0.1 * normal(random);
      sightings.push_back(s);
    }
    const auto near = estimateNear(sightings);
    ASSERT_TRUE(near) << i;
    const Vec3 off = near->position.raw() - light;
    const double squared = dot(off, inverse(near->covariance) * off);
    chi2 += squared, ++count;
    worst = std::max(worst, squared);
  }
  // Mean of chi^2_3 is 3; raised by the stretch for misses it may only fall. 3 +- 3 deviations of the mean of 40.
  EXPECT_LT(chi2 / count, 3 + 3 * std::sqrt(6.0 / count));
  EXPECT_GT(chi2 / count, 1);
  EXPECT_LT(worst, 25);  // 1.5e-5 of a chi^2_3 lies beyond
}

TEST(MirrorBall, TwoRenderedBallsGiveANearLight) {
  const Intrinsics lens = wideLens();
  const Ball balls[] = {{Point<CameraSpace>(-0.45, 0.1, 1.8), 0.3}, {Point<CameraSpace>(0.45, -0.1, 1.7), 0.3}};
  const Vec3 light{0.5, -0.9, 0.3};
  std::vector<MirrorSighting> sightings;
  for (const Ball& ball : balls) {
    BallPicture picture{lens, ball};
    picture.noise = 0.002;
    // A small luminous ball at the light's place.
    const ImageF image = test::mirrorPicture(picture, [&](const Vec3& from, const Vec3& direction) {
      return length(cross(light - from, direction)) < 0.03 && dot(light - from, direction) > 0 ? 20.0 : 0.02;
    });
    MirrorSighting s;
    s.camera.lens = lens;
    s.ball_radius = 0.3;
    s.outline = fitOutline(image, lens, outlineFromCircle(lens, roughCircle(lens, ball)));
    s.highlight = findHighlight(image, lens, s.outline.outline).value();
    sightings.push_back(s);
  }
  const auto near = estimateNear(sightings);
  ASSERT_TRUE(near);
  const Vec3 off = near->position.raw() - light;
  EXPECT_LT(dot(off, inverse(near->covariance) * off), 16) << length(off);
  const Mat3& c = near->covariance;
  EXPECT_LT(std::sqrt(c.row[0].x + c.row[1].y + c.row[2].z), 0.06) << "1.1 units away, balls of 55 pixels";
  // One ball, or lights at infinity, do not make a position.
  EXPECT_FALSE(estimateNear({sightings.data(), 1}));
}

TEST(MirrorBall, ADistantLightInTwoBallsHasNoPosition) {
  const Intrinsics lens = wideLens();
  std::vector<MirrorSighting> sightings;
  for (const double x : {-0.1, 0.1}) {
    const Ball ball{Point<CameraSpace>(x, 0, 2), 0.05};
    MirrorSighting s;
    s.camera.lens = lens;
    s.ball_radius = 0.05;
    s.outline.outline = *outlineOfBall(lens, ball);
    s.outline.covariance = 1e-10 * Mat3{};
    s.highlight.pixel = test::highlightPixel(lens, ball, Vec3{300, -500, -800});
    s.highlight.sigma = 0.2;
    sightings.push_back(s);
  }
  EXPECT_FALSE(estimateNear(sightings));
  const auto distant = estimateDistant(sightings);
  ASSERT_TRUE(distant);
  EXPECT_LT(angleBetweenUnit(distant->direction.raw(), Vec3{300, -500, -800} / length(Vec3{300, -500, -800})),
            3 * distant->sigma);
}

// ---- the University of Washington's chrome and grey balls ----

struct PsmSet {
  std::vector<ImageF> images;
  ImageF mean;
  Intrinsics lens;
  ImageCircle circle;
};
PsmSet psmSet(const std::filesystem::path& data, const std::string& name) {
  PsmSet set;
  for (int i = 0; i < 12; ++i)
    set.images.push_back(readImage(data / name / (name + "." + std::to_string(i) + ".tga"), Transfer::linear).pixels);
  set.lens = test::orthographicLens(set.images[0].width(), set.images[0].height(), 1);
  set.circle = circleOfMask(readMask(data / name / (name + ".mask.tga")));
  set.mean = ImageF(set.lens.width, set.lens.height, 1);
  for (const ImageF& image : set.images)
    for (int y = 0; y < set.lens.height; ++y)
      for (int x = 0; x < set.lens.width; ++x)
        set.mean.at(x, y) += (image.at(x, y, 0) + image.at(x, y, 1) + image.at(x, y, 2)) / 36;
  return set;
}

// Where the ball mirrors light on the whole: the centroid of value^power inside its outline.
Vec2 centroidOfBall(const ImageF& image, const Intrinsics& lens, const OutlineParameters& outline, double power) {
  const Vec2 middle{lens.cx + outline.x, lens.cy + outline.y};
  double weight = 0, x = 0, y = 0;
  for (int j = 0; j < image.height(); ++j)
    for (int i = 0; i < image.width(); ++i) {
      if (std::hypot(i + 0.5 - middle.x, j + 0.5 - middle.y) >= outline.z) continue;
      const double w = std::pow((image.at(i, j, 0) + image.at(i, j, 1) + image.at(i, j, 2)) / 3, power);
      weight += w, x += w * (i + 0.5), y += w * (j + 0.5);
    }
  return {x / weight, y / weight};
}

// lights.txt is itself off: the grey ball, whose directions come from shading alone, agrees with the chrome ball's and
// contradicts the table for the same lights (0, 1, 8, 9) in the same direction. These are the lights that also fall on
// something white beside the ball, whose reflection stands at its left rim: the table follows the centroid of all that
// the ball mirrors, not the highlight. No outline that fits the photographs brings the mean to 2 degrees: the free
// circle that does (radius 131) lies 12 pixels outside the ball.
TEST(MirrorBall, ChromeBallOfTheSharedDataAgreesWithTheGreyBall) {
  SRF_REQUIRE_DATA(data, "uw-psm");
  const PsmSet chrome = psmSet(data, "chrome"), grey = psmSet(data, "gray");
  const FittedOutline fitted = fitOutline(chrome.mean, chrome.lens, outlineFromCircle(chrome.lens, chrome.circle));
  const FittedOutline grey_outline = fitOutline(grey.mean, grey.lens, outlineFromCircle(grey.lens, grey.circle));
  EXPECT_LT(fitted.rms, 0.25);
  EXPECT_GT(fitted.covered, 0.5);
  std::FILE* file = std::fopen((data / "lights.txt").c_str(), "r");
  ASSERT_TRUE(file);
  int count = 0;
  ASSERT_EQ(std::fscanf(file, "%d", &count), 1);
  double to_table = 0, worst = 0, mask_to_table = 0, to_grey = 0, grey_to_table = 0, all_to_table = 0, all_to_grey = 0;
  for (int i = 0; i < 12; ++i) {
    double x, y, z;
    ASSERT_EQ(std::fscanf(file, "%lf %lf %lf", &x, &y, &z), 3);
    const Vec3 table = fromLpFrame(Vec3{x, y, z} / length(Vec3{x, y, z})).raw();
    const auto highlight = findHighlight(chrome.images[i], chrome.lens, fitted.outline);
    ASSERT_TRUE(highlight) << i;
    const auto mirroredAt = [&](const OutlineParameters& outline, const Vec2& pixel) {
      return reflectionAt(chrome.lens, ballFromOutline(chrome.lens, outline), pixel)->direction.raw();
    };
    const auto lambert = fitLambertBall(grey.images[i], grey.lens, grey_outline.outline, {.white = 1});
    ASSERT_TRUE(lambert) << i;
    const auto off = [](const Vec3& a, const Vec3& b) { return degrees(angleBetweenUnit(a, b)); };
    const Vec3 mirrored = mirroredAt(fitted.outline, highlight->pixel);
    const Vec3 all = mirroredAt(fitted.outline, centroidOfBall(chrome.images[i], chrome.lens, fitted.outline, 1.4));
    to_table += off(mirrored, table) / 12;
    worst = std::max(worst, off(mirrored, table));
    mask_to_table += off(mirroredAt(outlineFromCircle(chrome.lens, chrome.circle), highlight->pixel), table) / 12;
    to_grey += off(mirrored, lambert->direction.raw()) / 12;
    grey_to_table += off(lambert->direction.raw(), table) / 12;
    all_to_table += off(all, table) / 12;
    all_to_grey += off(all, lambert->direction.raw()) / 12;
  }
  std::fclose(file);
  std::printf(
      "chrome ball: outline (%.2f, %.2f) radius %.2f px, rms %.2f px along %.0f %%; mask radius %.2f\n"
      "mean angles: chrome to grey ball %.2f, chrome to lights.txt %.2f (worst %.2f; mask's circle %.2f), grey "
      "to lights.txt %.2f; centroid of all that the ball mirrors to lights.txt %.2f, to grey %.2f degrees\n",
      fitted.outline.x + chrome.lens.cx, fitted.outline.y + chrome.lens.cy, fitted.outline.z, fitted.rms,
      100 * fitted.covered, chrome.circle.radius, to_grey, to_table, worst, mask_to_table, grey_to_table, all_to_table,
      all_to_grey);
  EXPECT_LE(to_grey, 2.0);
  EXPECT_LT(to_table, mask_to_table);
  EXPECT_LT(to_table, 2.8) << "2.71 measured; the bar of 2 is out of reach";
  EXPECT_LT(all_to_table, 1.2) << "the table holds the light of the white thing beside the ball";
  EXPECT_GT(all_to_grey, to_grey);
}

}  // namespace
}  // namespace srf
