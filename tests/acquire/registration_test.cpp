#include "acquire/registration.h"

#include <OpenEXR/ImfRgbaFile.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <limits>

#include "acquire/acquire_field.h"
#include "base/error.h"
#include "base/files.h"
#include "base/mesh_io.h"
#include "field/reflectance_store.h"
#include "tests/support/hard_case.h"
#include "tests/support/test_support.h"

namespace srf {
namespace {

namespace fs = std::filesystem;

constexpr int kWidth = 75, kHeight = 60;
constexpr double kFocal = 100, kDistance = 4, kRadius = 0.7;

// A ball at the origin, seen by six cameras along the axes, in photographs whose every value is known.
class RegistrationTest : public testing::Test {
 protected:
  RegistrationTest() {
    capture_.folder = folder_ / "capture";
    fs::create_directories(capture_.folder);
    capture_.integer_transfer = Transfer::linear;
    for (int k = 0; k < 3; ++k) capture_.lights.push_back({.name = "L" + std::to_string(k)});
    const Vec3 axes[] = {{1, 0, 0}, {-1, 0, 0}, {0, 1, 0}, {0, -1, 0}, {0, 0, 1}, {0, 0, -1}};
    for (const Vec3& axis : axes) {
      CaptureView view;
      view.name = "v" + std::to_string(capture_.views.size());
      view.camera.lens = {.width = kWidth, .height = kHeight, .fl_x = kFocal, .fl_y = kFocal, .cx = 37.5, .cy = 30};
      const Vec3 up = axis.z != 0 ? Vec3{0, 1, 0} : Vec3{0, 0, 1};
      view.camera.pose =
          *lookAt(Point<AcquisitionSpace>(kDistance * axis), Point<AcquisitionSpace>(), Vector<AcquisitionSpace>(up));
      view.mask_file = capture_.folder / (view.name + ".png");
      writePng(view.mask_file, ballMask());
      capture_.views.push_back(view);
    }
    for (std::size_t v = 0; v < capture_.views.size(); ++v)
      for (std::uint32_t k = 0; k < 3; ++k) setPhoto(v, k, photo(static_cast<int>(v), static_cast<int>(k)));
  }

  static Image8 ballMask() {
    const double radius = kFocal * kRadius / std::sqrt(kDistance * kDistance - kRadius * kRadius);
    Image8 mask(kWidth, kHeight, 1);
    for (int y = 0; y < kHeight; ++y)
      for (int x = 0; x < kWidth; ++x)
        mask.at(x, y) = static_cast<std::uint8_t>(
            std::lround(255 * std::clamp(radius - std::hypot(x + 0.5 - 37.5, y + 0.5 - 30) + 0.5, 0.0, 1.0)));
    return mask;
  }
  static float value(int v, int k, int x, int y, int c) {
    return static_cast<float>((1 + v + 10 * k) * (0.5 + 0.01 * x + 0.003 * y) + c);
  }
  static ImageF photo(int v, int k) {
    const Image8 mask = ballMask();
    ImageF image(kWidth, kHeight, 3);
    for (int y = 0; y < kHeight; ++y)
      for (int x = 0; x < kWidth; ++x)
        for (int c = 0; c < 3; ++c) image.at(x, y, c) = value(v, k, x, y, c) * static_cast<float>(mask.at(x, y)) / 255;
    return image;
  }
  void setPhoto(std::size_t v, std::uint32_t k, const ImageF& image) {
    const fs::path file = capture_.folder / ("p" + std::to_string(v) + std::to_string(k) + ".exr");
    // Full floats, so that values beyond half range and NaN can be in the file as in a camera's.
    std::vector<ExrChannel> channels;
    for (int c = 0; c < image.channels(); ++c)
      channels.push_back(
          {image.channels() == 1 ? "Y" : std::string(1, "RGB"[c]), image.data().data() + c, image.channels(), true});
    writeExr(file, image.width(), image.height(), channels);
    auto& photos = capture_.views[v].photos;
    if (photos.size() <= k) photos.push_back({file, LightId{k}});
  }
  StoredView registered(std::size_t v, const RegistrationOptions& options = {}) {
    Reporter::Stage stage(reporter_, "register", 3);
    return registerView(capture_, ViewId{static_cast<std::uint32_t>(v)}, ballMask(), folder_.path(), options, stage,
                        reporter_);
  }
  /// The stored value at a pixel of the photograph.
  static float at(const ReflectanceStore& store, int x, int y, int c, int k) {
    const StoreGeometry& g = store.geometry();
    const int u = x - g.crop_x, v = y - g.crop_y;
    std::vector<std::uint16_t> block(g.blockHalves());
    store.readTile(u / kTile, v / kTile, block);
    return floatFromHalf(block[((v % kTile * kTile + u % kTile) * 3 + c) * g.lightPad() + k]);
  }
  AcquireOptions quick() const {
    AcquireOptions options;
    options.hull.resolution = 64;
    return options;
  }
  std::vector<std::string> listing() const {
    std::vector<std::string> names;
    for (const auto& entry : fs::recursive_directory_iterator(folder_.path()))
      names.push_back(entry.path().lexically_relative(folder_.path()).string());
    std::sort(names.begin(), names.end());
    return names;
  }

  test::TemporaryFolder folder_;
  Capture capture_;
  Reporter reporter_{ProgressMode::none, LogLevel::error};
};

TEST_F(RegistrationTest, EveryCoveredTexelHoldsItsPixelToHalfPrecision) {
  const StoredView view = registered(2);
  const ReflectanceStore store(folder_ / view.file);
  const StoreGeometry& g = store.geometry();
  const Image8 mask = ballMask();
  EXPECT_EQ(store.contentHash(), view.hash);
  EXPECT_EQ(view.lights, (std::vector<LightId>{{0}, {1}, {2}}));
  EXPECT_LE(g.tiles_x, 4);  // 36 pixels and the margin
  int covered = 0;
  for (int y = 0; y < kHeight; ++y)
    for (int x = 0; x < kWidth; ++x) {
      const int u = x - g.crop_x, v = y - g.crop_y;
      const bool inside = u >= 0 && v >= 0 && u < g.cropWidth() && v < g.cropHeight();
      ASSERT_EQ(inside ? store.coverage().at(u, v) : 0, mask.at(x, y)) << x << " " << y;
      if (mask.at(x, y) == 0 || (x * 7 + y) % 5) continue;
      ++covered;
      for (int k = 0; k < 3; ++k) {
        const float expected = value(2, k, x, y, 1) * static_cast<float>(mask.at(x, y)) / 255;
        ASSERT_NEAR(at(store, x, y, 1, k), expected, expected * 0x1p-11) << x << " " << y;
      }
    }
  EXPECT_GT(covered, 100);
}

TEST_F(RegistrationTest, AThresholdedMaskLosesItsRimButNotItsThinParts) {
  Image8 mask(kWidth, kHeight, 1);
  for (int y = 20; y < 40; ++y)
    for (int x = 20; x < 40; ++x) mask.at(x, y) = 255;
  for (int x = 40; x < 60; ++x) mask.at(x, 30) = 255;  // a wire
  const auto covered = [&](int x, int y) {
    Reporter::Stage stage(reporter_, "register", 3);
    const ReflectanceStore store(folder_ /
                                 registerView(capture_, ViewId{2}, mask, folder_.path(), {}, stage, reporter_).file);
    return store.coverage().at(x - store.geometry().crop_x, y - store.geometry().crop_y);
  };
  EXPECT_EQ(covered(20, 25), 255);  // the mask is a file's
  capture_.views[2].mask_file.clear();
  EXPECT_EQ(covered(20, 25), 0);
  EXPECT_EQ(covered(21, 25), 0);
  EXPECT_EQ(covered(22, 25), 255);
  EXPECT_EQ(covered(30, 30), 255);
  EXPECT_EQ(covered(55, 30), 255);
}

TEST_F(RegistrationTest, ALittleMemoryChangesNothingInTheStore) {
  const StoredView whole = registered(0);
  fs::remove(folder_ / whole.file);
  RegistrationOptions options;
  options.memory_bytes = 1;  // one row of tiles at a time
  EXPECT_EQ(registered(0, options).hash, whole.hash);
}

TEST_F(RegistrationTest, PixelsThatAreNoNumberLoseTheirCoverageUnderEveryLight) {
  const ImageF good = photo(1, 2);
  std::vector<Imf::Rgba> pixels;
  for (int y = 0; y < kHeight; ++y)
    for (int x = 0; x < kWidth; ++x) pixels.emplace_back(good.at(x, y, 0), good.at(x, y, 1), good.at(x, y, 2));
  pixels[30 * kWidth + 40].g = std::numeric_limits<float>::infinity();
  pixels[30 * kWidth + 41].r = std::numeric_limits<float>::quiet_NaN();
  pixels[0].b = std::numeric_limits<float>::quiet_NaN();  // outside of the object: counted alone
  {
    Imf::RgbaOutputFile file(capture_.views[1].photos[2].file.c_str(), kWidth, kHeight, Imf::WRITE_RGB);
    file.setFrameBuffer(pixels.data(), 1, kWidth);
    file.writePixels(kHeight);
  }
  const ReflectanceStore store(folder_ / registered(1).file);
  for (const int x : {40, 41}) {
    EXPECT_EQ(store.coverage().at(x - store.geometry().crop_x, 30 - store.geometry().crop_y), 0);
    for (int k = 0; k < 3; ++k) EXPECT_EQ(at(store, x, 30, 2, k), 0.f);
  }
  EXPECT_GT(at(store, 42, 30, 2, 0), 0.f);
  test::recordHardCase(34, "3 NaN and infinite pixels: how many the count misses",
                       3 - static_cast<double>(reporter_.counters().at("pixels.nan")), test::atMost(0));
  EXPECT_EQ(reporter_.warnings().size(), 1u);
}

TEST_F(RegistrationTest, ValuesBeyondHalfAndBelowZeroAreClampedAndCounted) {
  ImageF image = photo(1, 2);
  image.at(40, 30, 1) = 1e30f;
  image.at(41, 30, 0) = -5;
  image.at(0, 0, 0) = -5;  // not stored, not counted
  setPhoto(1, 2, image);
  const ReflectanceStore store(folder_ / registered(1).file);
  EXPECT_EQ(at(store, 40, 30, 1, 2), 65504.f);
  EXPECT_EQ(at(store, 41, 30, 0, 2), 0.f);
  test::recordHardCase(34, "a pixel of 1e30: what the store holds", at(store, 40, 30, 1, 2), test::atMost(65504));
  EXPECT_EQ(reporter_.counters().at("pixels.clamped"), 1u);
  EXPECT_EQ(reporter_.counters().at("pixels.negative"), 1u);
}

TEST_F(RegistrationTest, GreyCountsAsThreeEqualChannels) {
  setPhoto(0, 0, ImageF(kWidth, kHeight, 1, 0.25f));
  const ReflectanceStore store(folder_ / registered(0).file);
  for (int c = 0; c < 3; ++c) EXPECT_EQ(at(store, 37, 30, c, 0), 0.25f);
}

// A PNG holds straight alpha: the light of a pixel is its decoded colour times alpha, not its decoded product.
TEST_F(RegistrationTest, StraightAlphaIsMultipliedInLinearLight) {
  Image8 png(kWidth, kHeight, 4, 128);
  for (int y = 0; y < kHeight; ++y)
    for (int x = 0; x < kWidth; ++x)
      for (int c = 0; c < 3; ++c) png.at(x, y, c) = 100;  // written as 100 / (128 / 255) = 199 of straight colour
  capture_.views[0].photos[0].file = capture_.folder / "alpha.png";
  writePng(capture_.views[0].photos[0].file, png);
  capture_.integer_transfer = Transfer::srgb;
  const ReflectanceStore store(folder_ / registered(0).file);
  const float expected = linearFromSrgb(199 / 255.f) * 128 / 255,
              one_code = linearFromSrgb(200 / 255.f) * 128 / 255 - expected;
  EXPECT_NEAR(at(store, 37, 30, 0, 0), expected, one_code);
}

TEST_F(RegistrationTest, BackgroundIsBlackWhereTheMeanPhotographSaysSo) {
  EXPECT_TRUE(registered(3).black_background);
  const auto with = [&](float background, int rows) {
    for (std::uint32_t k = 0; k < 3; ++k) {
      ImageF image = photo(3, static_cast<int>(k));
      const Image8 mask = ballMask();
      for (int y = 0; y < rows; ++y)
        for (int x = 0; x < kWidth; ++x)
          if (mask.at(x, y) == 0)
            for (int c = 0; c < 3; ++c) image.at(x, y, c) = background;
      setPhoto(3, k, image);
    }
    return registered(3).black_background;
  };
  // The object's median is about (1 + 3 + 10 k) + 2 on average over the lights: 16.
  EXPECT_TRUE(with(0.2f, kHeight));   // 1.2 % of it
  EXPECT_FALSE(with(0.8f, kHeight));  // 5 %
  EXPECT_FALSE(with(5.f, 8));         // a lit wall in a part of the picture
}

TEST_F(RegistrationTest, RejectsAPhotographOfAnotherSizeNamingBoth) {
  setPhoto(4, 1, ImageF(kWidth, 59, 3, 0.5f));
  for (const bool check : {true, false}) try {
      if (check) checkPhotographs(capture_, ViewId{4});
      if (!check) registered(4);
      ADD_FAILURE() << "accepted";
    } catch (const Error& e) {
      for (const char* part : {"p41.exr", "75 x 59", "75 x 60", "v4"})
        EXPECT_NE(std::string(e.what()).find(part), std::string::npos) << e.what();
    }
}

TEST_F(RegistrationTest, TheOrderOfTheFramesChangesNothing) {
  const StoredView first = registered(0);
  auto& photos = capture_.views[0].photos;
  std::reverse(photos.begin(), photos.end());
  const StoredView again = registered(0);
  EXPECT_EQ(again.lights, (std::vector<LightId>{{0}, {1}, {2}}));
  EXPECT_EQ(again.file, first.file);
  EXPECT_EQ(again.hash, first.hash);
}

TEST_F(RegistrationTest, AFinishedViewIsTakenAndAChangedOneIsNot) {
  const StoredView first = registered(0);
  const auto time = fs::last_write_time(folder_ / first.file);
  const StoredView again = registered(0);
  EXPECT_EQ(again.file, first.file);
  EXPECT_EQ(again.hash, first.hash);
  EXPECT_EQ(again.black_background, first.black_background);
  EXPECT_EQ(fs::last_write_time(folder_ / first.file), time);
  EXPECT_EQ(reporter_.counters().at("views.reused"), 1u);
  ImageF image = photo(0, 0);
  image.at(37, 30, 0) += 1;
  setPhoto(0, 0, image);
  fs::last_write_time(capture_.views[0].photos[0].file, time + std::chrono::seconds(5));
  const StoredView changed = registered(0);
  EXPECT_NE(changed.file, first.file);
  EXPECT_NE(changed.hash, first.hash);
}

// ---- The whole field
// -------------------------------------------------------------------------------------------------

TEST_F(RegistrationTest, AcquireWritesAFieldThatReadsBack) {
  const fs::path out = folder_ / "x.srf";
  const SrfManifest made = acquireField(capture_, out, quick(), reporter_);
  const SrfManifest read = readManifest(out);
  ASSERT_EQ(read.views.size(), 6u);
  EXPECT_EQ(read.views[5].hash, made.views[5].hash);
  EXPECT_EQ(read.source, "capture");
  ASSERT_NE(read.shape("hull"), nullptr);
  verifyFile(out, *read.shape("hull"));
  for (const StoredView& view : read.views) {
    EXPECT_EQ(ReflectanceStore(out / view.file).contentHash(), view.hash);
    EXPECT_GT(view.silhouette_iou, 0.95);
  }
  // Six cones around the ball hold it: between the ball and its box.
  const double volume = meshVolume(readMesh(out / read.shape("hull")->file));
  EXPECT_GT(volume, 4.18 * std::pow(kRadius, 3));
  EXPECT_LT(volume, 8 * std::pow(kRadius, 3) * 1.2);
  EXPECT_NEAR(reporter_.figures().at("hull.volume"), volume, 1e-6);
}

TEST_F(RegistrationTest, TheSameCaptureGivesTheSameFieldAndNothingIsWrittenTwice) {
  const fs::path out = folder_ / "x.srf";
  const SrfManifest first = acquireField(capture_, out, quick(), reporter_);
  const auto before = listing();
  const SrfManifest second = acquireField(capture_, out / "", quick(), reporter_);
  EXPECT_EQ(listing(), before);
  EXPECT_EQ(reporter_.counters().at("views.reused"), 6u);
  EXPECT_EQ(second.shapes[0].hash, first.shapes[0].hash);
}

TEST_F(RegistrationTest, AFailureLeavesNothingAndAnOldFieldWhole) {
  const fs::path photo_file = capture_.views[5].photos[0].file;
  const auto whole = readBinaryFile(photo_file);
  const auto damage = [&] { writeBinaryFile(photo_file, whole.data(), whole.size() / 2); };
  damage();
  const auto before = listing();
  EXPECT_THROW(acquireField(capture_, folder_ / "deep/er/x.srf", quick(), reporter_), Error);
  EXPECT_EQ(listing(), before);

  writeBinaryFile(photo_file, whole.data(), whole.size());
  acquireField(capture_, folder_ / "x.srf", quick(), reporter_);
  damage();
  const auto with_field = listing();
  EXPECT_THROW(acquireField(capture_, folder_ / "x.srf", quick(), reporter_), Error);
  EXPECT_EQ(listing(), with_field);
  EXPECT_EQ(readManifest(folder_ / "x.srf").views.size(), 6u);
}

TEST_F(RegistrationTest, AnInterruptedRunKeepsItsFinishedViews) {
  const fs::path out = folder_ / "x.srf";
  AcquireOptions options = quick();
  options.make_hull = false;
  fs::create_directories(out / "views");
  const StoredView finished = [&] {
    Reporter::Stage stage(reporter_, "register", 3);
    return registerView(capture_, ViewId{0}, ballMask(), out, {.coding = {}}, stage, reporter_);
  }();
  setInterruptRequested(true);
  EXPECT_THROW(acquireField(capture_, out, options, reporter_), Error);
  setInterruptRequested(false);
  EXPECT_TRUE(fs::exists(out / finished.file));
  EXPECT_FALSE(isSrfFolder(out));
  acquireField(capture_, out, options, reporter_);
  EXPECT_EQ(reporter_.counters().at("views.reused"), 1u);
  EXPECT_TRUE(readManifest(out).shapes.empty());
}

TEST_F(RegistrationTest, RefusesAFolderThatIsNoField) {
  const fs::path out = folder_ / "home";
  writeTextFile(out / "views" / "holiday.jpg", "x");
  const auto before = listing();
  EXPECT_THROW(acquireField(capture_, out, quick(), reporter_), Error);
  EXPECT_THROW(acquireField(capture_, out / "views" / "holiday.jpg", quick(), reporter_), Error);
  EXPECT_EQ(listing(), before);
}

}  // namespace
}  // namespace srf
