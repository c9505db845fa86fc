#include "render/deferred_shading.h"

#include <algorithm>

#include "base/parallel.h"
#include "base/reporter.h"

namespace srf {
namespace {

/// Operations of one batch on one block.
struct Run {
  std::uint64_t key;
  std::uint32_t batch, begin, end;
};
/// Consecutive runs on one block that one thread executes with one handle.
struct Job {
  std::size_t begin, end;
};
constexpr std::size_t kJobOperations = 2048;  // enough to outweigh the handle, few enough to balance two threads

}  // namespace

void sortOperations(ShadingBatch& batch) {
  // Packed keys sort several times faster than the records themselves.
  std::vector<std::pair<std::uint64_t, std::uint32_t>> keys(batch.operations.size());
  for (std::size_t i = 0; i < keys.size(); ++i)
    keys[i] = {blockKey(batch.operations[i]), static_cast<std::uint32_t>(i)};
  std::sort(keys.begin(), keys.end());
  std::vector<ShadingOperation> sorted(keys.size());
  for (std::size_t i = 0; i < keys.size(); ++i) sorted[i] = batch.operations[keys[i].second];
  batch.operations = std::move(sorted);
}

DeferredShading::DeferredShading(std::vector<StoreGeometry> geometry, BlockCache& cache)
    : geometry_(std::move(geometry)), cache_(cache) {}

void DeferredShading::execute(std::span<ShadingBatch> batches, ExecutionOrder order) const {
  std::vector<Run> runs;
  int widest = 0;
  for (const StoreGeometry& geometry : geometry_) widest = std::max(widest, geometry.lightPad());
  for (std::size_t b = 0; b < batches.size(); ++b) {
    ShadingBatch& batch = batches[b];
    batch.results.resize(batch.operations.size());
    for (std::uint32_t i = 0; i < batch.operations.size(); ++i) {
      const std::uint64_t key = blockKey(batch.operations[i]);
      const bool joins = order == ExecutionOrder::sorted && i > 0 && runs.back().key == key;
      if (joins)
        ++runs.back().end;
      else
        runs.push_back({key, static_cast<std::uint32_t>(b), i, i + 1});
    }
  }
  std::vector<Job> jobs;
  if (order == ExecutionOrder::sorted)
    std::sort(runs.begin(), runs.end(),
              [](const Run& a, const Run& b) { return a.key != b.key ? a.key < b.key : a.batch < b.batch; });
  std::size_t operations = 0;
  for (std::size_t r = 0; r < runs.size(); ++r) {
    const bool joins =
        order == ExecutionOrder::sorted && r > 0 && runs[r].key == runs[r - 1].key && operations < kJobOperations;
    if (joins) {
      jobs.back().end = r + 1;
    } else {
      jobs.push_back({r, r + 1});
      operations = 0;
    }
    operations += runs[r].end - runs[r].begin;
  }

  const std::size_t grain = order == ExecutionOrder::sorted ? 4 : jobs.size();
  parallelFor(jobs.size(), grain, [&](std::size_t first, std::size_t last) {
    throwIfInterrupted();
    std::vector<float> scratch(3 * static_cast<std::size_t>(widest));
    for (std::size_t j = first; j < last; ++j) {
      const ShadingOperation& one = batches[runs[jobs[j].begin].batch].operations[runs[jobs[j].begin].begin];
      const StoreGeometry& geometry = geometry_[one.view];
      const int pad = geometry.lightPad(), tiles_x = geometry.tiles_x;
      const BlockCache::Handle block =
          cache_.get(ViewId{one.view}, static_cast<int>(one.tile) % tiles_x, static_cast<int>(one.tile) / tiles_x);
      const std::uint16_t* halves = block.halves().data();
      for (std::size_t r = jobs[j].begin; r < jobs[j].end; ++r) {
        ShadingBatch& batch = batches[runs[r].batch];
        for (std::uint32_t i = runs[r].begin; i < runs[r].end; ++i) {
          const ShadingOperation& operation = batch.operations[i];
          const float* weights = batch.lights.vector(batch.lights.weights[operation.lights], pad, scratch.data());
          batch.results[i] = reflectanceDot(halves, pad, operation, weights);
        }
      }
    }
  });
}

std::vector<std::array<double, 3>> sumResults(const ShadingBatch& batch) {
  std::vector<std::array<double, 3>> sums(batch.targets);
  for (std::size_t i = 0; i < batch.operations.size(); ++i)
    for (int c = 0; c < 3; ++c) sums[batch.operations[i].target][c] += batch.results[i][c];
  return sums;
}

}  // namespace srf
