#include "acquire/camera_import.h"

#include <gtest/gtest.h>

#include <fstream>

#include "base/error.h"
#include "base/files.h"
#include "base/image_io.h"
#include "base/numeric.h"
#include "tests/support/test_support.h"

namespace srf {
namespace {

namespace fs = std::filesystem;

void writePhoto(const fs::path& file, int width = 64, int height = 48) {
  writePng(file, Image8(width, height, 3, 90));
}

std::string complaint(const fs::path& folder) {
  Reporter reporter(ProgressMode::none, LogLevel::error);
  try {
    openCapture(folder, reporter);
  } catch (const Error& e) {
    EXPECT_EQ(e.kind(), ErrorKind::bad_input);
    return e.what();
  }
  return "";
}

bool holds(const std::string& text, const std::string& part) {
  return text.find(part) != std::string::npos;
}

// ---- Middlebury

constexpr const char* kPar = R"(3
a.png 100 2 31 0 110 25 0 0 1  1 0 0 0 1 0 0 0 1  0.1 -0.2 3
b.png 100 2 31 0 110 25 0 0 1  0 0 1 0 1 0 -1 0 0  0 0 3
far.png 100 2 31 0 110 25 0 0 1  1 0 0 0 1 0 0 0 1  0 0 3
)";

TEST(Middlebury, ProjectsAsKTimesRT) {
  const test::TemporaryFolder folder;
  writeTextFile(folder / "x_par.txt", kPar);
  writePhoto(folder / "a.png");
  writePhoto(folder / "b.png");
  Reporter reporter(ProgressMode::none, LogLevel::error);
  const Capture capture = openCapture(folder.path(), reporter);
  ASSERT_EQ(capture.views.size(), 2u);  // far.png is not there
  EXPECT_TRUE(capture.unknownIllumination());
  EXPECT_EQ(capture.integer_transfer, Transfer::srgb);
  EXPECT_EQ(capture.views[1].name, "b");
  EXPECT_EQ(capture.views[0].camera.lens.width, 64);
  EXPECT_EQ(capture.views[0].photos.at(0).light, LightId{0});
  // x_c = (1.1, 1.8, 6): K x_c / z by hand, and half a pixel: K counts from the centre of the first.
  const auto a = capture.views[0].camera.project(Point<AcquisitionSpace>(1, 2, 3));
  ASSERT_TRUE(a);
  EXPECT_NEAR(a->pixel.x, (100 * 1.1 + 2 * 1.8) / 6 + 31.5, 1e-12);
  EXPECT_NEAR(a->pixel.y, 110 * 1.8 / 6 + 25.5, 1e-12);
  EXPECT_NEAR(a->depth, 6, 1e-12);
  // R of b: x_c = (z, y, -x + 3).
  const auto b = capture.views[1].camera.project(Point<AcquisitionSpace>(1, 2, 3));
  ASSERT_TRUE(b);
  EXPECT_NEAR(b->pixel.x, (100 * 3 + 2 * 2) / 2.0 + 31.5, 1e-12);
  ASSERT_EQ(reporter.warnings().size(), 1u);  // no bounding box
  EXPECT_TRUE(holds(reporter.warnings()[0], "bounding box"));
}

TEST(Middlebury, TheBoundingBoxComesFromTheReadme) {
  const test::TemporaryFolder folder;
  writeTextFile(folder / "x_par.txt", kPar);
  writeTextFile(folder / "README.txt",
                "The (tight) bounding box (by hand) of the model is\n(-0.04 0.5 -0.03)\n(0.03 0.08 0.9)\n\n(c) me\n");
  writePhoto(folder / "a.png");
  const Capture capture = openCapture(folder.path(), Reporter::silent());
  ASSERT_TRUE(capture.bounds);
  EXPECT_EQ(capture.bounds->min, (Vec3{-0.04, 0.08, -0.03}));
  EXPECT_EQ(capture.bounds->max, (Vec3{0.03, 0.5, 0.9}));
}

TEST(Middlebury, ADamagedPhotographDoesNotHideTheOthers) {
  const test::TemporaryFolder folder;
  writeTextFile(folder / "x_par.txt", kPar);
  writeTextFile(folder / "a.png", "no picture");
  writePhoto(folder / "b.png", 32, 24);
  const Capture capture = openCapture(folder.path(), Reporter::silent());
  ASSERT_EQ(capture.views.size(), 2u);
  EXPECT_EQ(capture.views[0].camera.lens.width, 32);
}

TEST(Middlebury, FaultsAreToldByFileAndLine) {
  const auto try_par = [](const std::string& par) {
    const test::TemporaryFolder folder;
    writeTextFile(folder / "x_par.txt", par);
    writePhoto(folder / "a.png");
    const std::string text = complaint(folder.path());
    EXPECT_TRUE(holds(text, "x_par.txt")) << text;
    return text;
  };
  EXPECT_TRUE(holds(try_par(""), "line 1"));
  EXPECT_TRUE(holds(try_par("many\n"), "'many'"));
  EXPECT_TRUE(holds(try_par("2\na.png 1 0 0 0 1 0 0 0 1 1 0 0 0 1 0 0 0 1 0 0 3\n"), "says 2 views and describes 1"));
  EXPECT_TRUE(holds(try_par("1\na.png 1 0 0 0 1 0 0 0 1 1 0 0 0 1 0 0 0 1 0 0\n"), "line 2"));
  EXPECT_TRUE(holds(try_par("1\na.png 1 0 0 0 1 x 0 0 1 1 0 0 0 1 0 0 0 1 0 0 3\n"), "found 'x' for K"));
  EXPECT_TRUE(holds(try_par("1\na.png nan 0 0 0 1 0 0 0 1 1 0 0 0 1 0 0 0 1 0 0 3\n"), "finite"));
  EXPECT_TRUE(holds(try_par("1\na.png 0 0 0 0 1 0 0 0 1 1 0 0 0 1 0 0 0 1 0 0 3\n"), "upper triangular"));
  EXPECT_TRUE(holds(try_par("1\na.png 1 0 0 0 1 0 0 0 1 1 0 0 0 1 0 0 0 -1 0 0 3\n"), "proper rotation"));
  EXPECT_TRUE(holds(try_par("1\na.png 1 0 0 0 1 0 0 0 1 0 0 0 0 0 0 0 0 0 0 0 3\n"), "proper rotation"));
  EXPECT_TRUE(holds(try_par("1\nz.png 1 0 0 0 1 0 0 0 1 1 0 0 0 1 0 0 0 1 0 0 3\n"), "none of its 1 photographs"));
}

TEST(OpenCapture, SaysWhatItLookedFor) {
  const test::TemporaryFolder folder;
  EXPECT_TRUE(holds(complaint(folder.path()), "transforms.json"));
  EXPECT_TRUE(holds(complaint(folder / "none"), "does not exist"));
  writeTextFile(folder / "a_par.txt", kPar);
  writeTextFile(folder / "b_par.txt", kPar);
  EXPECT_TRUE(holds(complaint(folder.path()), "a_par.txt and b_par.txt"));
}

// ---- COLMAP

constexpr const char* kImages =
    "# comment\n"
    "2 0.70710678118654757 0 0.70710678118654757 0 0.1 0.2 3 7 b.png\n"
    "10.5 20.5 -1 3 4 5\n"
    "1 1 0 0 0 0 0 4 9 two words.png\n"
    "\n";

struct ColmapFolder {
  test::TemporaryFolder folder;
  ColmapFolder(const std::string& cameras, const std::string& images) {
    writeTextFile(folder / "sparse/0/cameras.txt", cameras);
    writeTextFile(folder / "sparse/0/images.txt", images);
    writePhoto(folder / "images/b.png");
    writePhoto(folder / "images/two words.png");
  }
  Capture open(Reporter& reporter = Reporter::silent()) const { return openCapture(folder.path(), reporter); }
};

constexpr const char* kCameras =
    "# comment\n7 RADIAL 64 48 50 32 24 -0.1 0.02\n9 OPENCV 64 48 50 51 32 24 0.1 0.2 0.3 0.4\n";

TEST(Colmap, TextModelsProjectAsTheyShould) {
  const Capture capture = ColmapFolder(kCameras, kImages).open();
  ASSERT_EQ(capture.views.size(), 2u);
  EXPECT_TRUE(capture.unknownIllumination());
  EXPECT_EQ(capture.views[0].name, "b");  // by name, whatever the order in the file
  EXPECT_EQ(capture.views[1].name, "two words");
  // A quarter turn about y takes (x, y, z) to (z, y, -x): x_c = (0.5 + 0.1, 0.3 + 0.2, -1 + 3).
  const auto seen = capture.views[0].camera.project(Point<AcquisitionSpace>(1, 0.3, 0.5));
  ASSERT_TRUE(seen);
  const double x = 0.3, y = 0.25, r2 = x * x + y * y, f = 1 - 0.1 * r2 + 0.02 * r2 * r2;
  EXPECT_NEAR(seen->pixel.x, 50 * x * f + 32, 1e-12);
  EXPECT_NEAR(seen->pixel.y, 50 * y * f + 24, 1e-12);
  const Intrinsics& lens = capture.views[1].camera.lens;
  EXPECT_EQ(lens.model, CameraModel::opencv);
  EXPECT_EQ(lens.fl_y, 51);
  EXPECT_EQ(lens.k2, 0.2);
  EXPECT_EQ(lens.p1, 0.3);
  EXPECT_EQ(lens.p2, 0.4);
}

TEST(Colmap, EveryModelsParametersStandInTheirPlaces) {
  const auto lens_of = [](const std::string& camera) {
    return ColmapFolder("7 " + camera + "\n", "1 1 0 0 0 0 0 4 7 b.png\n\n").open().views.at(0).camera.lens;
  };
  EXPECT_EQ(lens_of("SIMPLE_PINHOLE 64 48 50 30 20").cy, 20);
  EXPECT_EQ(lens_of("SIMPLE_PINHOLE 64 48 50 30 20").fl_y, 50);
  EXPECT_EQ(lens_of("PINHOLE 64 48 50 51 30 20").fl_y, 51);
  EXPECT_EQ(lens_of("SIMPLE_RADIAL 64 48 50 30 20 0.1").model, CameraModel::simple_radial);
  EXPECT_EQ(lens_of("SIMPLE_RADIAL 64 48 50 30 20 0.1").k1, 0.1);
  const Intrinsics fisheye = lens_of("OPENCV_FISHEYE 64 48 50 51 30 20 0.1 0.2 0.3 0.4");
  EXPECT_EQ(fisheye.model, CameraModel::opencv_fisheye);
  EXPECT_EQ(fisheye.k4, 0.4);
  EXPECT_EQ(fisheye.p1, 0);
  EXPECT_EQ(lens_of("FULL_OPENCV 64 48 50 51 30 20 0.1 0.2 0.3 0.4 0.5 0 0 0").k3, 0.5);
}

/// The binary form of the two views of kImages, with the cameras of kCameras.
struct Binary {
  std::string bytes;
  template <class T>
  Binary& put(T value) {
    bytes.append(reinterpret_cast<const char*>(&value), sizeof value);
    return *this;
  }
  Binary& text(const std::string& t) {
    bytes.append(t.c_str(), t.size() + 1);
    return *this;
  }
};
std::string camerasBinary() {
  Binary b;
  b.put<std::uint64_t>(1).put<std::uint32_t>(7).put<std::int32_t>(3).put<std::uint64_t>(64).put<std::uint64_t>(48);
  for (const double p : {50., 32., 24., -0.1, 0.02}) b.put(p);
  return b.bytes;
}
std::string imagesBinary() {
  Binary b;
  b.put<std::uint64_t>(2);
  const double root = std::sqrt(0.5);
  b.put<std::uint32_t>(2);
  for (const double v : {root, 0., root, 0., 0.1, 0.2, 3.}) b.put(v);
  b.put<std::uint32_t>(7).text("b.png").put<std::uint64_t>(2);
  for (int i = 0; i < 2; ++i) b.put(1.0).put(2.0).put<std::uint64_t>(-1);
  b.put<std::uint32_t>(1);
  for (const double v : {1., 0., 0., 0., 0., 0., 4.}) b.put(v);
  b.put<std::uint32_t>(7).text("two words.png").put<std::uint64_t>(0);
  return b.bytes;
}

TEST(Colmap, TheBinaryFormWinsAndSaysTheSame) {
  const ColmapFolder folder("not read\n", "not read\n");
  writeTextFile(folder.folder / "sparse/0/cameras.bin", camerasBinary());
  writeTextFile(folder.folder / "sparse/0/images.bin", imagesBinary());
  const Capture binary = folder.open();
  const Capture text =
      ColmapFolder("7 RADIAL 64 48 50 32 24 -0.1 0.02\n9 RADIAL 64 48 50 32 24 -0.1 0.02\n", kImages).open();
  ASSERT_EQ(binary.views.size(), 2u);
  for (int v = 0; v < 2; ++v) {
    EXPECT_EQ(binary.views[v].name, text.views[v].name);
    EXPECT_EQ(binary.views[v].camera.lens, text.views[v].camera.lens);
    EXPECT_LT(distance(binary.views[v].camera.center(), text.views[v].camera.center()), 1e-15);
  }
}

TEST(Colmap, HostileBinaryFilesEndInAnError) {
  const ColmapFolder folder("", "");
  const std::string cameras = camerasBinary(), images = imagesBinary();
  const auto try_files = [&](const std::string& c, const std::string& i) {
    // Plain streams: flushing hundreds of files to the disk takes seconds.
    std::ofstream(folder.folder / "sparse/0/cameras.bin", std::ios::binary) << c;
    std::ofstream(folder.folder / "sparse/0/images.bin", std::ios::binary) << i;
    return complaint(folder.folder.path());
  };
  ASSERT_EQ(try_files(cameras, images), "");
  for (std::size_t n = 0; n < cameras.size(); ++n) EXPECT_NE(try_files(cameras.substr(0, n), images), "") << n;
  for (std::size_t n = 0; n < images.size(); ++n) EXPECT_NE(try_files(cameras, images.substr(0, n)), "") << n;
  // Every byte as 0xff: huge counts, sizes, models, NaN, names without an end. Some still make sense; none may crash.
  for (std::size_t n = 0; n < cameras.size(); ++n) {
    std::string broken = cameras;
    broken[n] = '\xff';
    try_files(broken, images);
  }
  for (std::size_t n = 0; n < images.size(); ++n) {
    std::string broken = images;
    broken[n] = '\xff';
    try_files(cameras, broken);
  }
  const std::string huge(8, '\xff');
  EXPECT_TRUE(holds(try_files(huge + cameras.substr(8), images), "more than the file holds"));
  std::string unknown = cameras;
  unknown[12] = 7;
  EXPECT_TRUE(holds(try_files(unknown, images), "model number 7"));
}

TEST(Colmap, FaultsAreToldByPlaceAndMend) {
  const auto try_text = [](const std::string& cameras, const std::string& images) {
    const ColmapFolder folder(cameras, images);
    return complaint(folder.folder.path());
  };
  EXPECT_TRUE(holds(try_text("7 FOV 64 48 50 51 32 24 0.1\n", kImages), "FOV is not known"));
  EXPECT_TRUE(holds(try_text("7 FULL_OPENCV 64 48 50 50 30 20 0 0 0 0 0 0.1 0 0\n", kImages), "k4, k5 or k6"));
  EXPECT_TRUE(holds(try_text("7 PINHOLE 64 48 50\n", kImages), "cameras.txt: line 1"));
  EXPECT_TRUE(holds(try_text("7 PINHOLE 64 48 -50 50 32 24\n", kImages), "focal length"));
  EXPECT_TRUE(holds(try_text("7 PINHOLE 0 48 50 50 32 24\n", kImages), "size"));
  EXPECT_TRUE(holds(try_text(kCameras, "1 1 0 0 0 0 0 4 8 b.png\n\n"), "camera 8"));
  EXPECT_TRUE(holds(try_text(kCameras, "1 0 0 0 0 0 0 4 7 b.png\n\n"), "quaternion"));
  EXPECT_TRUE(holds(try_text(kCameras, "1 1 0 0 0 0 0 4 7\n\n"), "images.txt: line 1"));
  EXPECT_TRUE(holds(try_text(kCameras, "# nothing\n"), "no images"));
  EXPECT_TRUE(holds(try_text(kCameras, "1 1 0 0 0 0 0 4 7 missing.png\n\n"), "missing.png"));
  EXPECT_TRUE(holds(try_text(kCameras, "1 1 0 0 0 0 0 4 7 b.png\n\n2 1 0 0 0 0 0 4 7 b.png\n\n"), "same photograph"));
  EXPECT_TRUE(holds(try_text(kCameras, "1 1 0 0 0 0 0 4 7 " + std::string(5000, 'x') + "\n\n"), "does not exist"));
}

TEST(Colmap, PhotographsScaledSinceScaleTheirIntrinsics) {
  const ColmapFolder folder("7 PINHOLE 128 96 100 104 60 50\n9 PINHOLE 64 48 50 50 32 24\n", kImages);
  Reporter reporter(ProgressMode::none, LogLevel::error);
  const Capture capture = folder.open(reporter);
  const Intrinsics& lens = capture.views[0].camera.lens;
  EXPECT_EQ(lens.width, 64);
  EXPECT_DOUBLE_EQ(lens.fl_x, 50);
  EXPECT_DOUBLE_EQ(lens.fl_y, 52);
  EXPECT_DOUBLE_EQ(lens.cx, 30);
  EXPECT_DOUBLE_EQ(lens.cy, 25);
  ASSERT_EQ(reporter.warnings().size(), 1u);
  EXPECT_TRUE(holds(reporter.warnings()[0], "1 photographs differ in size"));
  const ColmapFolder other("7 PINHOLE 128 90 100 104 60 50\n9 PINHOLE 64 48 50 50 32 24\n", kImages);
  EXPECT_TRUE(holds(complaint(other.folder.path()), "another shape"));
}

TEST(Colmap, NamesWithAPrefixThatTheFilesLackAreMatched) {
  const ColmapFolder folder(kCameras, "1 1 0 0 0 0 0 4 7 2021-05-19 b.png\n\n");
  Reporter reporter(ProgressMode::none, LogLevel::error);
  const Capture capture = folder.open(reporter);
  EXPECT_EQ(capture.views.at(0).name, "b");
  ASSERT_EQ(reporter.warnings().size(), 1u);
  EXPECT_TRUE(holds(reporter.warnings()[0], "prefix"));
  writePhoto(folder.folder / "images/9 b.png");  // now two files end the name
  EXPECT_TRUE(holds(complaint(folder.folder.path()), "both"));
}

TEST(Colmap, MasksNamedAsColmapNamesThemAreFound) {
  const ColmapFolder folder(kCameras, kImages);
  writePng(folder.folder / "masks/b.png.png", Image8(64, 48, 1));
  const Capture capture = folder.open();
  EXPECT_EQ(capture.views[0].mask_file, folder.folder / "masks/b.png.png");
  EXPECT_TRUE(capture.views[1].mask_file.empty());
}

// ---- Real captures

TEST(Middlebury, TheDinosaursCamerasSurroundItsBox) {
  SRF_REQUIRE_DATA(folder, "middlebury/dinoSparseRing");
  const Capture capture = openCapture(folder, Reporter::silent());
  ASSERT_EQ(capture.views.size(), 16u);
  ASSERT_TRUE(capture.bounds);
  for (const CaptureView& view : capture.views) {
    const auto middle = view.camera.project(capture.bounds->center());
    ASSERT_TRUE(middle);
    EXPECT_TRUE(view.camera.lens.inside(middle->pixel));
    EXPECT_NEAR(determinant(view.camera.pose.rotation()), 1, 1e-12);
  }
}

TEST(Middlebury, APartialRingLeavesOutWhatIsNotThere) {
  SRF_REQUIRE_DATA(folder, "middlebury/templeRing19");
  EXPECT_EQ(openCapture(folder, Reporter::silent()).views.size(), 19u);
}

TEST(Colmap, TheKettlesTrapsAreWarnedOf) {
  SRF_REQUIRE_DATA(folder, "ulr-kettle");
  Reporter reporter(ProgressMode::none, LogLevel::error);
  const Capture capture = openCapture(folder, reporter);
  ASSERT_EQ(capture.views.size(), 28u);
  EXPECT_EQ(reporter.warnings().size(), 2u);
  // images.txt gives the key points at the camera's 1280 x 960; the principal point is the middle of either size.
  for (const CaptureView& view : capture.views) {
    EXPECT_NEAR(view.camera.lens.cx, 0.5 * view.camera.lens.width, 1e-9);
    EXPECT_NEAR(view.camera.lens.cy, 0.5 * view.camera.lens.height, 1e-9);
  }
}

}  // namespace
}  // namespace srf
