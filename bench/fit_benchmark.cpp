// What the fit of the reflectance model takes at a point, beside a bare kernel over the same samples: the model's terms
// and three rounds of the sums of its normal equations, with nothing solved and nothing decided. One thread, in its
// processor time.
#include <cstdio>
#include <cstring>
#include <ctime>

#include "apps/program.h"
#include "base/error.h"
#include "bench/timing.h"
#include "model/captured_visibility.h"
#include "model/point_samples.h"
#include "model/reflectance_fit.h"
#include "model/sample_holdout.h"

namespace srf {
namespace {

constexpr std::size_t kPointsAtOnce = 64;
constexpr int kRounds = 3;  // as the fit has them

using Float8 = float __attribute__((vector_size(32)));
Float8 eight(const float* from) {
  Float8 v;
  std::memcpy(&v, from, sizeof v);
  return v;
}

/// Of this thread: other programs take none of it.
template <class Work>
double milliseconds(const Work& work) {
  const auto now = [] {
    timespec t;
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &t);
    return 1e3 * static_cast<double>(t.tv_sec) + 1e-6 * static_cast<double>(t.tv_nsec);
  };
  const double start = now();
  work();
  return now() - start;
}

class BareKernel {
 public:
  explicit BareKernel(const PointSamples& samples) : weights_(samples.values()[0].size(), 1) {
    for (auto& row : terms_) row.resize(weights_.size());
  }
  void run(const PointSamples& samples, const PointReflectance& point) {
    for (const PointSamples::View& view : samples.views()) {
      const PointSamples::Lights& l = samples.lights()[view.lights];
      modelTerms(point, view.direction, {l.x.data(), l.y.data(), l.z.data(), l.count},
                 {&terms_[0][view.first], &terms_[1][view.first], &terms_[2][view.first], &terms_[3][view.first]});
    }
    for (int round = 0; round < kRounds; ++round) {
      Float8 matrix[10] = {}, right[3][kModelTerms] = {};
      for (std::size_t i = 0; i < weights_.size(); i += 8) {
        Float8 t[kModelTerms], values[3];
        for (int k = 0; k < kModelTerms; ++k) t[k] = eight(&terms_[k][i]);
        for (int c = 0; c < 3; ++c) values[c] = eight(&samples.values()[c][i]);
        int at = 0;
        for (int k = 0; k < kModelTerms; ++k) {
          const Float8 wt = eight(&weights_[i]) * t[k];
          for (int j = 0; j <= k; ++j) matrix[at++] += wt * t[j];
          for (int c = 0; c < 3; ++c) right[c][k] += wt * values[c];
        }
      }
      for (const Float8& m : matrix) sum_ += m;
      for (const auto& channel : right)
        for (const Float8& r : channel) sum_ += r;
    }
  }
  float sum() const { return sum_[0]; }  // so that nothing is left out

 private:
  std::array<std::vector<float>, kModelTerms> terms_;
  std::vector<float> weights_;
  Float8 sum_ = {};
};

}  // namespace
}  // namespace srf

int main(int argc, char** argv) {
  using namespace srf;
  Program program("fit-benchmark", "times the fit of the reflectance model against a bare kernel",
                  "GPL-3.0-or-later (links CGAL)");
  std::string folder;
  std::size_t every = 8;
  program.app().add_option("SRF", folder, "a field whose model has a fit")->required();
  program.app().add_option("--every", every, "every n-th block of 64 points is timed")->check(CLI::Range(1, 100000));
  return program.run(argc, argv, [&](Reporter& reporter) {
    const SrfManifest field = readManifest(folder);
    const DeformableModel model = loadModel(folder, field);
    const auto fit = loadFit(folder, field, model);
    if (!fit) throw srf::Error(ErrorKind::bad_input, folder + ": its model has no fit; make one with srf model");
    std::vector<Direction<AcquisitionSpace>> normals;
    std::vector<SymmetricMatrix> turns;
    for (const FittedPoint& point : fit->points) {
      turns.push_back(point.turn);
      const auto& n = point.reflectance.normal;
      normals.push_back(*normalize(Vector<AcquisitionSpace>(Vec3{n[0], n[1], n[2]})));
    }
    const FitSamples samples(folder, field, model, normals, {program.memoryBudget(), FitOptions().most_views},
                             reporter);
    const CapturedVisibility visibility{fit->lit, fit->lit_by_rays, fit->lit_around, fit->seen_around};
    const LightLists lists(field);
    const FitInput input{field, model, lists, samples, visibility, turns};

    bench::Series load, solve, hold_out, bare;  // ms of a block
    std::size_t points = 0, values = 0;
    float sum = 0;
    SampleHoldout left_out;
    std::array<std::vector<float>, 3> of_model;
    for (std::size_t begin = 0; begin < model.size(); begin += every * kPointsAtOnce) {
      double block[4] = {};
      for (std::size_t i = begin; i < std::min(model.size(), begin + kPointsAtOnce); ++i) {
        PointSamples at;
        at.load(input, i, normals[i]);  // memory
        if (at.litSamples() == 0) continue;
        PointReflectance point = fit->points[i].reflectance;
        BareKernel kernel(at);
        block[0] += milliseconds([&] { at.load(input, i, normals[i]); });
        block[1] += milliseconds([&] { kernel.run(at, point); });
        block[2] += milliseconds([&] { at.fit(point, kRounds); });
        at.evaluate(point, of_model);
        block[3] += milliseconds([&] { sum += static_cast<float>(left_out(input, at, of_model).square); });
        sum += kernel.sum();
        ++points, values += at.values()[0].size();
      }
      if (!(block[1] > 0)) continue;
      load.add(block[0]), bare.add(block[1]), solve.add(block[2]), hold_out.add(block[3]);
    }
    if (points == 0) throw srf::Error(ErrorKind::bad_input, folder + ": no point has samples in light");
    std::printf("%s; %zu points, %zu samples each (%g)\n\n", bench::processorName().c_str(), points, values / points,
                static_cast<double>(sum));
    std::printf("| step | us a point | over the bare kernel |\n|---|---|---|\n");
    const double us = 1e3 / kPointsAtOnce;
    const auto row = [&](const char* name, const bench::Series& series) {
      std::printf("| %s | %.1f | %s |\n", name, us * series.median(),
                  bench::shownRatio(bench::ratios(series, bare)).c_str());
    };
    row("bare kernel", bare);
    row("samples read", load);
    row("solver", solve);
    row("held-out errors", hold_out);
  });
}
