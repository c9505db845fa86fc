#include "field/srf_folder.h"

#include <gtest/gtest.h>
#include <unistd.h>

#include <nlohmann/json.hpp>
#include <random>

#include "base/files.h"
#include "base/json.h"
#include "tests/support/test_support.h"

namespace srf {
namespace {

namespace fs = std::filesystem;

class SrfFolder : public testing::Test {
 protected:
  SrfFolder() {
    for (const char* file : {"views/0000-a-0123456789abcdef.blk", "shape/hull-0123456789abcdef.ply", "models/m.bin"})
      writeTextFile(folder_ / file, file);
    manifest_.units = "mm";
    manifest_.source = "photographs";
    manifest_.command = "srf acquire";
    manifest_.lights = {
        {.name = "A", .direction = *normalize(Vector<AcquisitionSpace>(0.1, 0.2, -0.9)), .strength = {1, 0.1, 1.0 / 3}},
        {.name = "B", .kind = LightKind::point, .position = Point<AcquisitionSpace>(0.1, 1e-9, 3e5)},
        {.name = "C", .kind = LightKind::captured}};
    StoredView view;
    view.name = "a";
    view.camera.lens = {.model = CameraModel::opencv,
                        .width = 640,
                        .height = 480,
                        .fl_x = 501.23456789012345,
                        .fl_y = 502,
                        .cx = 320.1,
                        .cy = 240.7,
                        .skew = 0.1,
                        .k1 = -0.1,
                        .p2 = 1e-7};
    view.camera.pose = *lookAt(Point<AcquisitionSpace>(1, 2, 3.3), Point<AcquisitionSpace>(0.1, 0, 0),
                               Vector<AcquisitionSpace>(0, 0, 1));
    view.lights = {{2}, {0}};
    view.file = "views/0000-a-0123456789abcdef.blk";
    view.hash = 0xfedcba9876543210;
    view.black_background = false;
    view.silhouette_iou = 0.98765432101234567;
    manifest_.views = {view, {.name = "silhouette", .camera = view.camera}};
    manifest_.shapes = {{"hull", "shape", "shape/hull-0123456789abcdef.ply", 1}};
    manifest_.models = {{"m", "mesh", "models/m.bin", contentHash("models/m.bin", 12)}};
    manifest_.active_model = "m";
  }

  Json written() const { return readJsonFile(folder_ / "manifest.json").raw(); }
  void expectRefused(const Json& json, const std::string& part) const {
    writeJsonFile(folder_ / "manifest.json", json);
    try {
      readManifest(folder_.path());
      ADD_FAILURE() << "accepted; expected " << part;
    } catch (const Error& e) {
      EXPECT_EQ(e.kind(), ErrorKind::bad_input);
      EXPECT_NE(std::string(e.what()).find("manifest.json"), std::string::npos) << e.what();
      EXPECT_NE(std::string(e.what()).find(part), std::string::npos) << e.what();
    }
  }

  test::TemporaryFolder folder_;
  SrfManifest manifest_;
};

TEST_F(SrfFolder, ManifestComesBackToTheBit) {
  writeManifest(folder_.path(), manifest_);
  const SrfManifest m = readManifest(folder_.path());
  EXPECT_EQ(m.units, manifest_.units);
  EXPECT_EQ(m.source, manifest_.source);
  EXPECT_EQ(m.command, manifest_.command);
  ASSERT_EQ(m.lights.size(), 3u);
  for (int i = 0; i < 3; ++i) {
    EXPECT_EQ(m.lights[i].name, manifest_.lights[i].name);
    EXPECT_EQ(m.lights[i].kind, manifest_.lights[i].kind);
    EXPECT_EQ(m.lights[i].direction, manifest_.lights[i].direction);
    EXPECT_EQ(m.lights[i].position, manifest_.lights[i].position);
    EXPECT_EQ(m.lights[i].strength, manifest_.lights[i].strength);
  }
  ASSERT_EQ(m.views.size(), 2u);
  const StoredView &a = m.views[0], &b = manifest_.views[0];
  EXPECT_EQ(a.camera.lens, b.camera.lens);
  EXPECT_EQ(a.camera.pose.rotation().raw(), b.camera.pose.rotation().raw());
  EXPECT_EQ(a.camera.pose.origin(), b.camera.pose.origin());
  EXPECT_EQ(a.lights, b.lights);
  EXPECT_EQ(a.file, b.file);
  EXPECT_EQ(a.hash, b.hash);
  EXPECT_EQ(a.black_background, b.black_background);
  EXPECT_EQ(a.silhouette_iou, b.silhouette_iou);
  EXPECT_TRUE(m.views[1].file.empty());
  EXPECT_EQ(m.shape("hull")->file, "shape/hull-0123456789abcdef.ply");
  EXPECT_EQ(m.model("m")->hash, manifest_.models[0].hash);
  EXPECT_EQ(m.model("other"), nullptr);
  EXPECT_EQ(m.active_model, "m");
}

TEST_F(SrfFolder, LightDirectionsComeBackToTheBit) {
  std::mt19937 random(1);
  std::normal_distribution<double> normal;
  manifest_.lights.resize(3);
  for (int i = 0; i < 300; ++i) {
    const Vector<AcquisitionSpace> v(normal(random), normal(random), normal(random));
    manifest_.lights.push_back({.name = std::to_string(i), .direction = *normalize(v)});
  }
  writeManifest(folder_.path(), manifest_);
  const SrfManifest m = readManifest(folder_.path());
  for (std::size_t i = 3; i < m.lights.size(); ++i) EXPECT_EQ(m.lights[i].direction, manifest_.lights[i].direction);
}

TEST_F(SrfFolder, FilesThatNothingNamesAreRemovedAfterTheSwitch) {
  const std::string dead = "views/x.blk.part-999999999", alive = "models/y.part-" + std::to_string(::getpid());
  for (const std::string& file : {std::string("views/old.blk"), dead, alive, std::string("notes.txt")})
    writeTextFile(folder_ / file, "x");
  writeManifest(folder_.path(), manifest_);
  EXPECT_FALSE(fs::exists(folder_ / "views/old.blk"));
  EXPECT_FALSE(fs::exists(folder_ / dead));
  EXPECT_TRUE(fs::exists(folder_ / alive));  // another program is writing it
  EXPECT_TRUE(fs::exists(folder_ / "notes.txt"));
  EXPECT_TRUE(fs::exists(folder_ / manifest_.views[0].file));
  manifest_.models.clear();
  manifest_.active_model.clear();
  writeManifest(folder_.path(), manifest_);
  EXPECT_FALSE(fs::exists(folder_ / "models/m.bin"));
}

TEST_F(SrfFolder, RejectsWhatItCannotStandFor) {
  writeManifest(folder_.path(), manifest_);
  const Json good = written();
  const auto with = [&](const std::string& pointer, const Json& value) {
    Json json = good;
    json[Json::json_pointer(pointer)] = value;
    return json;
  };
  expectRefused(with("/version", kSrfVersion + 1), "newer program");
  expectRefused(with("/format", "web"), "not an SRF's manifest");
  expectRefused(with("/extra", 1), "/extra");
  expectRefused(with("/views/0/lights/1", 3), "/views/0/lights/1");
  expectRefused(with("/views/0/file", "views/gone.blk"), "which is missing");
  expectRefused(with("/views/0/file", "../secret"), "expected a file in views/");
  expectRefused(with("/views/0/file", "/etc/passwd"), "expected a file in views/");
  expectRefused(with("/views/0/hash", "12"), "16 hexadecimal digits");
  expectRefused(with("/views/0/transform_matrix/0", Json::array({0, 0, 0, 0})), "/views/0/transform_matrix");
  expectRefused(with("/models/0/name", 3), "/models/0/name");
  expectRefused(with("/active_model", "other"), "/active_model");
  expectRefused(with("/lights/1/name", "A"), "/lights/1/name");
  expectRefused(Json::array(), "not an SRF's manifest");
  writeTextFile(folder_ / "manifest.json", "{");
  EXPECT_THROW(readManifest(folder_.path()), Error);
  EXPECT_THROW(readManifest(folder_ / "nowhere"), Error);
}

TEST_F(SrfFolder, KnowsItsOwnFolders) {
  EXPECT_FALSE(isSrfFolder(folder_.path()));
  writeManifest(folder_.path(), manifest_);
  EXPECT_TRUE(isSrfFolder(folder_.path()));
  writeTextFile(folder_ / "manifest.json", "{\"name\": \"a web page\"}");
  EXPECT_FALSE(isSrfFolder(folder_.path()));
}

TEST_F(SrfFolder, DamagedFilesAreFound) {
  verifyFile(folder_.path(), manifest_.models[0]);
  writeTextFile(folder_ / "models/m.bin", "models/n.bin");
  EXPECT_THROW(verifyFile(folder_.path(), manifest_.models[0]), Error);
}

}  // namespace
}  // namespace srf
