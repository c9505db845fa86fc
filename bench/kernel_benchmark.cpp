// The renderer's kernels, each beside its plain counterpart in double, which the tests hold it against. One thread;
// everything lies in the processor's caches. `items` are products of a channel and a light, values of the model, keys
// or directions, as the name says.
#include <benchmark/benchmark.h>

#include <random>
#include <vector>

#include "base/half.h"
#include "base/numeric.h"
#include "render/acquired_lights.h"
#include "render/guided_kernels.h"
#include "render/light_kernels.h"
#include "render/reflectance_dot.h"
#include "render/texel_kernels.h"

namespace srf {
namespace {

constexpr int kLights = 112;       // 100 acquired lights, padded
constexpr std::size_t kSky = 256;  // lights of an environment

std::vector<float> randomFloats(std::size_t count, float least = 0, float most = 1) {
  std::mt19937 random(static_cast<unsigned>(count));
  std::uniform_real_distribution<float> uniform(least, most);
  std::vector<float> values(count);
  for (float& v : values) v = uniform(random);
  return values;
}
std::vector<std::uint16_t> randomHalves(std::size_t count) {
  std::vector<std::uint16_t> halves(count);
  halvesFromFloats(randomFloats(count).data(), halves.data(), static_cast<int>(count));
  return halves;
}
void countItems(benchmark::State& state, double each) {
  state.counters["items"] = benchmark::Counter(each, benchmark::Counter::kIsIterationInvariantRate);
}

/// Lights all around, and a point of the fitted model that is seen aslant.
struct Guided {
  std::array<std::vector<float>, 3> direction, amount;
  PointReflectance point;
  std::array<float, 3> view{0.6f, 0, 0.8f};
  ModelOfPoint model;
  ModelView model_view;
  explicit Guided(std::size_t lights) {
    for (std::size_t i = 0; i < lights; ++i) {
      const double z = 1 - (static_cast<double>(i) + 0.5) * 2 / static_cast<double>(lights), r = std::sqrt(1 - z * z),
                   angle = 2.4 * static_cast<double>(i);
      direction[0].push_back(static_cast<float>(r * std::cos(angle)));
      direction[1].push_back(static_cast<float>(r * std::sin(angle)));
      direction[2].push_back(static_cast<float>(z));
    }
    for (auto& channel : amount) channel = randomFloats(lights);
    point.normal = {0, 0, 1}, point.tangent = {1, 0, 0};
    point.alpha_x = point.alpha_y = 0.2f;
    for (auto& term : point.coefficient) term = {0.3f, 0.4f, 0.5f};
    model = modelOfPoint(point);
    model_view = addView(model, point, view, 1);
  }
  DirectionLanes lanes() const { return {direction[0].data(), direction[1].data(), direction[2].data()}; }
  std::array<const float*, 3> amounts() const { return {amount[0].data(), amount[1].data(), amount[2].data()}; }
};

ShadingOperation fourTexels() {
  ShadingOperation operation{};
  operation.x = 3, operation.y = 5;
  for (float& tap : operation.tap) tap = 0.25f;
  return operation;
}

void reflectanceDotOfFourTexels(benchmark::State& state) {
  const auto block = randomHalves(std::size_t{256} * 3 * kLights);
  const auto weights = randomFloats(std::size_t{3} * kLights);
  for (auto _ : state) benchmark::DoNotOptimize(reflectanceDot(block.data(), kLights, fourTexels(), weights.data()));
  countItems(state, 4 * 3 * kLights);
}
void reflectanceDotOfFourTexelsInDouble(benchmark::State& state) {
  const auto block = randomHalves(std::size_t{256} * 3 * kLights);
  const auto weights = randomFloats(std::size_t{3} * kLights);
  for (auto _ : state)
    benchmark::DoNotOptimize(reflectanceDotReference(block.data(), kLights, fourTexels(), weights.data()));
  countItems(state, 4 * 3 * kLights);
}
BENCHMARK(reflectanceDotOfFourTexels);
BENCHMARK(reflectanceDotOfFourTexelsInDouble);

void texelByFourVectors(benchmark::State& state) {
  const auto texel = randomHalves(std::size_t{3} * kLights);
  const auto vectors = randomFloats(std::size_t{12} * kLights);
  const float* each[kProductVectors];
  float products[kProductVectors][4];
  float* to[kProductVectors];
  for (int i = 0; i < kProductVectors; ++i) each[i] = vectors.data() + i * 3 * kLights, to[i] = products[i];
  for (auto _ : state) {
    texelDots(texel.data(), kLights, each, kProductVectors, to);
    benchmark::DoNotOptimize(products);
  }
  countItems(state, kProductVectors * 3 * kLights);
}
void texelByAVectorInDouble(benchmark::State& state) {
  const auto texel = randomHalves(std::size_t{3} * kLights);
  const auto vector = randomFloats(std::size_t{3} * kLights);
  for (auto _ : state) benchmark::DoNotOptimize(texelDotReference(texel.data(), kLights, vector.data()));
  countItems(state, 3 * kLights);
}
BENCHMARK(texelByFourVectors);
BENCHMARK(texelByAVectorInDouble);

void blendOfFourVectors(benchmark::State& state) {
  const auto vectors = randomFloats(std::size_t{12} * kLights);
  std::vector<float> sum(std::size_t{3} * kLights);
  std::array<const float*, 4> each;
  for (std::size_t i = 0; i < 4; ++i) each[i] = vectors.data() + i * sum.size();
  for (auto _ : state) {
    blendVectors(each, {0.4f, 0.3f, 0.2f, 0.1f}, sum.size(), sum.data());
    benchmark::ClobberMemory();
  }
  countItems(state, 4 * 3 * kLights);
}
BENCHMARK(blendOfFourVectors);

void modelValues(benchmark::State& state) {
  const Guided guided(kSky);
  for (auto _ : state)
    benchmark::DoNotOptimize(modelSums(guided.model, &guided.model_view, 1, guided.lanes(), guided.amounts(), kSky));
  countItems(state, kSky);
}
void modelValuesInDouble(benchmark::State& state) {
  const Guided guided(kSky);
  for (auto _ : state)
    benchmark::DoNotOptimize(modelSumsReference(guided.point, guided.view, guided.lanes(), guided.amounts(), kSky));
  countItems(state, kSky);
}
BENCHMARK(modelValues);
BENCHMARK(modelValuesInDouble);

void modelAnswersOfAnEnvironment(benchmark::State& state) {
  const Guided guided(kSky);
  std::vector<float> answers(3 * kSky);
  for (auto _ : state) {
    modelAnswers(guided.model, guided.model_view, guided.lanes(), guided.amounts(), kSky,
                 {answers.data(), answers.data() + kSky, answers.data() + 2 * kSky});
    benchmark::ClobberMemory();
  }
  countItems(state, kSky);
}
void largestOfTheAnswers(benchmark::State& state) {
  const auto keys = randomFloats(kSky);
  std::vector<std::uint32_t> position(kSky);
  std::int32_t about = 0;
  for (auto _ : state) {
    benchmark::DoNotOptimize(
        largestKeys(keys.data(), kSky, static_cast<std::size_t>(state.range(0)), position.data(), about));
    benchmark::ClobberMemory();
  }
  countItems(state, kSky);
}
BENCHMARK(modelAnswersOfAnEnvironment);
BENCHMARK(largestOfTheAnswers)->Arg(8)->Arg(32);

/// 100 lights about a small object, and directions among them.
struct Captured {
  std::vector<CaptureLight> lights;
  std::vector<LightId> ids;
  Guided directions{kSky};
  AcquiredLights list;
  Captured() : list(make()) {}

 private:
  AcquiredLights make() {
    const Guided around(100);
    for (std::uint32_t i = 0; i < 100; ++i) {
      CaptureLight light;
      light.direction =
          *normalize(Vector<AcquisitionSpace>(around.direction[0][i], around.direction[1][i], around.direction[2][i]));
      lights.push_back(light);
      ids.push_back({i});
    }
    Box<AcquisitionSpace> box;
    box.extend({-1, -1, -1});
    box.extend({1, 1, 1});
    return {ids, lights, box, 4};
  }
};
void nearestOfHundredLights(benchmark::State& state) {
  const Captured captured;
  const LightCells cells = *captured.list.cells();
  const auto [x, y, z] = captured.directions.lanes();
  std::vector<std::int32_t> cell(kSky);
  std::vector<float> weight(4 * kSky);
  std::vector<std::uint32_t> light(4 * kSky);
  for (auto _ : state) {
    lightCells(x, y, z, kSky, cells.resolution, cell.data());
    nearestWeights(cells, x, y, z, cell.data(), kSky, 4, kSky, weight.data(), light.data());
    benchmark::ClobberMemory();
  }
  countItems(state, kSky);
}
void nearestOfHundredLightsByTrial(benchmark::State& state) {
  const Captured captured;
  std::vector<Penalised> all;
  std::vector<Weighted> weights;
  for (auto _ : state)
    for (std::size_t q = 0; q < kSky; ++q) {
      const auto& d = captured.directions.direction;
      const auto direction = Direction<AcquisitionSpace>::fromUnit(Vec3{d[0][q], d[1][q], d[2][q]});
      all.clear();
      for (std::uint32_t i = 0; i < captured.lights.size(); ++i)
        all.push_back({angleBetween(direction, captured.list.directionOf(i, {})), i});
      lumigraphWeights(all, 4, weights);
      benchmark::DoNotOptimize(weights.data());
    }
  countItems(state, kSky);
}
BENCHMARK(nearestOfHundredLights);
BENCHMARK(nearestOfHundredLightsByTrial);

}  // namespace
}  // namespace srf

BENCHMARK_MAIN();
