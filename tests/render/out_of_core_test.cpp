// Frames from compressed stores, from coarser levels, and from a disk past a cache of few blocks.
#include <gtest/gtest.h>

#include <cmath>
#include <random>

#include "base/half.h"
#include "base/parallel.h"
#include "render/frame_renderer.h"
#include "render/texel_products.h"
#include "tests/support/formula_field.h"
#include "tests/support/test_support.h"

namespace srf {
namespace {

namespace fs = std::filesystem;

TEST(TexelProducts, OfACompressedBlockAreThoseOfTheBlockItStandsFor) {
  std::mt19937 random(4);
  std::normal_distribution<float> normal;
  const StoreGeometry g{16, 16, 0, 0, 1, 1, 37};
  constexpr int kTexels = kTile * kTile;
  for (const int rank : {3, 8, 21}) {
    ReflectanceBlock block;
    block.rank = rank, block.pad = (rank + kRankGroup - 1) / kRankGroup * kRankGroup;
    block.halves.resize(3 * kTexels * static_cast<std::size_t>(block.pad));
    for (std::size_t i = 0; i < block.halves.size(); ++i)
      if (static_cast<int>(i % block.pad) < rank) block.halves[i] = halfFromFloat(std::round(100 * normal(random)));
    block.basis.resize(static_cast<std::size_t>(g.light_count) * block.pad);
    for (int j = 0; j < g.light_count; ++j) {
      if (j % 3 == 1) continue;  // dark
      block.lit.push_back(j);
      for (int k = 0; k < block.pad; ++k) block.basis[static_cast<std::size_t>(j) * block.pad + k] = normal(random);
    }
    // Operations with two of many shared vectors in shares; of these some with a vector of their own, some with an
    // entry. More vectors than are held at once.
    const std::size_t size = 3 * static_cast<std::size_t>(g.lightPad());
    constexpr std::uint32_t kShared = 70, kOperations = 100;
    std::vector<float> shared(kShared * size);
    for (float& value : shared) value = normal(random);
    LightGather lights;
    for (std::uint32_t v = 0; v < kShared; ++v) lights.vectors.push_back(&shared[v * size]);
    lights.entries.push_back({30, {1, -2, 3}});
    std::vector<ShadingOperation> operations(kOperations);
    for (std::uint32_t i = 0; i < kOperations; ++i) {
      LightWeights weights;
      weights.shared = {i % kShared, (3 * i + 1) % kShared, 0, 0};
      weights.share = {0.25f, 0.5f, 0, 0};
      if (i % 3 == 0) {
        weights.own = static_cast<std::uint32_t>(lights.own.size());
        for (std::size_t k = 0; k < size; ++k) lights.own.push_back(normal(random));
      }
      weights.entries = i % 2;
      lights.weights.push_back(weights);
      ShadingOperation& operation = operations[i];
      operation.lights = i;
      operation.x = static_cast<std::uint8_t>(i % kTile), operation.y = static_cast<std::uint8_t>(7 * i / 3 % kTile);
      for (int t = 0; t < 4; ++t) {
        const bool beyond = (t % 2 && operation.x == kTile - 1) || (t / 2 && operation.y == kTile - 1);
        operation.tap[t] = beyond ? 0 : 0.25f;
      }
    }
    std::vector<Rgb> together(kOperations), alone(kOperations);
    TexelProducts products;
    products.begin(block, g.light_count);
    for (std::uint32_t i = 0; i < kOperations; ++i) products.add(operations[i], lights, together[i]);
    products.flush();
    for (std::uint32_t i = 0; i < kOperations; ++i) {
      const ShadingOperation& operation = operations[i];
      const LightWeights& weights = lights.weights[i];
      products.begin(block, g.light_count);
      products.add(operation, lights, alone[i]);
      products.flush();
      EXPECT_EQ(together[i], alone[i]) << "depends on its company";
      for (int c = 0; c < 3; ++c) {
        double want = 0, terms = 0;
        for (int j = 0; j < g.light_count; ++j) {
          const std::size_t at = static_cast<std::size_t>(c) * g.lightPad() + j;
          double weight = 0.25 * lights.vectors[weights.shared[0]][at] + 0.5 * lights.vectors[weights.shared[1]][at];
          if (weights.own != LightWeights::kNone) weight += lights.own[weights.own + at];
          if (weights.entries && j == 30) weight += lights.entries[0].weight[c];
          for (int t = 0; t < 4; ++t)
            for (int k = 0; k < rank && operation.tap[t] > 0; ++k) {
              const int texel = (operation.y + t / 2) * kTile + operation.x + t % 2;
              const double term = 0.25 * floatFromHalf(block.halves[(texel * 3 + c) * block.pad + k]) *
                                  block.basis[static_cast<std::size_t>(j) * block.pad + k] * weight;
              want += term, terms += std::fabs(term);
            }
        }
        EXPECT_NEAR(together[i][c], want, terms * std::ldexp(g.light_count + rank + 16, -24)) << rank;
      }
    }
  }
}

Vec3 glossy(const Vec3& p, const Vec3& l, const Vec3& v) {
  const double cosine = dot(p, l);
  if (cosine <= 0) return {};
  const Vec3 half = l + v;
  const double gloss = 0.3 * std::pow(std::max(0.0, dot(p, half) / std::max(length(half), 1e-9)), 30);
  const double band = 0.6 + 0.4 * std::sin(14 * p.z);
  return cosine * (Vec3{0.25 * band, 0.2, 0.2 - 0.1 * band} + gloss * Vec3{1, 1, 1});
}

/// The same with noise like that of photons: 2 % at white.
Vec3 noisy(const Vec3& p, const Vec3& l, const Vec3& v) {
  static std::mt19937 random(1);
  std::normal_distribution<double> normal;
  Vec3 value = glossy(p, l, v);
  for (int c = 0; c < 3; ++c)
    value[c] = std::max(0.0, value[c] + 0.02 * std::sqrt((value[c] + 0.016) * 0.318) * normal(random));
  return value;
}

class OutOfCoreTest : public ::testing::Test {
 protected:
  static void SetUpTestSuite() {
    folder_ = std::make_unique<test::TemporaryFolder>();
    test::FormulaFieldOptions options;
    options.views = 10, options.lights = 64, options.size = 96, options.subdivision = 4, options.levels = true;
    clean_ = std::make_unique<test::FormulaField>(test::makeSphereField(*folder_ / "clean.srf", options, glossy));
    noisy_ = std::make_unique<test::FormulaField>(test::makeSphereField(*folder_ / "noisy.srf", options, noisy));
    options.coding.compression = Compression::pca;
    compressed_ = std::make_unique<test::FormulaField>(test::makeSphereField(*folder_ / "pca.srf", options, noisy));
  }
  static void TearDownTestSuite() {
    for (auto* field : {&clean_, &noisy_, &compressed_}) field->reset();
    folder_.reset();
  }
  static Deformation twist() {
    const char* text = R"([{"type":"twist","axis":[0,0,1],"degrees_per_unit":120}])";
    return AnimatedDeformation::parse(parseJson(text, "test"), ".", Reporter::silent()).at(0);
  }
  static FrameLights lights() {
    FrameLights lights;
    for (int i = 0; i < 40; ++i)
      lights.distant.push_back({Direction<ObjectSpace>::fromUnit(test::fibonacci(i, 40)), {0.1, 0.1, 0.12}});
    lights.near_lights.push_back({Point<ObjectSpace>(2, -3, 1), {3, 3, 3}});
    return lights;
  }
  static Camera<ObjectSpace> camera(int size, double distance) {
    Camera<ObjectSpace> camera;
    camera.lens = pinholeFromFov(size, size, 36);
    camera.pose = *lookAt(Point<ObjectSpace>(0.1 * distance, -distance, 0.2 * distance), Point<ObjectSpace>(),
                          Vector<ObjectSpace>(0, 0, 1));
    return camera;
  }
  /// `figures`: of the reporter afterwards.
  static Frame render(const test::FormulaField& field, const FrameSettings& settings, const Camera<ObjectSpace>& camera,
                      const Deformation& psi = twist(), std::map<std::string, double>* figures = nullptr) {
    DeformedModel deformed(field.model);
    deformed.deform(psi);
    Reporter reporter(ProgressMode::none, LogLevel::error);
    FrameRenderer renderer(field.folder, field.manifest, field.model, settings, reporter);
    Frame frame = renderer.render(camera, deformed, lights());
    if (figures) *figures = reporter.figures();
    return frame;
  }
  static double distance(const Frame& a, const Frame& b) {
    double sum = 0;
    for (std::size_t i = 0; i < a.rgba.data().size(); ++i)
      if (i % 4 < 3) sum += std::pow(static_cast<double>(a.rgba.data()[i]) - b.rgba.data()[i], 2);
    return std::sqrt(sum / static_cast<double>(a.rgba.data().size()));
  }
  static std::size_t blockBytes() { return ReflectanceStore(noisy_->folder / "views/v0.blk").geometry().blockBytes(); }

  static std::unique_ptr<test::TemporaryFolder> folder_;
  static std::unique_ptr<test::FormulaField> clean_, noisy_, compressed_;
};
std::unique_ptr<test::TemporaryFolder> OutOfCoreTest::folder_;
std::unique_ptr<test::FormulaField> OutOfCoreTest::clean_, OutOfCoreTest::noisy_, OutOfCoreTest::compressed_;

TEST_F(OutOfCoreTest, NeitherThreadsNorCacheSizeChangeABitOfALosslessOrCompressedFrame) {
  for (const auto* field : {noisy_.get(), compressed_.get()}) {
    std::optional<Frame> want;
    for (const int threads : {1, 2, 3})
      for (const std::size_t blocks : {1, 3, 1000}) {
        setThreadCount(threads);
        FrameSettings settings;
        settings.cache_bytes = blocks * blockBytes();
        const Frame got = render(*field, settings, camera(64, 5));
        if (!want) want = got;
        EXPECT_EQ(got.rgba.data(), want->rgba.data()) << threads << " threads, " << blocks << " blocks";
      }
    setThreadCount(0);
    FrameSettings settings;
    settings.order = ExecutionOrder::immediate;
    EXPECT_EQ(render(*field, settings, camera(64, 5)).rgba.data(), want->rgba.data());
  }
}

TEST_F(OutOfCoreTest, EveryBlockIsReadOnceThroughACacheOfThreeBlocksThatKeepsToItsBudget) {
  for (const auto* field : {noisy_.get(), compressed_.get()}) {
    FrameSettings settings;
    settings.cache_bytes = 3 * blockBytes();
    std::map<std::string, double> sorted, immediate;
    render(*field, settings, camera(64, 5), twist(), &sorted);
    settings.order = ExecutionOrder::immediate;
    render(*field, settings, camera(64, 5), twist(), &immediate);
    EXPECT_EQ(sorted["cache.reread"], 0);
    EXPECT_LE(sorted["cache.peak_bytes"], 3.0 * static_cast<double>(blockBytes()));
    if (field == noisy_.get()) {
      EXPECT_GT(immediate["cache.misses"], 10 * sorted["cache.misses"]);
    }
  }
}

TEST_F(OutOfCoreTest, PrincipalComponentsComeAsNearToTheTruthAsLosslessBlocks) {
  const Frame truth = render(*clean_, {}, camera(96, 4)), lossless = render(*noisy_, {}, camera(96, 4)),
              pca = render(*compressed_, {}, camera(96, 4));
  const double noise = distance(lossless, truth), error = distance(pca, truth);
  // What single photographs hold, where noise does not average out over lights.
  double squares[2] = {0, 0}, halves = 0, bytes = 0;
  for (const StoredView& view : clean_->manifest.views) {
    const ReflectanceStore a(clean_->folder / view.file), b(noisy_->folder / view.file),
        c(compressed_->folder / view.file);
    const StoreGeometry& g = a.geometry();
    std::vector<std::uint16_t> block(g.blockHalves()), other(g.blockHalves());
    for (int tile = 0; tile < g.tileCount(); ++tile) {
      a.readTile(tile % g.tiles_x, tile / g.tiles_x, block);
      for (int k = 0; k < 2; ++k) {
        (k ? c : b).readTile(tile % g.tiles_x, tile / g.tiles_x, other);
        for (std::size_t i = 0; i < block.size(); ++i)
          squares[k] += std::pow(static_cast<double>(floatFromHalf(block[i])) - floatFromHalf(other[i]), 2);
      }
    }
    for (int y = 0; y < g.cropHeight(); ++y)
      for (int x = 0; x < g.cropWidth(); ++x) halves += a.coverage().at(x, y) > 0 ? 6.0 * g.light_count : 0.0;
    bytes += static_cast<double>(c.bytesOnDisk());
    EXPECT_GT(c.fidelity().relative_error, 0);
  }
  const double photographs = 10 * std::log10(squares[1] / squares[0]), frame = 20 * std::log10(error / noise);
  std::printf(
      "against the clean truth: photographs %.2f dB, frame %.2f dB of the lossless ones' error; halves / bytes %.1f\n",
      photographs, frame, halves / bytes);
  EXPECT_LE(photographs, 0.5);
  EXPECT_LE(frame, 0.5);
}

// ---- levels ----

TEST_F(OutOfCoreTest, APhotographFromWhereItWasTakenComesFromTheFinestLevel) {
  const StoredView& view = clean_->manifest.views[3];
  Camera<ObjectSpace> camera;
  camera.lens = view.camera.lens;
  camera.pose =
      *lookAt(Point<ObjectSpace>(view.camera.pose.origin().raw()), Point<ObjectSpace>(), Vector<ObjectSpace>(0, 0, 1));
  FrameSettings settings;
  settings.layers = {"view"};
  const Frame with = render(*clean_, settings, camera, {});
  settings.accuracy.texels = 0;
  const Frame without = render(*clean_, settings, camera, {});
  // Pixels that this photograph makes, but for what its neighbours add at angles of rounding; at the rim others stand
  // in.
  std::size_t alone = 0;
  double most = 0;
  for (std::size_t i = 0; i < with.rgba.data().size() / 4; ++i) {
    if (with.layers.at("view.0").data()[i] != 3 || !(with.layers.at("view.weight.0").data()[i] > 0.9999f)) continue;
    ++alone;
    for (std::size_t c = 4 * i; c < 4 * i + 3; ++c)
      most = std::max(most, std::fabs(static_cast<double>(with.rgba.data()[c]) - without.rgba.data()[c]));
  }
  EXPECT_GT(alone, 3000u);
  EXPECT_LT(most, 1e-5);
}

TEST_F(OutOfCoreTest, ASmallPictureIsNearerToItsTrueMeanFromCoarserLevelsAndReadsLess) {
  FrameSettings fine, coarse, truth;
  fine.accuracy.texels = truth.accuracy.texels = 0;
  truth.samples = 64;
  std::map<std::string, double> read_fine, read_coarse;
  const auto small = camera(24, 6);
  const Frame want = render(*noisy_, truth, small, {});
  const Frame a = render(*noisy_, fine, small, {}, &read_fine), b = render(*noisy_, coarse, small, {}, &read_coarse);
  // At the silhouette one sample a pixel decides on coverage: pixels that are wholly covered alone tell.
  double errors[2] = {0, 0};
  for (std::size_t i = 0; i < want.rgba.data().size(); i += 4)
    if (want.rgba.data()[i + 3] == 1)
      for (std::size_t c = i; c < i + 3; ++c) {
        errors[0] += std::pow(a.rgba.data()[c] - want.rgba.data()[c], 2);
        errors[1] += std::pow(b.rgba.data()[c] - want.rgba.data()[c], 2);
      }
  std::printf("error %.5f from the finest level, %.5f from coarser ones; MB read %.2f and %.2f\n", std::sqrt(errors[0]),
              std::sqrt(errors[1]), read_fine["cache.bytes_read"] / 1e6, read_coarse["cache.bytes_read"] / 1e6);
  EXPECT_LT(errors[1], 0.7 * errors[0]);
  EXPECT_LT(read_coarse["cache.bytes_read"], 0.8 * read_fine["cache.bytes_read"]);
}

TEST_F(OutOfCoreTest, MoreSamplesAPixelTakeFinerLevels) {
  FrameSettings one, many;
  many.samples = 64;
  std::map<std::string, double> read_one, read_many;
  render(*noisy_, one, camera(24, 6), {}, &read_one);
  render(*noisy_, many, camera(24, 6), {}, &read_many);
  EXPECT_GT(read_many["cache.bytes_read"], 1.5 * read_one["cache.bytes_read"]);
}

}  // namespace
}  // namespace srf
