// Fields that a study makes of a field, against those that the capture gives.
#include "apps/field_variants.h"

#include <gtest/gtest.h>

#include "acquire/acquire_field.h"
#include "acquire/camera_import.h"
#include "acquire/synthetic_capture.h"
#include "base/mesh_io.h"
#include "model/deformable_model.h"
#include "model/reflectance_fit.h"
#include "tests/support/test_support.h"

namespace srf {
namespace {

namespace fs = std::filesystem;
using Kind = FieldVariant::Kind;

constexpr std::size_t kMemory = std::size_t{1} << 28;

class FieldVariants : public testing::Test {
 protected:
  static void SetUpTestSuite() {
    folder_ = std::make_unique<test::TemporaryFolder>();
    SyntheticCaptureOptions synthetic;
    synthetic.shape = SyntheticShape::bumpy;
    synthetic.views = 12, synthetic.lights = 16, synthetic.size = 64;
    writeSyntheticCapture(synthetic, *folder_ / "capture", Reporter::silent());
    acquire(own(), {});
    const SrfManifest manifest = readManifest(own());
    const StoredFile& hull = *manifest.shape("hull");
    const DeformableModel model =
        buildModel(readMesh(own() / hull.file), "hull", 0.02, manifest, {}, Reporter::silent());
    storeModel(own(), model, "mesh");
    storeFit(own(), fitReflectance(own(), readManifest(own()), model, {kMemory}, Reporter::silent()).value(), "mesh");
  }
  static void TearDownTestSuite() { folder_.reset(); }

  static fs::path own() { return *folder_ / "own.srf"; }
  static SrfManifest acquire(const fs::path& out, const AcquireOptions& options) {
    return acquireField(openCapture(*folder_ / "capture", Reporter::silent()), out, options, Reporter::silent());
  }
  static fs::path make(const FieldVariant& variant) {
    const fs::path out = *folder_ / variant.name;
    makeVariant(own(), variant, out, kMemory, Reporter::silent());
    return out;
  }

  static std::unique_ptr<test::TemporaryFolder> folder_;
};
std::unique_ptr<test::TemporaryFolder> FieldVariants::folder_;

TEST_F(FieldVariants, AnotherCodingIsThatOfTheCaptureToTheBit) {
  AcquireOptions options;
  options.coding = {Compression::pca, 0.01};
  const SrfManifest wanted = acquire(*folder_ / "acquired.srf", options);
  const fs::path recoded = make({Kind::coding, "", "recoded.srf", options.coding});
  const SrfManifest found = readManifest(recoded);
  ASSERT_EQ(found.views.size(), wanted.views.size());
  for (std::size_t i = 0; i < wanted.views.size(); ++i) {
    EXPECT_EQ(found.views[i].hash, wanted.views[i].hash) << wanted.views[i].name;
    EXPECT_NE(found.views[i].hash, readManifest(own()).views[i].hash) << "the coding is the same as before";
  }
  const DeformableModel model = loadModel(recoded, found);
  EXPECT_TRUE(loadFit(recoded, found, model));
}

TEST_F(FieldVariants, ACoarserHullIsThatOfTheMasks) {
  AcquireOptions options;
  options.hull.resolution = 24;
  const SrfManifest wanted = acquire(*folder_ / "coarse.srf", options);
  const fs::path made = make({Kind::hull, "", "hull.srf", {}, 24});
  const SrfManifest found = readManifest(made);
  const auto a = readMesh(*folder_ / "coarse.srf" / wanted.shape("hull")->file),
             b = readMesh(made / found.shape("hull")->file);
  EXPECT_EQ(a.triangles.size(), b.triangles.size());
  EXPECT_LT(a.triangles.size(), readMesh(own() / readManifest(own()).shape("hull")->file).triangles.size() / 2);
  ASSERT_EQ(a.positions.size(), b.positions.size());
  for (std::size_t i = 0; i < a.positions.size(); ++i) EXPECT_LT(distance(a.positions[i], b.positions[i]), 1e-9);
  const DeformableModel model = loadModel(made, found);
  EXPECT_EQ(model.size(), b.positions.size());
  EXPECT_TRUE(loadFit(made, found, model));
  // What did not change is the same file.
  for (std::size_t i = 0; i < found.views.size(); ++i)
    EXPECT_EQ(found.views[i].hash, readManifest(own()).views[i].hash);
}

TEST_F(FieldVariants, SurfelsAreAboutAsManyAsAskedFor) {
  const fs::path made = make({Kind::surfels, "", "surfels.srf", {}, 0, 2000});
  const DeformableModel model = loadModel(made, readManifest(made));
  EXPECT_EQ(model.kind, ModelKind::surfels);
  EXPECT_GT(model.size(), 1500u);
  EXPECT_LT(model.size(), 3000u);
  EXPECT_TRUE(loadFit(made, readManifest(made), model));
}

TEST_F(FieldVariants, KnobsAreThoseThatTheFieldAndTheTimeAllow) {
  const auto names = [](const std::vector<FieldKnob>& knobs) {
    std::vector<std::string> out;
    for (const FieldKnob& knob : knobs) out.push_back(knob.name);
    return out;
  };
  using Names = std::vector<std::string>;
  EXPECT_EQ(names(fieldKnobs(own(), false, 1000, Reporter::silent())), (Names{"Compression", "Hull", "Surfels"}));
  EXPECT_EQ(names(fieldKnobs(own(), true, 1000, Reporter::silent())), (Names{"Compression", "Surfels"}));
  EXPECT_EQ(names(fieldKnobs(own(), false, 0, Reporter::silent())), Names{});
  const fs::path recoded = make({Kind::coding, "", "pca.srf", {Compression::pca, 0.01}});
  EXPECT_EQ(names(fieldKnobs(recoded, false, 1000, Reporter::silent())), (Names{"Hull", "Surfels"}));
}

}  // namespace
}  // namespace srf
