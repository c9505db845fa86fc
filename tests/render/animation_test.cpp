#include "render/animation.h"

#include <gtest/gtest.h>

#include <fstream>

#include "base/error.h"
#include "base/files.h"
#include "base/image_io.h"
#include "base/mesh_io.h"
#include "tests/support/formula_field.h"
#include "tests/support/test_support.h"

namespace srf {
namespace {

namespace fs = std::filesystem;

class AnimationTest : public testing::Test {
 protected:
  void SetUp() override {
    const auto field = test::makeSphereField(folder_ / "x.srf", {.views = 6, .lights = 8, .size = 24, .subdivision = 3},
                                             [](const Vec3& p, const Vec3& l, const Vec3&) {
                                               return std::max(0.0, dot(p, l)) * Vec3{0.3, 0.2, 0.1};
                                             });
    writeManifest(folder_ / "x.srf", field.manifest);
    storeModel(folder_ / "x.srf", field.model, "sphere");
    writeTextFile(folder_ / "scene.json", R"({"srf": "x.srf", "frames": "1-3",
      "camera": {"w": 24, "h": 20, "vfov": 40, "look_at": {"eye": [0, -4, 0], "target": [0, 0, 0], "up": [0, 0, 1]}},
      "deformation": [{"type": "twist", "axis": [0, 0, 1], "degrees_per_unit": {"keys": [[0, 0], [9, 90]]}}],
      "lights": [{"type": "directional", "direction": [0, -1, 1], "irradiance": [1, 1, 1]}]})");
    options_.output = (folder_ / "out" / "f.####.exr").string();
    options_.command = "test";
  }
  void TearDown() override { setInterruptRequested(false); }

  std::vector<RenderedFrame> render(const std::vector<std::string>& overrides = {}) {
    return renderAnimation(readScene(folder_ / "scene.json", overrides, reporter_), options_, reporter_);
  }
  std::string refusal(const std::vector<std::string>& overrides = {}) {
    try {
      render(overrides);
    } catch (const Error& e) {
      return e.what();
    }
    return "";
  }
  std::vector<bool> kept(const std::vector<std::string>& overrides = {}) {
    std::vector<bool> result;
    for (const RenderedFrame& frame : render(overrides)) result.push_back(frame.kept);
    return result;
  }
  std::size_t filesWritten() const {
    if (!fs::exists(folder_ / "out")) return 0;
    return static_cast<std::size_t>(std::distance(fs::directory_iterator(folder_ / "out"), fs::directory_iterator()));
  }

  test::TemporaryFolder folder_;
  AnimationOptions options_;
  Reporter reporter_{ProgressMode::none, LogLevel::error};
};

TEST_F(AnimationTest, WritesAFrameForEachNumberThatSaysWhatItWasMadeFrom) {
  options_.layers = {"P", "view"};
  const auto frames = render({"/fps=25"});
  ASSERT_EQ(frames.size(), 3u);
  EXPECT_EQ(frames[1].file, folder_ / "out" / "f.0002.exr");
  EXPECT_EQ(filesWritten(), 3u);
  const Attributes attributes = readExrAttributes(frames[1].file);
  EXPECT_EQ(attributes.at("command"), "test");
  EXPECT_EQ(attributes.at("frameNumber"), "2");
  EXPECT_EQ(attributes.at("software"), std::string("srf ") + SRF_VERSION);
  for (const char* hash : {"settingsHash", "fieldHash", "modelHash", "environmentHash"})
    EXPECT_EQ(attributes.at(hash).size(), 16u) << hash;
  const auto channels = readExrChannels(frames[1].file);
  for (const char* name : {"R", "G", "B", "A", "P.X", "view.0"}) ASSERT_TRUE(channels.contains(name)) << name;
  EXPECT_EQ(channels.at("A").at(12, 10), 1);
  EXPECT_GT(channels.at("R").at(12, 8), 0.1);
  EXPECT_NEAR(channels.at("P.Y").at(12, 10), -1, 0.02);  // half a pixel off the axis, facets 0.2 long
}

TEST_F(AnimationTest, ResumeKeepsWhatIsStillTrueAndRendersTheRest) {
  render();
  options_.resume = true;
  options_.command = "another command";
  EXPECT_EQ(kept(), (std::vector<bool>{true, true, true}));
  fs::remove(folder_ / "out" / "f.0002.exr");
  EXPECT_EQ(kept(), (std::vector<bool>{true, false, true}));
  EXPECT_EQ(kept({"/frames=3-4"}), (std::vector<bool>{true, false}));
  EXPECT_EQ(kept({"/lights/0/irradiance=[2,1,1]"}), (std::vector<bool>{false, false, false}));
  options_.layers = {"N"};
  EXPECT_EQ(kept({"/lights/0/irradiance=[2,1,1]"}), (std::vector<bool>{false, false, false}));
  std::ofstream(folder_ / "out" / "f.0003.exr") << "damaged";
  EXPECT_EQ(kept({"/lights/0/irradiance=[2,1,1]"}), (std::vector<bool>{true, true, false}));
}

TEST_F(AnimationTest, ResumeSeesAnotherMapUnderTheSameName) {
  options_.resume = true;
  const std::string light = R"(/lights/0={"type":"environment","map":"sky.exr","samples":4})";
  writeExr(folder_ / "sky.exr", ImageF(8, 4, 3, 1.f));
  EXPECT_EQ(kept({light, "/frames=1"}), std::vector<bool>{false});
  EXPECT_EQ(kept({light, "/frames=1"}), std::vector<bool>{true});
  writeExr(folder_ / "sky.exr", ImageF(8, 4, 3, 2.f));
  EXPECT_EQ(kept({light, "/frames=1"}), std::vector<bool>{false});
}

TEST_F(AnimationTest, ResumedFramesEqualThoseOfOneRun) {
  const auto pixels = [&] { return readImage(folder_ / "out" / "f.0003.exr").pixels.data(); };
  render();
  const auto whole = pixels();
  fs::remove(folder_ / "out" / "f.0003.exr");
  options_.resume = true;
  render();
  EXPECT_EQ(pixels(), whole);
}

TEST_F(AnimationTest, FaultsShowBeforeAnythingIsRendered) {
  EXPECT_NE(refusal({"/lights/0={\"type\":\"captured\",\"light\":\"L99\"}"}).find("/lights/0/light"),
            std::string::npos);
  EXPECT_NE(refusal({"/camera/look_at/eye={\"keys\":[[0,[0,-4,0]],[3,[0,0,0]]]}"}).find("frame 3"), std::string::npos);
  EXPECT_NE(refusal({"/srf=missing.srf"}).find("missing.srf"), std::string::npos);
  options_.layers = {"confidense"};
  EXPECT_NE(refusal().find("did you mean 'confidence'"), std::string::npos);
  options_.layers.clear();
  options_.output = (folder_ / "out" / "f.png").string();
  EXPECT_NE(refusal().find(".exr"), std::string::npos);
  options_.output.clear();
  EXPECT_NE(refusal().find("-o name.####.exr"), std::string::npos);
  writeTextFile(folder_ / "a_file", "");
  options_.output = (folder_ / "a_file" / "f.exr").string();
  EXPECT_NE(refusal().find("a_file"), std::string::npos);
  EXPECT_EQ(filesWritten(), 0u);
}

TEST_F(AnimationTest, AnInterruptLeavesWholeFramesAlone) {
  setInterruptRequested(true);
  try {
    render();
    FAIL() << "not interrupted";
  } catch (const Error& e) {
    EXPECT_EQ(e.kind(), ErrorKind::interrupted);
  }
  setInterruptRequested(false);
  if (fs::exists(folder_ / "out"))
    for (const auto& entry : fs::directory_iterator(folder_ / "out")) {
      EXPECT_EQ(entry.path().extension(), ".exr");
      EXPECT_NO_THROW(readImage(entry.path()));
    }
}

TEST_F(AnimationTest, ValuesBeyondHalfFloatsAreClampedAndCounted) {
  render({"/frames=1", "/lights/0/irradiance=[1e7,0,0]"});
  EXPECT_GT(reporter_.counters().at("pixels.clamped"), 50u);
  ASSERT_EQ(reporter_.warnings().size(), 1u);
  EXPECT_NE(reporter_.warnings()[0].find("65504"), std::string::npos);
}

TEST_F(AnimationTest, EachFrameIsToldAsItIsFinished) {
  std::vector<std::pair<int, std::size_t>> told;
  options_.finished = [&](const RenderedFrame& frame, std::size_t left) {
    EXPECT_TRUE(fs::exists(frame.file));
    EXPECT_FALSE(fs::exists(folder_ / "out" / "f.0003.exr") && left > 0);
    told.emplace_back(frame.frame, left);
  };
  render();
  EXPECT_EQ(told, (std::vector<std::pair<int, std::size_t>>{{1, 2}, {2, 1}, {3, 0}}));
}

TEST_F(AnimationTest, OpenPartsThatASequenceMovesAreWarnedOfOnce) {
  const SrfManifest manifest = readManifest(folder_ / "x.srf");
  DeformableModel model = loadModel(folder_ / "x.srf", manifest);
  model.triangles.pop_back();
  storeModel(folder_ / "x.srf", model, "sphere");
  for (const int frame : {1, 2, 3}) writePly(folder_ / frameFile("walk.####.ply", frame), model.restMesh());
  render({R"(/deformation=[{"type":"sequence","file":"walk.####.ply"}])"});
  ASSERT_EQ(reporter_.warnings().size(), 1u);
  EXPECT_NE(reporter_.warnings()[0].find("mirrored"), std::string::npos);
  EXPECT_EQ(reporter_.counters().at("points.unsure_handedness"), 3 * model.size());
}

TEST_F(AnimationTest, MirroredPointsAreCounted) {
  render({"/frames=1", R"(/deformation=[{"type":"affine","matrix":[[-1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]}])"});
  EXPECT_GT(reporter_.counters().at("points.mirrored"), 100u);
  EXPECT_EQ(reporter_.counters().at("points.not_finite"), 0u);
}

}  // namespace
}  // namespace srf
