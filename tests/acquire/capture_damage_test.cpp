// A synthetic capture damaged in ten ways: `srf check` names each with file and remedy, tells of nothing else, and is
// quiet on the clean one; what a manifest can mend, the mended copy mends.
#include <gtest/gtest.h>

#include <cmath>
#include <fstream>

#include "acquire/capture_check.h"
#include "acquire/synthetic_capture.h"
#include "base/files.h"
#include "base/image_io.h"
#include "base/numeric.h"
#include "field/capture_file.h"
#include "tests/support/test_support.h"

namespace srf {
namespace {

namespace fs = std::filesystem;

constexpr int kViews = 16, kLights = 16, kSide = 72;

std::string shown(const CheckReport& report) {
  std::string out;
  for (const CheckItem& i : report.items)
    out += verdictName(i.verdict) + " " + i.item + ": " + i.file + ": " + i.found + " (" + i.mend + ")\n";
  return out;
}

/// One clean capture for all tests; a damaged one names its files and holds those that were changed itself.
class CaptureDamage : public ::testing::Test {
 protected:
  static void SetUpTestSuite() {
    clean_folder_ = std::make_unique<test::TemporaryFolder>();
    SyntheticCaptureOptions options;
    options.shape = SyntheticShape::bumpy;
    options.views = kViews, options.lights = kLights, options.size = kSide, options.supersampling = 2;
    writeSyntheticCapture(options, *clean_folder_ / "clean", Reporter::silent());
  }
  static void TearDownTestSuite() { clean_folder_.reset(); }

  CaptureDamage() : clean(readCapture(*clean_folder_ / "clean")), damaged(clean) {}

  CheckReport check() const { return checkIn(folder.path()); }
  CheckReport checkIn(const fs::path& where) const {
    writeCapture(where, damaged);
    return checkCapture(where, {}, Reporter::silent());
  }
  /// The row about `item`, after a look that all rows that are not "ok" are about it.
  const CheckItem* onlyAbout(const CheckReport& report, Verdict verdict, const std::string& item) const {
    const CheckItem* found = nullptr;
    for (const CheckItem& i : report.items) {
      if (i.verdict == Verdict::ok) continue;
      EXPECT_EQ(i.item, item) << shown(report);
      if (i.item == item && i.verdict == verdict && !found) found = &i;
    }
    EXPECT_TRUE(found) << shown(report);
    return found;
  }
  void expectWords(const std::string& text, std::initializer_list<std::string> words) const {
    for (const std::string& word : words) EXPECT_NE(text.find(word), std::string::npos) << word << " in: " << text;
  }
  /// A photograph of its own, changed pixel by pixel.
  template <class Change>
  void rewrite(std::size_t view, std::size_t photo, const Change& change) {
    Photo& p = damaged.views[view].photos[photo];
    ImageF image = readImage(p.file).pixels;
    change(image);
    p.file = folder / ("v" + std::to_string(view) + "_p" + std::to_string(photo) + ".exr");
    writeExr(p.file, image);
  }
  void expectMendedIsClean(const CheckReport& report) const {
    ASSERT_FALSE(report.mended.what.empty());
    writeMended(folder / "mended", report.mended);
    const CheckReport after = checkCapture(folder / "mended", {}, Reporter::silent());
    EXPECT_EQ(after.count(Verdict::fault) + after.count(Verdict::warning), 0u) << shown(after);
  }

  test::TemporaryFolder folder;
  Capture clean, damaged;

 private:
  static std::unique_ptr<test::TemporaryFolder> clean_folder_;
};
std::unique_ptr<test::TemporaryFolder> CaptureDamage::clean_folder_;

TEST_F(CaptureDamage, TheCleanOneIsQuiet) {
  const CheckReport report = check();
  EXPECT_EQ(report.count(Verdict::fault) + report.count(Verdict::warning), 0u) << shown(report);
  EXPECT_TRUE(report.mended.what.empty());
  for (const char* item : {"light table", "photographs upright", "exposure"})
    EXPECT_TRUE(std::any_of(
        report.items.begin(), report.items.end(),
        [&](const CheckItem& i) { return i.item == item && i.found.find("not looked at") == std::string::npos; }))
        << item << "\n"
        << shown(report);
}

TEST_F(CaptureDamage, AFlippedAxisIsNamedWithTheFlipThatMendsIt) {
  const Mat3 flip{{Vec3{1, 0, 0}, Vec3{0, -1, 0}, Vec3{0, 0, -1}}};
  for (CaptureView& view : damaged.views)
    view.camera.pose = {Orthogonal<AcquisitionSpace, CameraSpace>(view.camera.pose.rotation().raw() * flip),
                        view.camera.pose.origin()};
  const CheckReport report = check();
  const CheckItem* row = onlyAbout(report, Verdict::fault, "silhouettes agree");
  ASSERT_TRUE(row);
  EXPECT_EQ(row->file, folder.path().string());
  expectWords(row->mend, {"OpenCV camera (y down, z forward)", "negate the second and third column"});
  expectMendedIsClean(report);
}

TEST_F(CaptureDamage, MirroredLightsAreNamedWithTheMirror) {
  for (CaptureLight& light : damaged.lights) {
    const Vec3 d = light.direction.raw();
    light.direction = Direction<AcquisitionSpace>::fromUnit({-d.x, d.y, d.z});
  }
  const CheckReport report = check();
  const CheckItem* row = onlyAbout(report, Verdict::fault, "light table");
  ASSERT_TRUE(row);
  expectWords(row->file, {"transforms.json"});
  expectWords(row->found, {"with x negated"});
  expectWords(row->mend, {"all lights with x negated"});
  expectMendedIsClean(report);
}

TEST_F(CaptureDamage, LightsOfAWorldWithAnotherUpAreNamed) {
  for (CaptureLight& light : damaged.lights) {
    const Vec3 d = light.direction.raw();
    light.direction = Direction<AcquisitionSpace>::fromUnit({d.x, d.z, -d.y});
  }
  const CheckReport report = check();
  const CheckItem* row = onlyAbout(report, Verdict::fault, "light table");
  ASSERT_TRUE(row);
  expectWords(row->mend, {"(x, y, z) becomes (x, -z, y)"});
  expectMendedIsClean(report);
}

TEST_F(CaptureDamage, TwoLightsExchangedAreNamed) {
  // The two nearest, which are hardest to tell apart.
  std::size_t a = 0, b = 1;
  for (std::size_t i = 0; i < damaged.lights.size(); ++i)
    for (std::size_t j = 0; j < i; ++j)
      if (dot(damaged.lights[i].direction, damaged.lights[j].direction) >
          dot(damaged.lights[a].direction, damaged.lights[b].direction))
        a = j, b = i;
  std::swap(damaged.lights[a].direction, damaged.lights[b].direction);
  const CheckReport report = check();
  const CheckItem* row = onlyAbout(report, Verdict::fault, "light table");
  ASSERT_TRUE(row);
  expectWords(row->file, {"transforms.json"});
  expectWords(row->found, {"'" + damaged.lights[a].name + "'", "'" + damaged.lights[b].name + "'", "are exchanged"});
  expectWords(row->mend, {"exchange the two"});
  EXPECT_EQ(report.count(Verdict::fault), 1u);
  expectMendedIsClean(report);
}

TEST_F(CaptureDamage, OneInvertedMaskIsNamed) {
  Image8 mask = readMask(damaged.views[7].mask_file);
  for (auto& m : mask.data()) m = static_cast<std::uint8_t>(255 - m);
  damaged.views[7].mask_file = folder / "inverted.png";
  writePng(damaged.views[7].mask_file, mask);
  const CheckReport report = check();
  const CheckItem* row = onlyAbout(report, Verdict::fault, "masks");
  ASSERT_TRUE(row);
  expectWords(row->file, {"inverted.png"});
  expectWords(row->mend, {"invert it: white is the object"});
  expectMendedIsClean(report);
}

TEST_F(CaptureDamage, AViewMovedByOneDegreeIsNamed) {
  for (const Vec3 axis : {Vec3{0, 1, 0}, Vec3{1, 0, 0}}) {
    damaged = clean;
    auto& pose = damaged.views[5].camera.pose;
    pose = {Orthogonal<AcquisitionSpace, CameraSpace>(pose.rotation().raw() * rotationAbout(axis, radians(1))),
            pose.origin()};
    const CheckReport report = check();
    const CheckItem* row = onlyAbout(report, Verdict::warning, "silhouettes agree");
    ASSERT_TRUE(row);
    EXPECT_EQ(row->file, damaged.views[5].name);
    const auto at = row->mend.find("turned by ");
    ASSERT_NE(at, std::string::npos) << row->mend;
    EXPECT_NEAR(std::stod(row->mend.substr(at + 10)), 1, 0.2) << row->mend;
    EXPECT_EQ(report.count(Verdict::warning), 1u) << shown(report);
    expectMendedIsClean(report);
  }
}

TEST_F(CaptureDamage, AnExposureDriftOfTenPercentIsNamed) {
  for (std::size_t v = 0; v < damaged.views.size(); ++v)
    for (std::size_t p = 0; p < damaged.views[v].photos.size(); ++p)
      rewrite(v, p, [&](ImageF& image) {
        for (float& x : image.data()) x *= 1 + 0.1f * static_cast<float>(v) / (kViews - 1);
      });
  const CheckReport report = check();
  const CheckItem* row = onlyAbout(report, Verdict::warning, "exposure");
  ASSERT_TRUE(row);
  const auto at = row->found.find("brighter by ");
  ASSERT_NE(at, std::string::npos) << row->found;
  EXPECT_NEAR(std::stod(row->found.substr(at + 12)), 10, 2) << row->found;
  ASSERT_EQ(report.view_gain.size(), damaged.views.size());
  EXPECT_NEAR(report.view_gain.back() / report.view_gain.front(), 1.1, 0.03);
}

TEST_F(CaptureDamage, AClippedLightIsNamed) {
  const std::size_t light = 3;
  std::size_t clipped = 0;
  for (std::size_t v = 0; v < damaged.views.size(); ++v)
    for (std::size_t p = 0; p < damaged.views[v].photos.size(); ++p)
      if (damaged.views[v].photos[p].light->value == light)
        rewrite(v, p, [&](ImageF& image) {
          const float most = 0.12f;
          clipped += *std::max_element(image.data().begin(), image.data().end()) > most;
          for (float& x : image.data()) x = std::min(x, most);
        });
  ASSERT_GT(clipped, 3u);
  const CheckReport report = check();
  const CheckItem* row = onlyAbout(report, Verdict::warning, "pixel values");
  ASSERT_TRUE(row);
  expectWords(row->file, {".exr"});
  expectWords(row->found, {"under light '" + damaged.lights[light].name + "' are clipped", "0.12"});
  expectWords(row->mend, {"expose less"});
  EXPECT_EQ(report.count(Verdict::warning), 1u) << shown(report);
}

TEST_F(CaptureDamage, AMissingCellIsNamed) {
  const std::string light = damaged.lights[damaged.views[9].photos[4].light->value].name;
  damaged.views[9].photos.erase(damaged.views[9].photos.begin() + 4);
  const CheckReport report = check();
  const CheckItem* row = onlyAbout(report, Verdict::warning, "views x lights");
  ASSERT_TRUE(row);
  EXPECT_EQ(row->file, damaged.views[9].name);
  expectWords(row->found, {"15 of 16 lights, for one '" + light + "'"});
  expectWords(row->mend, {"take the missing photographs"});
}

TEST_F(CaptureDamage, ADoubleCellIsNamed) {
  damaged.views[9].photos.push_back(damaged.views[9].photos[4]);
  const CheckReport report = check();
  const CheckItem* row = onlyAbout(report, Verdict::fault, "capture");
  ASSERT_TRUE(row);
  expectWords(row->found, {"transforms.json: /frames/", "is a second photograph of view", "keep one of them"});
}

TEST_F(CaptureDamage, ARotatedPhotographIsNamed) {
  struct Turn {
    const char* how;
    bool swap, flip_x, flip_y;
  };
  // A light from the camera's side, so that there is something to see.
  std::size_t photo = 0;
  for (std::size_t p = 0; p < clean.views[4].photos.size(); ++p) {
    const auto facing = [&](std::size_t i) {
      return dot(clean.lights[clean.views[4].photos[i].light->value].direction, -clean.views[4].camera.forward());
    };
    if (std::fabs(facing(p) - 0.6) < std::fabs(facing(photo) - 0.6)) photo = p;
  }
  for (const Turn& turn :
       {Turn{"turned by 90 degrees clockwise", true, false, true}, Turn{"turned by 180 degrees", false, true, true}}) {
    damaged = clean;
    rewrite(4, photo, [&](ImageF& image) {
      const ImageF from = image;
      for (int y = 0; y < kSide; ++y)
        for (int x = 0; x < kSide; ++x)
          for (int c = 0; c < from.channels(); ++c) {
            const int i = turn.swap ? y : kSide - 1 - x, j = turn.swap ? kSide - 1 - x : kSide - 1 - y;
            image.at(x, y, c) = from.at(i, j, c);
          }
    });
    const CheckReport report = check();
    const CheckItem* row = onlyAbout(report, Verdict::fault, "photographs upright");
    ASSERT_TRUE(row);
    EXPECT_EQ(row->file, damaged.views[4].photos[photo].file.string());
    expectWords(row->found, {turn.how});
    expectWords(row->mend, {"turn the picture back"});
    EXPECT_EQ(report.count(Verdict::fault), 1u) << shown(report);
  }
}

TEST_F(CaptureDamage, NamesBeyondAsciiSimplyWork) {
  const fs::path where = folder.path() / "größe – 猫";
  for (std::size_t v = 0; v < 3; ++v) {
    CaptureView& view = damaged.views[v];
    view.name = "вид " + std::to_string(v);
    fs::create_directories(where / ("вид " + std::to_string(v)));
    for (std::size_t p = 0; p < view.photos.size(); ++p) {
      const fs::path file = where / view.name / ("свет_" + std::to_string(p) + " é.exr");
      fs::copy_file(view.photos[p].file, file);
      view.photos[p].file = file;
    }
    const fs::path mask = where / (view.name + " маска.png");
    fs::copy_file(view.mask_file, mask);
    view.mask_file = mask;
  }
  const CheckReport report = checkIn(where);
  EXPECT_EQ(report.count(Verdict::fault) + report.count(Verdict::warning), 0u) << shown(report);
}

TEST_F(CaptureDamage, NamesThatAreNoUtf8AreNamed) {
  writeCapture(folder.path(), damaged);
  std::string text = readTextFile(folder / "transforms.json");
  const auto at = text.find(".exr");
  ASSERT_NE(at, std::string::npos);
  text.insert(at,
              "gr\xf6\xdf"
              "e");  // ISO 8859-1
  writeTextFile(folder / "transforms.json", text);
  const CheckReport report = checkCapture(folder.path(), {}, Reporter::silent());
  const CheckItem* row = onlyAbout(report, Verdict::fault, "capture");
  ASSERT_TRUE(row);
  expectWords(row->found, {"transforms.json", "UTF-8"});
}

TEST_F(CaptureDamage, ShinyAndConcaveObjectsAreNotAccused) {
  for (const auto& [shape, material] : {std::pair{SyntheticShape::bowl, SyntheticMaterial::plastic},
                                        std::pair{SyntheticShape::box, SyntheticMaterial::gloss},
                                        std::pair{SyntheticShape::torus, SyntheticMaterial::conductor},
                                        std::pair{SyntheticShape::cylinder, SyntheticMaterial::velvet}}) {
    SyntheticCaptureOptions options;
    options.shape = shape, options.material = material;
    options.views = 14, options.lights = 12, options.size = 64, options.supersampling = 2;
    writeSyntheticCapture(options, folder / "shiny", Reporter::silent());
    const CheckReport report = checkCapture(folder / "shiny", {}, Reporter::silent());
    EXPECT_EQ(report.count(Verdict::fault) + report.count(Verdict::warning), 0u)
        << syntheticShapeNames()[static_cast<std::size_t>(shape)] << "\n"
        << shown(report);
  }
}

}  // namespace
}  // namespace srf
