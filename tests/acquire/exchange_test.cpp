// Captures to other programs' files and back: round trips on drawn captures, and the traps of each format by hand.
#include <gtest/gtest.h>
#include <matio.h>
#include <rapidcheck.h>
#include <rapidcheck/gtest.h>

#include <cmath>
#include <cstring>

#include "acquire/export_capture.h"
#include "acquire/import_capture.h"
#include "base/error.h"
#include "base/files.h"
#include "base/image_io.h"
#include "base/numeric.h"
#include "field/capture_file.h"
#include "tests/support/test_support.h"

namespace srf {
namespace {

namespace fs = std::filesystem;

constexpr int kWidth = 6, kHeight = 4;
const int kSeeded = ::setenv("RC_PARAMS", "seed=7 max_success=30", /*overwrite=*/0);

rc::Gen<double> between(double low, double high) {
  return rc::gen::map(rc::gen::inRange(0, 1001), [=](int drawn) { return low + (high - low) * drawn / 1000.0; });
}
Vec3 drawVec(double reach) {
  return {*between(-reach, reach), *between(-reach, reach), *between(-reach, reach)};
}
Direction<AcquisitionSpace> drawDirection() {
  const auto d = normalize(Vector<AcquisitionSpace>(drawVec(1)));
  RC_PRE(d.has_value());
  return *d;
}
Camera<AcquisitionSpace> drawCamera(CameraModel model, bool skew) {
  Camera<AcquisitionSpace> camera;
  Intrinsics& l = camera.lens;
  l.model = model;
  l.width = kWidth, l.height = kHeight;
  l.fl_x = *between(3, 30), l.fl_y = *between(3, 30);
  l.cx = 3 + *between(-1, 1), l.cy = 2 + *between(-0.9, 0.9);
  if (skew) l.skew = *between(-1, 1);
  if (model != CameraModel::pinhole) {
    l.k1 = *between(-0.3, 0.3);
    if (model != CameraModel::simple_radial) l.k2 = *between(-0.1, 0.1), l.k3 = *between(-0.05, 0.05);
    if (model == CameraModel::opencv) l.p1 = *between(-0.02, 0.02), l.p2 = *between(-0.02, 0.02);
    if (model == CameraModel::opencv_fisheye) l.k4 = *between(-0.02, 0.02);
  }
  camera.pose = {Orthogonal<AcquisitionSpace, CameraSpace>(rotationAbout(drawDirection().raw(), *between(-3.1, 3.1))),
                 Point<AcquisitionSpace>(drawVec(5))};
  return camera;
}

struct Drawn {
  test::TemporaryFolder folder;
  Capture capture;

  fs::path photo(const std::string& name) {
    const fs::path file = folder / ("source/" + name + ".png");
    writePng(file, Image8(kWidth, kHeight, 3, 90));
    return file;
  }
  /// Views of one photograph each under an unknown light.
  Drawn(std::vector<CameraModel> models, bool skew) {
    capture.folder = folder / "source";
    capture.lights.push_back({.name = "captured", .kind = LightKind::captured});
    const int views = *rc::gen::inRange(1, 4);
    for (int v = 0; v < views; ++v) {
      CaptureView view;
      view.name = "view " + std::to_string(v);
      view.camera = drawCamera(*rc::gen::elementOf(models), skew);
      view.photos.push_back({photo(view.name), LightId{0}});
      capture.views.push_back(view);
    }
  }
  /// Under lights of one kind, each view under all.
  void light(LightKind kind) {
    capture.lights.clear();
    const int count = *rc::gen::inRange(1, 4);
    for (int l = 0; l < count; ++l) {
      CaptureLight light{.name = "L" + std::to_string(l), .kind = kind};
      if (kind == LightKind::point) light.position = Point<AcquisitionSpace>(drawVec(5) + Vec3{0, 0, 20.0 + l});
      if (kind == LightKind::directional) light.direction = drawDirection();
      light.strength = {*between(0.1, 3), *between(0.1, 3), *between(0.1, 3)};
      capture.lights.push_back(light);
    }
    for (CaptureView& view : capture.views) {
      view.photos.clear();
      for (std::uint32_t l = 0; l < capture.lights.size(); ++l)
        view.photos.push_back({photo(view.name + " " + std::to_string(l)), LightId{l}});
    }
  }
  Capture there_and_back(const std::string& to, const std::string& from, const std::string& file = "") {
    exportCapture(to, capture, folder / "out", Reporter::silent());
    return importCapture(from, folder / ("out/" + file), {}, Reporter::silent());
  }
};

/// The same pixels of the same points; the lens models may have another name for it.
void expectSameCamera(const Camera<AcquisitionSpace>& a, const Camera<AcquisitionSpace>& b) {
  RC_ASSERT(a.lens.width == b.lens.width && a.lens.height == b.lens.height);
  RC_ASSERT(distance(a.center(), b.center()) < 1e-9 * (1 + length(a.center().raw())));
  for (int i = 0; i < 3; ++i) RC_ASSERT(length(a.pose.rotation().raw().row[i] - b.pose.rotation().raw().row[i]) < 1e-9);
  for (const auto member :
       {&Intrinsics::fl_x, &Intrinsics::fl_y, &Intrinsics::cx, &Intrinsics::cy, &Intrinsics::skew, &Intrinsics::k1,
        &Intrinsics::k2, &Intrinsics::k3, &Intrinsics::k4, &Intrinsics::p1, &Intrinsics::p2})
    RC_ASSERT(std::fabs(a.lens.*member - b.lens.*member) < 1e-9 * (1 + std::fabs(a.lens.*member)));
}
void expectSameViews(const Capture& a, const Capture& b) {
  RC_ASSERT(a.views.size() == b.views.size());
  for (std::size_t v = 0; v < a.views.size(); ++v) expectSameCamera(a.views[v].camera, b.views[v].camera);
}

const std::vector<CameraModel> kAll{CameraModel::pinhole, CameraModel::simple_radial, CameraModel::opencv,
                                    CameraModel::opencv_fisheye};

RC_GTEST_PROP(Exchange, TransformsComeBack, ()) {
  Drawn drawn({CameraModel::pinhole, CameraModel::opencv, CameraModel::opencv_fisheye, CameraModel::orthographic},
              true);
  drawn.light(*rc::gen::element(LightKind::point, LightKind::directional));
  drawn.capture.applied_transform = {2, 0, 0, 1, 0, 2, 0, 2, 0, 0, 2, 3};
  for (CaptureView& v : drawn.capture.views)
    if (v.camera.lens.isOrthographic()) v.camera.lens.k1 = v.camera.lens.k2 = v.camera.lens.k3 = 0;
  const Capture back = drawn.there_and_back("transforms", "transforms");
  expectSameViews(drawn.capture, back);
  RC_ASSERT(back.applied_transform == drawn.capture.applied_transform);
  RC_ASSERT(back.lights.size() == drawn.capture.lights.size());
}
RC_GTEST_PROP(Exchange, PointLightsOfNrhintsComeBack, ()) {
  Drawn drawn({CameraModel::pinhole, CameraModel::opencv}, false);
  drawn.light(LightKind::point);
  const Capture back = drawn.there_and_back("nrhints", "nrhints");
  expectSameViews(drawn.capture, back);
  for (std::size_t v = 0; v < back.views.size(); ++v)
    for (std::size_t p = 0; p < back.views[v].photos.size(); ++p) {
      const CaptureLight& a = drawn.capture.lights[drawn.capture.views[v].photos[p].light->value];
      const CaptureLight& b = back.lights[back.views[v].photos[p].light->value];
      RC_ASSERT(a.position == b.position);
      RC_ASSERT(a.strength == b.strength);
    }
}
RC_GTEST_PROP(Exchange, ColmapTextAndBinaryComeBack, ()) {
  Drawn drawn(kAll, false);
  for (CaptureView& v : drawn.capture.views)
    if (v.camera.lens.model == CameraModel::simple_radial) v.camera.lens.fl_y = v.camera.lens.fl_x;
  expectSameViews(drawn.capture, drawn.there_and_back("colmap", "colmap"));
  fs::remove_all(drawn.folder / "out");
  expectSameViews(drawn.capture, drawn.there_and_back("colmap-binary", "colmap"));
}
RC_GTEST_PROP(Exchange, MiddleburyComesBackWithItsBox, ()) {
  Drawn drawn({CameraModel::pinhole}, true);
  drawn.capture.bounds = Box<AcquisitionSpace>{{-1.5, -2, -0.25}, {1, 2, 3}};
  const Capture back = drawn.there_and_back("middlebury", "middlebury");
  expectSameViews(drawn.capture, back);
  RC_ASSERT(back.bounds.has_value() && back.bounds->min == drawn.capture.bounds->min &&
            back.bounds->max == drawn.capture.bounds->max);
}
RC_GTEST_PROP(Exchange, ProjectionsComeBack, ()) {
  Drawn drawn({CameraModel::pinhole}, true);
  expectSameViews(drawn.capture, drawn.there_and_back("projections", "projections", "projections.txt"));
}
RC_GTEST_PROP(Exchange, ProjectionsOfAnySignAndScaleAreTheSameCamera, ()) {
  const auto camera = drawCamera(CameraModel::pinhole, true);
  const Intrinsics& l = camera.lens;
  const Mat3 r = camera.pose.rotation().raw().transposed();
  const double scale = *rc::gen::element(-1e6, -3.0, -1e-6, 1e-6, 7.0, 1e6);
  const Mat3 k = scale * Mat3{{Vec3{l.fl_x, l.skew, l.cx}, Vec3{0, l.fl_y, l.cy}, Vec3{0, 0, 1}}};
  auto found = cameraFromProjection(k * r, k * -(r * camera.center().raw()), 0.5, "P");
  found.lens.width = kWidth, found.lens.height = kHeight;
  expectSameCamera(camera, found);
}
RC_GTEST_PROP(Exchange, MetashapeComesBack, ()) {
  Drawn drawn({CameraModel::pinhole, CameraModel::opencv, CameraModel::opencv_fisheye}, true);
  expectSameViews(drawn.capture, drawn.there_and_back("metashape", "metashape"));
}
RC_GTEST_PROP(Exchange, LightsOfOneViewComeBackInTheCamerasFrame, ()) {
  Drawn drawn({CameraModel::pinhole}, false);
  drawn.capture.views.resize(1);
  drawn.light(LightKind::directional);
  const std::string format = *rc::gen::element(std::string("lp"), std::string("diligent"));
  const Capture back = drawn.there_and_back(format, format);
  const auto& a = drawn.capture.views[0].camera.pose.rotation();
  const auto& b = back.views[0].camera.pose.rotation();
  RC_ASSERT(back.lights.size() == drawn.capture.lights.size());
  for (std::size_t i = 0; i < back.lights.size(); ++i) {
    const Vec3 was = (a.inverse() * drawn.capture.lights[i].direction).raw(),
               is = (b.inverse() * back.lights[i].direction).raw();
    RC_ASSERT(length(was - is) < 1e-12);
    if (format == "diligent") RC_ASSERT(back.lights[i].strength == drawn.capture.lights[i].strength);
  }
}

RC_GTEST_PROP(Exchange, DiligentMvComesBackWithEachViewsLights, ()) {
  Drawn drawn({CameraModel::pinhole}, true);
  drawn.light(LightKind::directional);
  drawn.capture.units = "mm";
  drawn.capture.integer_transfer = Transfer::linear;
  for (CaptureView& v : drawn.capture.views) v.camera.lens = drawn.capture.views[0].camera.lens;
  drawn.capture.views[0].mask_file = drawn.photo("mask");
  const Capture back = drawn.there_and_back("diligent-mv", "diligent-mv");
  expectSameViews(drawn.capture, back);
  RC_ASSERT(back.units == "mm" && back.integer_transfer == Transfer::linear);
  for (std::size_t v = 0; v < back.views.size(); ++v) {
    RC_ASSERT(back.views[v].mask_file.empty() == (v > 0));
    RC_ASSERT(back.views[v].photos.size() == drawn.capture.views[v].photos.size());
    for (std::size_t p = 0; p < back.views[v].photos.size(); ++p) {
      const Photo &was = drawn.capture.views[v].photos[p], &is = back.views[v].photos[p];
      const CaptureLight& a = drawn.capture.lights[was.light->value];
      const CaptureLight& b = back.lights[is.light->value];
      RC_ASSERT(length(a.direction.raw() - b.direction.raw()) < 1e-9);
      RC_ASSERT(a.strength == b.strength);
      RC_ASSERT(fs::equivalent(was.file, is.file));
    }
  }
}
RC_GTEST_PROP(Exchange, OpenIlluminationComesBack, ()) {
  Drawn drawn({CameraModel::pinhole}, false);
  drawn.light(LightKind::point);
  if (*rc::gen::arbitrary<bool>())  // what the format itself has: square pixels, the middle of the picture
    for (CaptureView& v : drawn.capture.views)
      v.camera.lens.fl_y = v.camera.lens.fl_x, v.camera.lens.cx = 0.5 * kWidth, v.camera.lens.cy = 0.5 * kHeight;
  const bool masked = *rc::gen::arbitrary<bool>();
  if (masked) drawn.capture.views[0].mask_file = drawn.photo("mask");
  // One cell missing: a view need not have all lights.
  if (drawn.capture.lights.size() > 1) drawn.capture.views[0].photos.erase(drawn.capture.views[0].photos.begin());
  const Capture back = drawn.there_and_back("openillumination", "openillumination");
  expectSameViews(drawn.capture, back);
  for (std::size_t v = 0; v < back.views.size(); ++v) {
    RC_ASSERT(back.views[v].name == drawn.capture.views[v].name);
    RC_ASSERT(back.views[v].mask_file.empty() == !(masked && v == 0));
    RC_ASSERT(back.views[v].photos.size() == drawn.capture.views[v].photos.size());
    for (std::size_t p = 0; p < back.views[v].photos.size(); ++p) {
      const Photo &was = drawn.capture.views[v].photos[p], &is = back.views[v].photos[p];
      RC_ASSERT(drawn.capture.lights[was.light->value].position == back.lights[is.light->value].position);
      RC_ASSERT(fs::equivalent(was.file, is.file));
    }
  }
}

// ---- By hand

struct Files {
  test::TemporaryFolder folder;
  void photo(const std::string& name, int width = kWidth, int height = kHeight) {
    writePng(folder / name, Image8(width, height, 3, 90));
  }
  void text(const std::string& name, const std::string& content) { writeTextFile(folder / name, content); }
};
std::string warnings(const Reporter& reporter) {
  std::string all;
  for (const std::string& w : reporter.warnings()) all += w + "\n";
  return all;
}

TEST(ImportByHand, NerfstudioWithAngleWithoutExtensionAndWithATransform) {
  Files files;
  files.photo("images/a.png", 100, 50);
  files.text("transforms.json", R"({"camera_angle_x": 1.0, "applied_transform": [[1,0,0,0],[0,0,1,0],[0,-1,0,0]],
    "frames": [{"file_path": "images/a", "transform_matrix": [[1,0,0,0],[0,1,0,0],[0,0,1,3],[0,0,0,1]]}]})");
  Reporter reporter(ProgressMode::none, LogLevel::error);
  const Capture capture = importCapture(guessFormat(files.folder.path()), files.folder.path(), {}, reporter);
  EXPECT_NEAR(capture.views[0].camera.lens.fl_x, 50 / std::tan(0.5), 1e-9);
  EXPECT_EQ(capture.views[0].photos[0].file.filename(), "a.png");
  ASSERT_TRUE(capture.applied_transform);
  EXPECT_EQ((*capture.applied_transform)[6], 1);
  EXPECT_EQ(capture.views[0].camera.center().raw(), (Vec3{0, 0, 3}));  // kept as it is
  EXPECT_NE(warnings(reporter).find("applied_transform"), std::string::npos);
}

TEST(ImportByHand, MetashapeWithItsTraps) {
  Files files;
  files.photo("a b.jpg.png");  // removed below
  fs::remove(files.folder / "a b.jpg.png");
  files.photo("one.png");
  files.photo("two.png");
  files.text("cameras.xml", R"(<?xml version="1.0"?><document version="1.5.0"><chunk label="c"><sensors>
    <sensor id="0"><resolution width="6" height="4"/><calibration type="frame" class="initial"><f>1</f></calibration>
      <calibration type="frame" class="adjusted"><resolution width="6" height="4"/><f>10</f><cx>0.5</cx><b1>1</b1>
      <p1>0.01</p1><p2>0.02</p2></calibration></sensor>
    <sensor id="1"><resolution width="6" height="4"/></sensor></sensors>
    <cameras><group><camera id="0" sensor_id="0" label="one"><transform>1 0 0 1 0 1 0 2 0 0 1 3 0 0 0 1</transform></camera></group>
      <camera id="1" sensor_id="0" label="unaligned"/>
      <camera id="2" sensor_id="1" label="two"><transform>1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1</transform></camera></cameras>
    <transform><rotation>0 -1 0 1 0 0 0 0 1</rotation><translation>10 20 30</translation><scale>2</scale></transform>
    </chunk></document>)");
  Reporter reporter(ProgressMode::none, LogLevel::error);
  const Capture capture = importCapture("metashape", files.folder.path(), {}, reporter);
  ASSERT_EQ(capture.views.size(), 1u);
  const Camera<AcquisitionSpace>& camera = capture.views[0].camera;
  EXPECT_LT(length(camera.center().raw() - Vec3{10 - 2 * 2, 20 + 2 * 1, 30 + 2 * 3}), 1e-12);
  EXPECT_DOUBLE_EQ(camera.lens.cx, 3.5);
  EXPECT_DOUBLE_EQ(camera.lens.cy, 2);
  EXPECT_DOUBLE_EQ(camera.lens.fl_x, 11);
  EXPECT_DOUBLE_EQ(camera.lens.p1, 0.02);
  EXPECT_DOUBLE_EQ(camera.lens.p2, 0.01);
  ASSERT_TRUE(capture.applied_transform);
  EXPECT_EQ((*capture.applied_transform)[4], 2);
  for (const char* word : {"not aligned", "no calibration", "scale 2"})
    EXPECT_NE(warnings(reporter).find(word), std::string::npos) << word << "\n" << warnings(reporter);
}

TEST(ImportByHand, DiligentMvDirectionsStandInEachCamerasFrame) {
  Files files;
  files.photo("view_01/001.png");
  files.text("view_01/light_directions.txt", "0 0 1\n");
  files.text("view_01/light_intensities.txt", "1 2 3\n");
  files.text("view_01/filenames.txt", "001.png\n");
  const fs::path file = files.folder / "Calib_Results.mat";
  for (const bool compressed : {false, true}) {
    mat_t* mat = Mat_CreateVer(file.c_str(), nullptr, MAT_FT_MAT5);
    ASSERT_TRUE(mat);
    const auto write = [&](const char* name, std::vector<double> values, std::size_t columns) {
      std::size_t dims[2] = {values.size() / columns, columns};
      matvar_t* v = Mat_VarCreate(name, MAT_C_DOUBLE, MAT_T_DOUBLE, 2, dims, values.data(), 0);
      Mat_VarWrite(mat, v, compressed ? MAT_COMPRESSION_ZLIB : MAT_COMPRESSION_NONE);
      Mat_VarFree(v);
    };
    write("KK", {10, 0, 0, 0, 12, 0, 3, 2, 1}, 3);   // columns after each other
    write("Rc_1", {0, 1, 0, -1, 0, 0, 0, 0, 1}, 3);  // x_c = -y, y_c = x
    write("Tc_1", {0, 0, 5}, 1);
    Mat_Close(mat);
    const Capture capture = importCapture("diligent-mv", files.folder.path(), {}, Reporter::silent());
    ASSERT_EQ(capture.views.size(), 1u);
    const Camera<AcquisitionSpace>& camera = capture.views[0].camera;
    EXPECT_LT(length(camera.center().raw() - Vec3{0, 0, -5}), 1e-12);
    EXPECT_DOUBLE_EQ(camera.lens.fl_y, 12);
    EXPECT_DOUBLE_EQ(camera.lens.cx, 3.5);
    EXPECT_LT(length(capture.lights[0].direction.raw() - Vec3{0, 0, -1}), 1e-12);  // towards the camera
    EXPECT_EQ(capture.lights[0].strength, (Vec3{1, 2, 3}));
    EXPECT_EQ(capture.units, "mm");
  }
}

TEST(ImportByHand, OpenIlluminationLightsAreRowsOfTheArray) {
  Files files;
  for (const char* light : {"001", "003"})
    files.photo(std::string("Lights/") + light + "/raw_undistorted/CA2.png", 60, 40);
  files.photo("output/obj_masks/CA2.png", 60, 40);
  files.text("output/transforms_train.json", R"({"camera_angle_x": 1.0, "frames": {"CA2": {"file_path": "x/CA2.JPG",
    "light_idx": 1, "calib_imgw": 30, "transform_matrix": [[1,0,0,0],[0,1,0,0],[0,0,1,3],[0,0,0,1]]}}})");
  std::string header = "{'descr': '<f4', 'fortran_order': False, 'shape': (4, 3), }";
  header += std::string(118 - header.size() - 1, ' ') + "\n";
  std::string npy =
      std::string("\x93NUMPY\x01\x00", 8) + std::string(1, static_cast<char>(118)) + std::string(1, '\0') + header;
  for (int i = 0; i < 12; ++i) {
    const float v = static_cast<float>(i);
    npy.append(reinterpret_cast<const char*>(&v), 4);
  }
  files.text("light_pos.npy", npy);
  const Capture capture = importCapture(guessFormat(files.folder.path()), files.folder.path(), {}, Reporter::silent());
  ASSERT_EQ(capture.lights.size(), 2u);
  EXPECT_EQ(capture.lights[1].name, "003");
  EXPECT_EQ(capture.lights[1].position.raw(), (Vec3{9, 10, 11}));
  EXPECT_EQ(capture.views[0].photos.size(), 2u);
  EXPECT_NEAR(capture.views[0].camera.lens.fl_x, 30 / std::tan(0.5), 1e-9);
  EXPECT_EQ(capture.views[0].mask_file.filename(), "CA2.png");
}

TEST(ImportByHand, RtiWithAMissingFileAndDecimalCommas) {
  Files files;
  files.photo("p1.png");
  files.text("set.lp", "2\np1.png 0,6 0 0,8\np2.png 0 0 1\n");
  Reporter reporter(ProgressMode::none, LogLevel::error);
  const Capture capture = importCapture("lp", files.folder.path(), {}, reporter);
  ASSERT_EQ(capture.lights.size(), 1u);
  // +z of the file is towards the camera, and +x to the right in the picture.
  const auto& camera = capture.views[0].camera;
  EXPECT_GT(dot(capture.lights[0].direction, -camera.forward()), 0.79);
  EXPECT_GT(camera.project(Point<AcquisitionSpace>(0.1, 0, 0))->pixel.x, camera.lens.cx);
  EXPECT_NE(warnings(reporter).find("p2.png"), std::string::npos);
}

TEST(ExportByHand, WhatAFormatCannotHoldIsToldOrRefused) {
  test::TemporaryFolder folder;
  Capture capture;
  capture.folder = folder.path();
  writePng(folder / "a.png", Image8(kWidth, kHeight, 3, 90));
  capture.lights.push_back({.name = "L", .kind = LightKind::directional});
  CaptureView view{.name = "v"};
  view.camera.lens = pinholeFromFov(kWidth, kHeight, 40);
  view.photos = {{folder / "a.png", LightId{0}}};
  view.mask_file = folder / "a.png";
  capture.views = {view};
  Reporter reporter(ProgressMode::none, LogLevel::error);
  capture.units = "cm";
  capture.bounds = Box<AcquisitionSpace>{{-1, -1, -1}, {1, 1, 1}};
  capture.applied_transform = {2, 0, 0, 1, 0, 2, 0, 2, 0, 0, 2, 3};
  exportCapture("middlebury", capture, folder / "m", reporter);
  EXPECT_NE(warnings(reporter).find("the lights are lost"), std::string::npos);
  EXPECT_NE(warnings(reporter).find("the masks are lost"), std::string::npos);
  EXPECT_NE(warnings(reporter).find("applied_transform"), std::string::npos);
  EXPECT_EQ(warnings(reporter).find("bounding box"), std::string::npos);  // Middlebury's README has it
  exportCapture("diligent-mv", capture, folder / "mv", reporter);
  for (const char* words : {"in cm here and in mm in diligent-mv", "count as sRGB here and as linear in diligent-mv",
                            "the bounding box is lost", "each view has its own lights"})
    EXPECT_NE(warnings(reporter).find(words), std::string::npos) << words;
  EXPECT_THROW(exportCapture("nrhints", capture, folder / "n", reporter), Error);
  EXPECT_THROW(exportCapture("openillumination", capture, folder / "o", reporter), Error);  // no point light
  Capture near = capture;
  near.lights[0].kind = LightKind::point;
  near.lights[0].strength = {2, 2, 2};
  near.views[0].camera.lens.cx += 1;
  near.views[0].photos.push_back(near.views[0].photos[0]);
  exportCapture("openillumination", near, folder / "o", reporter);
  for (const char* words : {"the strengths of the lights are lost: openillumination",
                            "programs that read the angle alone", "one photograph for each light"})
    EXPECT_NE(warnings(reporter).find(words), std::string::npos) << words;
  EXPECT_THROW(exportCapture("diligent-mv", near, folder / "mv2", reporter), Error);  // a point light
  Capture two = capture;
  two.views.push_back(two.views[0]);
  two.views[1].camera.lens.fl_x += 1;
  EXPECT_THROW(exportCapture("diligent-mv", two, folder / "mv3", reporter), Error);  // two lenses
  capture.views[0].camera.lens.k1 = 0.1;
  capture.views[0].camera.lens.model = CameraModel::opencv;
  EXPECT_THROW(exportCapture("middlebury", capture, folder / "m2", reporter), Error);
  capture.views.push_back(capture.views[0]);
  EXPECT_THROW(exportCapture("lp", capture, folder / "l", reporter), Error);
}

}  // namespace
}  // namespace srf
