#include "acquire/capture_check.h"

#include <OpenEXR/ImfRgbaFile.h>
#include <gtest/gtest.h>

#include <cmath>
#include <fstream>

#include "base/error.h"
#include "base/files.h"
#include "base/image_io.h"
#include "base/numeric.h"
#include "field/capture_file.h"
#include "tests/support/test_support.h"

namespace srf {
namespace {

namespace fs = std::filesystem;

constexpr int kSide = 48;

/// A sphere of radius 0.5 seen from 12 sides under 3 lights, in files that a test may spoil before it looks.
struct SphereCapture {
  test::TemporaryFolder folder;
  Capture capture;

  SphereCapture() {
    capture.folder = folder.path();
    for (int l = 0; l < 3; ++l) {
      CaptureLight light;
      light.name = "L" + std::to_string(l);
      light.direction = *normalize(Vector<AcquisitionSpace>(l == 0, l == 1, l == 2));
      capture.lights.push_back(light);
    }
    for (int v = 0; v < 12; ++v) {
      const double z = 1 - (2 * v + 1) / 12.0, r = std::sqrt(1 - z * z), turn = 2.4 * v;
      CaptureView view;
      view.name = "v" + std::to_string(v);
      view.camera.lens = pinholeFromFov(kSide, kSide, 40);
      view.camera.pose = *lookAt(Point<AcquisitionSpace>(3 * r * std::cos(turn), 3 * r * std::sin(turn), 3 * z),
                                 Point<AcquisitionSpace>(0, 0, 0), Vector<AcquisitionSpace>(0.1, 0.2, 1));
      view.mask_file = folder / ("masks/" + view.name + ".png");
      writePng(view.mask_file, disc(view.camera));
      for (std::uint32_t l = 0; l < 3; ++l) {
        view.photos.push_back({folder / (view.name + "_" + capture.lights[l].name + ".exr"), LightId{l}});
        writeExr(view.photos.back().file, ImageF(kSide, kSide, 3, 0.25f));
      }
      capture.views.push_back(view);
    }
  }
  static Image8 disc(const Camera<AcquisitionSpace>& camera, double radius = 0.5) {
    Image8 mask(kSide, kSide, 1);
    for (int y = 0; y < kSide; ++y)
      for (int x = 0; x < kSide; ++x) {
        const auto ray = camera.ray({x + 0.5, y + 0.5});
        const auto to_middle = Point<AcquisitionSpace>(0, 0, 0) - ray->origin;
        mask.at(x, y) = length(cross(to_middle, ray->direction)) < radius ? 255 : 0;
      }
    return mask;
  }
  CheckReport check() {
    writeCapture(folder.path(), capture);
    return checkCapture(folder.path(), {}, Reporter::silent());
  }
};

/// The first row about `item` of that verdict whose words hold `part`.
const CheckItem* row(const CheckReport& report, Verdict verdict, const std::string& item, const std::string& part) {
  for (const CheckItem& i : report.items)
    if (i.verdict == verdict && i.item == item &&
        (i.file + " " + i.found + " " + i.mend).find(part) != std::string::npos)
      return &i;
  return nullptr;
}

std::string shown(const CheckReport& report) {
  std::string out;
  for (const CheckItem& i : report.items)
    out += verdictName(i.verdict) + " " + i.item + ": " + i.file + ": " + i.found + " (" + i.mend + ")\n";
  return out;
}

TEST(CaptureCheck, ACleanCaptureHasNoFaultsAndAWordOnEverything) {
  SphereCapture sphere;
  const CheckReport report = sphere.check();
  EXPECT_EQ(report.count(Verdict::fault), 0u) << shown(report);
  for (const char* item : {"capture", "photographs", "pixel values", "masks", "views x lights", "coverage by views",
                           "lights", "silhouettes agree", "forecast"})
    EXPECT_TRUE(row(report, Verdict::ok, item, "")) << item << "\n" << shown(report);
  // Three lights along the axes leave the opposite octant dark: acos(-1/sqrt(3)) = 125 degrees.
  const CheckItem* gap = row(report, Verdict::warning, "coverage by lights", "degrees");
  ASSERT_TRUE(gap) << shown(report);
  EXPECT_NE(gap->found.find("124 degrees about (-0.5"), std::string::npos) << gap->found;  // at steps of 2.4 degrees
}

TEST(CaptureCheck, EveryFaultyFileIsNamedNotTheFirstAlone) {
  SphereCapture sphere;
  writeTextFile(sphere.folder / "v0_L0.exr", "no picture");
  const std::string whole = readTextFile(sphere.folder / "v1_L1.exr");
  writeTextFile(sphere.folder / "v1_L1.exr", whole.substr(0, whole.size() / 2));
  fs::remove(sphere.folder / "v2_L2.exr");
  writeExr(sphere.folder / "v3_L0.exr", ImageF(kSide, kSide + 2, 3, 0.25f));
  writePng(sphere.folder / "masks/v4.png", Image8(kSide, kSide, 1, 0));
  writePng(sphere.folder / "masks/v5.png", Image8(kSide, kSide, 1, 255));
  Image8 inverted = SphereCapture::disc(sphere.capture.views[6].camera);
  for (auto& v : inverted.data()) v = 255 - v;
  writePng(sphere.folder / "masks/v6.png", inverted);
  fs::remove(sphere.folder / "masks/v7.png");
  const CheckReport report = sphere.check();
  EXPECT_EQ(report.count(Verdict::fault), 8u) << shown(report);
  for (const char* file : {"v0_L0.exr", "v1_L1.exr", "v2_L2.exr", "v3_L0.exr"})
    EXPECT_TRUE(row(report, Verdict::fault, "photographs", file)) << file << "\n" << shown(report);
  EXPECT_TRUE(row(report, Verdict::fault, "photographs", "48 x 50, its camera 48 x 48")) << shown(report);
  EXPECT_TRUE(row(report, Verdict::fault, "masks", "empty"));
  EXPECT_TRUE(row(report, Verdict::fault, "masks", "fills the whole picture"));
  EXPECT_TRUE(row(report, Verdict::fault, "masks", "invert it"));
  EXPECT_TRUE(row(report, Verdict::fault, "masks", "v7.png"));
  EXPECT_TRUE(row(report, Verdict::fault, "photographs", "does not exist; check the path ("));
  EXPECT_TRUE(row(report, Verdict::fault, "photographs", "transforms.json: /frames/8/file_path")) << shown(report);
  EXPECT_TRUE(row(report, Verdict::fault, "masks", "transforms.json: /frames/21/mask_path")) << shown(report);
  // The views that are whole are still compared.
  EXPECT_TRUE(row(report, Verdict::ok, "silhouettes agree", "IoU")) << shown(report);
}

TEST(CaptureCheck, BadPixelsAreCounted) {
  SphereCapture sphere;
  ImageF image(kSide, kSide, 3, 0.25f);
  for (int x = 0; x < 5; ++x) image.at(x, 0, 1) = -0.5f;
  writeExr(sphere.folder / "v0_L0.exr", image);
  writeExr(sphere.folder / "v0_L1.exr", ImageF(kSide, kSide, 3, 0.f));
  {
    // Our own writer lets no NaN pass; cameras' files have them.
    std::vector<Imf::Rgba> pixels(kSide * kSide, Imf::Rgba(0.25f, 0.25f, 0.25f));
    pixels[7].g = NAN;
    pixels[8].r = INFINITY;
    Imf::RgbaOutputFile file((sphere.folder / "v1_L0.exr").c_str(), kSide, kSide, Imf::WRITE_RGB);
    file.setFrameBuffer(pixels.data(), 1, kSide);
    file.writePixels(kSide);
  }
  for (const CaptureView& view : sphere.capture.views) writeExr(view.photos[2].file, ImageF(kSide, kSide, 3, 0.f));
  const CheckReport report = sphere.check();
  EXPECT_TRUE(row(report, Verdict::warning, "pixel values", "5 pixels negative")) << shown(report);
  EXPECT_TRUE(row(report, Verdict::warning, "pixel values", "2 pixels NaN or infinite")) << shown(report);
  EXPECT_TRUE(row(report, Verdict::warning, "pixel values", "all 12 photographs under light 'L2' are black"))
      << shown(report);
  EXPECT_FALSE(row(report, Verdict::warning, "pixel values", "'L1'"));
  EXPECT_EQ(report.count(Verdict::fault), 0u);
}

TEST(CaptureCheck, ClippedIntegerPhotographsAreWarnedOf) {
  SphereCapture sphere;
  Image8 bright(kSide, kSide, 3, 120);
  for (int y = 0; y < 10; ++y)
    for (int x = 0; x < 10; ++x) bright.at(x, y, 0) = 255;
  sphere.capture.views[0].photos[0].file = sphere.folder / "v0.png";
  writePng(sphere.folder / "v0.png", bright);
  const CheckReport report = sphere.check();
  EXPECT_TRUE(row(report, Verdict::warning, "pixel values", "4.3 %")) << shown(report);
}

TEST(CaptureCheck, MissingCellsAndTwinLightsAreNamed) {
  SphereCapture sphere;
  sphere.capture.views[3].photos.pop_back();
  sphere.capture.lights[1].direction = sphere.capture.lights[0].direction;
  const CheckReport report = sphere.check();
  const CheckItem* missing = row(report, Verdict::warning, "views x lights", "v3");
  ASSERT_TRUE(missing) << shown(report);
  EXPECT_NE(missing->found.find("2 of 3 lights, for one 'L2'"), std::string::npos) << missing->found;
  EXPECT_TRUE(row(report, Verdict::warning, "lights", "'L0' and 'L1'")) << shown(report);
  EXPECT_EQ(report.count(Verdict::fault), 0u);
}

TEST(CaptureCheck, ATurntablesOwnLightsAreNotMissingFromOtherViews) {
  SphereCapture sphere;
  std::vector<CaptureLight> lights;
  for (std::size_t v = 0; v < sphere.capture.views.size(); ++v)
    for (Photo& photo : sphere.capture.views[v].photos) {
      CaptureLight light = sphere.capture.lights[photo.light->value];
      light.name += "_" + std::to_string(v);
      photo.light = LightId{static_cast<std::uint32_t>(lights.size())};
      lights.push_back(light);
    }
  sphere.capture.lights = lights;
  const CheckReport report = sphere.check();
  EXPECT_TRUE(row(report, Verdict::ok, "views x lights", "3 lights each")) << shown(report);
  EXPECT_TRUE(row(report, Verdict::ok, "lights", "")) << shown(report);  // equal directions, but never in one view
}

TEST(CaptureCheck, AViewThatContradictsTheOthersIsNamed) {
  SphereCapture sphere;
  Image8 moved(kSide, kSide, 1);
  const Image8 disc = SphereCapture::disc(sphere.capture.views[5].camera);
  for (int y = 0; y < kSide; ++y)
    for (int x = 6; x < kSide; ++x) moved.at(x, y) = disc.at(x - 6, y);
  writePng(sphere.folder / "masks/v5.png", moved);
  const CheckReport report = sphere.check();
  EXPECT_TRUE(row(report, Verdict::warning, "silhouettes agree", "v5")) << shown(report);
  EXPECT_EQ(report.count(Verdict::fault), 0u) << shown(report);
}

TEST(CaptureCheck, CamerasOfAnotherConventionAreRecognised) {
  const Mat3 flip{{Vec3{1, 0, 0}, Vec3{0, -1, 0}, Vec3{0, 0, -1}}};
  SphereCapture turned;
  for (CaptureView& view : turned.capture.views)
    view.camera.pose = {Orthogonal<AcquisitionSpace, CameraSpace>(view.camera.pose.rotation().raw() * flip),
                        view.camera.pose.origin()};
  EXPECT_TRUE(row(turned.check(), Verdict::fault, "silhouettes agree", "OpenCV camera")) << shown(turned.check());

  SphereCapture inverted;  // as if the file held world-to-camera of the OpenGL camera
  for (CaptureView& view : inverted.capture.views) {
    const Mat3 inverse = (view.camera.pose.rotation().raw() * flip).transposed();
    const Vec3 origin = -(inverse * view.camera.pose.origin().raw());
    view.camera.pose = {Orthogonal<AcquisitionSpace, CameraSpace>(inverse * flip), Point<AcquisitionSpace>(origin)};
  }
  const CheckReport report = inverted.check();
  const bool told = row(report, Verdict::fault, "silhouettes agree", "store the inverse") ||
                    row(report, Verdict::warning, "silhouettes agree", "store the inverse");
  EXPECT_TRUE(told) << shown(report);
}

TEST(CaptureCheck, ACaptureThatCannotBeReadIsOneFault) {
  const test::TemporaryFolder folder;
  writeTextFile(folder / "transforms.json", "{\"frames\": [}");
  const CheckReport report = checkCapture(folder.path(), {}, Reporter::silent());
  ASSERT_EQ(report.items.size(), 1u);
  EXPECT_EQ(report.items[0].verdict, Verdict::fault);
  EXPECT_NE(report.items[0].found.find("line 1"), std::string::npos);
}

TEST(CaptureCheck, ManyFaultsOfOneKindAreSummedUp) {
  SphereCapture sphere;
  for (const CaptureView& view : sphere.capture.views) fs::remove(view.photos[0].file);
  const CheckReport report = sphere.check();
  EXPECT_EQ(report.count(Verdict::fault), 9u) << shown(report);
  EXPECT_TRUE(row(report, Verdict::fault, "photographs", "4 more of the same")) << shown(report);
}

TEST(CaptureCheck, AnInterruptEndsIt) {
  SphereCapture sphere;
  writeCapture(sphere.folder.path(), sphere.capture);
  setInterruptRequested(true);
  EXPECT_THROW(checkCapture(sphere.folder.path(), {}, Reporter::silent()), Error);
  setInterruptRequested(false);
}

}  // namespace
}  // namespace srf
