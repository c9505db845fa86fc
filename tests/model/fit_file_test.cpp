#include <gtest/gtest.h>

#include <fstream>
#include <random>

#include "base/error.h"
#include "base/files.h"
#include "base/numeric.h"
#include "model/reflectance_fit.h"
#include "tests/model/test_shapes.h"
#include "tests/support/test_support.h"

namespace srf {
namespace {

struct Stored {
  test::TemporaryFolder folder;
  DeformableModel model;
  ReflectanceFit fit;

  Stored() {
    std::filesystem::create_directories(folder / "models");
    SrfManifest field = test::fieldAround(5);
    for (StoredView& view : field.views) view.lights.clear();
    while (field.lights.size() < 70) {
      field.lights.push_back(field.lights[0]);
      field.lights.back().name = "L" + std::to_string(field.lights.size());
    }
    writeManifest(folder.path(), field);
    model = buildModel(test::sphere(6), "sphere", 0, field, {}, Reporter::silent());
    storeModel(folder.path(), model, "mesh");

    std::mt19937 random(7);
    const auto uniform = [&random] { return static_cast<float>(random() % 10001) / 10000; };
    fit.points.resize(model.size());
    for (FittedPoint& point : fit.points) {
      const Vec3 raw{uniform() - 0.5, uniform() - 0.5, uniform() - 0.5};
      const Direction<AcquisitionSpace> n = *normalize(Vector<AcquisitionSpace>(raw + Vec3{1e-3, 0, 0}));
      const Direction<AcquisitionSpace> t = anyPerpendicular(n);
      const double angle = 6 * uniform();
      const Vec3 turned = std::cos(angle) * t.raw() + std::sin(angle) * cross(n.raw(), t.raw());
      for (int c = 0; c < 3; ++c) {
        point.reflectance.normal[c] = static_cast<float>(n.raw()[c]);
        point.reflectance.tangent[c] = static_cast<float>(turned[c]);
        for (auto& term : point.reflectance.coefficient) term[c] = 5 * uniform();
      }
      point.turn = symmetricInPlane(40 * uniform() - 20, 10 * uniform() - 5, 40 * uniform() - 20, t.raw(),
                                    cross(n.raw(), t.raw()));
      const bool rough = random() % 2;
      point.reflectance.alpha_x = rough ? 0.5f : 0.1f, point.reflectance.alpha_y = rough ? 0.5f : 0.25f;
      point.gate = uniform(), point.indirect = uniform(), point.indirect_shadow = uniform(), point.slant = uniform();
    }
    fit.lit = fit.lit_around = fit.worse = VisibilityBits(model.size(), 70);
    fit.seen_around = VisibilityBits(model.size(), 5);
    for (std::size_t i = 0; i < model.size(); ++i) {
      for (std::size_t k = 0; k < 70; ++k) {
        if (random() % 2) fit.lit.set(i, k);
        if (random() % 2) fit.lit_around.set(i, k);
        if (random() % 2) fit.worse.set(i, k);
      }
      for (std::size_t k = 0; k < 5; ++k)
        if (random() % 2) fit.seen_around.set(i, k);
    }
    fit.lit_by_rays = fit.lit;
    fit.error_plain = 0.5, fit.error_guided = 0.125;
  }
  std::filesystem::path file() const { return folder.path() / readManifest(folder.path()).fit("mesh")->file; }
};

void expectSame(const ReflectanceFit& found, const ReflectanceFit& fit) {
  ASSERT_EQ(found.points.size(), fit.points.size());
  for (std::size_t i = 0; i < fit.points.size(); ++i) {
    const FittedPoint &a = found.points[i], &b = fit.points[i];
    double normal = 0, tangent = 0, length = 0, upright = 0;
    for (int c = 0; c < 3; ++c) {
      normal += a.reflectance.normal[c] * b.reflectance.normal[c];
      tangent += a.reflectance.tangent[c] * b.reflectance.tangent[c];
      length += square(a.reflectance.tangent[c]);
      upright += a.reflectance.normal[c] * a.reflectance.tangent[c];
      // Halves have 11 bits.
      for (int k = 0; k < kModelTerms; ++k)
        EXPECT_NEAR(a.reflectance.coefficient[k][c], b.reflectance.coefficient[k][c], 5 * std::ldexp(1, -11));
    }
    EXPECT_GT(normal, 1 - 1e-6);              // 15 bits for an octant's side: 1e-4 rad at most
    EXPECT_GT(std::fabs(tangent), 1 - 1e-6);  // 16 bits for half a turn; its sign means nothing
    EXPECT_NEAR(length, 1, 1e-5);
    EXPECT_NEAR(upright, 0, 1e-6);
    EXPECT_EQ(a.reflectance.alpha_x, b.reflectance.alpha_x);
    EXPECT_EQ(a.reflectance.alpha_y, b.reflectance.alpha_y);
    EXPECT_NEAR(a.gate, b.gate, 0.5 / 255 + 1e-6);
    EXPECT_NEAR(a.indirect, b.indirect, 0.5 / 255 + 1e-6);
    EXPECT_NEAR(a.indirect_shadow, b.indirect_shadow, 0.5 / 255 + 1e-6);
    EXPECT_NEAR(a.slant, b.slant, 0.5 / 255 + 1e-6);
    for (int k = 0; k < 6; ++k) EXPECT_NEAR(a.turn[k], b.turn[k], 20 * 4e-4);  // in the plane of the normal as stored
  }
  EXPECT_EQ(found.lit.words(), fit.lit.words());
  EXPECT_EQ(found.lit_by_rays.words(), fit.lit_by_rays.words());
  EXPECT_EQ(found.lit_around.words(), fit.lit_around.words());
  EXPECT_EQ(found.seen_around.words(), fit.seen_around.words());
  EXPECT_EQ(found.worse.words(), fit.worse.words());
  EXPECT_EQ(found.error_plain, fit.error_plain);
  EXPECT_EQ(found.error_guided, fit.error_guided);
}

TEST(FitFile, ComesBackAsItWasStored) {
  Stored stored;
  EXPECT_FALSE(loadFit(stored.folder.path(), readManifest(stored.folder.path()), stored.model));
  storeFit(stored.folder.path(), stored.fit, "mesh");
  expectSame(*loadFit(stored.folder.path(), readManifest(stored.folder.path()), stored.model), stored.fit);
  // Bits that photographs overruled are kept apart.
  stored.fit.lit.words()[3] ^= 5;
  storeFit(stored.folder.path(), stored.fit, "mesh");
  expectSame(*loadFit(stored.folder.path(), readManifest(stored.folder.path()), stored.model), stored.fit);
}

TEST(FitFile, GoesWithItsModel) {
  Stored stored;
  storeFit(stored.folder.path(), stored.fit, "mesh");
  const std::filesystem::path file = stored.file();
  storeModel(stored.folder.path(), stored.model, "other");
  EXPECT_FALSE(loadFit(stored.folder.path(), readManifest(stored.folder.path()), stored.model));
  EXPECT_TRUE(std::filesystem::exists(file));  // 'mesh' still has it
  storeModel(stored.folder.path(), stored.model, "mesh");
  EXPECT_FALSE(loadFit(stored.folder.path(), readManifest(stored.folder.path()), stored.model));
  EXPECT_FALSE(std::filesystem::exists(file));
}

// Every byte of the file is under the manifest's hash; a file whose hash is right is read with care all the same.
TEST(FitFile, RejectsWhatIsDamagedOrOfAnotherModel) {
  Stored stored;
  storeFit(stored.folder.path(), stored.fit, "mesh");
  const std::filesystem::path file = stored.file();
  const std::vector<std::byte> good = readBinaryFile(file);
  const auto load = [&](const DeformableModel& model) {
    return loadFit(stored.folder.path(), readManifest(stored.folder.path()), model);
  };
  std::vector<std::byte> bytes = good;
  bytes[bytes.size() / 2] ^= std::byte{1};
  writeBinaryFile(file, bytes.data(), bytes.size());
  EXPECT_THROW(load(stored.model), Error);

  const auto load_as = [&](const std::vector<std::byte>& content) {
    writeBinaryFile(file, content.data(), content.size());
    SrfManifest manifest = readManifest(stored.folder.path());
    manifest.fits[0].hash = contentHash(content.data(), content.size());
    return loadFit(stored.folder.path(), manifest, stored.model);
  };
  EXPECT_TRUE(load_as(good));
  for (std::size_t size : {std::size_t{0}, std::size_t{10}, std::size_t{40}, good.size() / 2, good.size() - 1})
    EXPECT_THROW(load_as({good.begin(), good.begin() + static_cast<std::ptrdiff_t>(size)}), Error) << size;
  bytes = good;
  bytes.push_back({});
  EXPECT_THROW(load_as(bytes), Error);
  // Any single byte: either refused, or a fit whose numbers are all in range.
  std::mt19937 random(3);
  for (int i = 0; i < 300; ++i) {
    bytes = good;
    bytes[i < 200 ? i : random() % bytes.size()] = static_cast<std::byte>(random());
    try {
      const auto fit = load_as(bytes);
      for (const FittedPoint& point : fit->points)
        for (const auto& term : point.reflectance.coefficient)
          for (const float value : term) ASSERT_TRUE(value >= 0 && std::isfinite(value));
    } catch (const Error&) {}
  }
  writeBinaryFile(file, good.data(), good.size());
  DeformableModel smaller = stored.model;
  smaller.p0.pop_back();
  EXPECT_THROW(load(smaller), Error);
}

}  // namespace
}  // namespace srf
