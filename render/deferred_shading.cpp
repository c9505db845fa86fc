#include "render/deferred_shading.h"

#include <algorithm>
#include <atomic>
#include <numeric>
#include <unordered_map>

#include "base/check.h"
#include "base/parallel.h"
#include "base/reporter.h"
#include "render/texel_products.h"

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
struct Item {
  const ShadingOperation* operation;
  const LightGather* lights;
  Rgb* result;
};
constexpr std::size_t kJobOperations = 2048;  // enough to outweigh the handle, few enough to balance two threads

}  // namespace

void sortOperations(ShadingBatch& batch) {
  // A batch touches few blocks, mostly those of the operations just before: distributing by block is several times
  // faster than sorting by comparison.
  struct Memory {
    std::unordered_map<std::uint64_t, std::uint32_t> known;  // key to position in keys
    std::vector<std::uint64_t> keys;                         // of the blocks, as they are met
    std::vector<std::uint32_t> count;                        // of each block's operations
    std::vector<std::uint32_t> block;                        // of each operation, into keys
    std::vector<std::uint32_t> order, next;
    std::vector<ShadingOperation> sorted;
  };
  thread_local Memory memory;
  auto& [known, keys, count, block, order, next, sorted] = memory;
  const std::vector<ShadingOperation>& operations = batch.operations;
  known.clear(), keys.clear(), count.clear();
  block.resize(operations.size());
  for (std::size_t i = 0; i < operations.size(); ++i) {
    const std::uint64_t key = blockKey(operations[i]);
    std::uint32_t found = static_cast<std::uint32_t>(keys.size());
    for (std::size_t back = 1; back <= std::min<std::size_t>(i, 8); ++back)
      if (keys[block[i - back]] == key) {
        found = block[i - back];
        break;
      }
    if (found == keys.size()) {
      const auto [entry, added] = known.try_emplace(key, found);
      found = entry->second;
      if (added) {
        keys.push_back(key);
        count.push_back(0);
      }
    }
    block[i] = found;
    ++count[found];
  }
  order.resize(keys.size());
  std::iota(order.begin(), order.end(), 0u);
  std::sort(order.begin(), order.end(), [&](std::uint32_t a, std::uint32_t b) { return keys[a] < keys[b]; });
  next.resize(keys.size());  // where the next operation of a block goes
  std::uint32_t begin = 0;
  batch.runs.clear();
  for (const std::uint32_t b : order) {
    next[b] = begin;
    batch.runs.push_back({keys[b], begin, begin + count[b]});
    begin += count[b];
  }
  sorted.resize(operations.size());
  for (std::size_t i = 0; i < operations.size(); ++i) sorted[next[block[i]]++] = operations[i];
  batch.operations.swap(sorted);
}

DeferredShading::DeferredShading(std::vector<StoreGeometry> geometry, BlockCache& cache)
    : geometry_(std::move(geometry)), cache_(cache) {}

void DeferredShading::execute(std::span<ShadingBatch> batches, ExecutionOrder order) {
  const bool sorted = order == ExecutionOrder::sorted;
  parallelFor(batches.size(), 16, [&](std::size_t first, std::size_t last) {
    for (std::size_t b = first; b < last; ++b) batches[b].results.resize(batches[b].operations.size());
  });
  std::vector<Run> runs;
  for (std::uint32_t b = 0; b < batches.size(); ++b) {
    const std::vector<ShadingOperation>& operations = batches[b].operations;
    if (!sorted) {
      for (std::uint32_t i = 0; i < operations.size(); ++i) runs.push_back({blockKey(operations[i]), b, i, i + 1});
      continue;
    }
    SRF_CHECK((batches[b].runs.empty() ? 0 : batches[b].runs.back().end) == operations.size());
    for (const BlockRun& run : batches[b].runs) runs.push_back({run.key, b, run.begin, run.end});
  }
  std::vector<Job> jobs;
  if (sorted)
    std::sort(runs.begin(), runs.end(),
              [](const Run& a, const Run& b) { return a.key != b.key ? a.key < b.key : a.batch < b.batch; });
  std::size_t operations = 0;
  for (std::size_t r = 0; r < runs.size(); ++r) {
    const bool joins = sorted && r > 0 && runs[r].key == runs[r - 1].key && operations < kJobOperations;
    if (joins) {
      jobs.back().end = r + 1;
    } else {
      jobs.push_back({r, r + 1});
      operations = 0;
    }
    operations += runs[r].end - runs[r].begin;
  }

  // In the order of the plan, so that blocks are used as they come. Threads take the next job when they are free.
  if (sorted) {
    last_plan_.clear();
    for (const Job& job : jobs) last_plan_.push_back(runs[job.begin].key);
    cache_.plan(last_plan_);
  }
  std::atomic<std::size_t> next{0};
  parallelFor(sorted ? static_cast<std::size_t>(threadCount()) : 1, 1, [&](std::size_t, std::size_t) {
    thread_local TexelProducts products;
    thread_local std::vector<Item> items;
    for (std::size_t j = next++; j < jobs.size(); j = next++) {
      throwIfInterrupted();
      items.clear();
      for (std::size_t r = jobs[j].begin; r < jobs[j].end; ++r) {
        ShadingBatch& batch = batches[runs[r].batch];
        for (std::uint32_t i = runs[r].begin; i < runs[r].end; ++i)
          items.push_back({&batch.operations[i], &batch.lights, &batch.results[i]});
      }
      const ShadingOperation& one = *items.front().operation;
      const BlockCache::Handle handle = cache_.get(ViewId{one.view}, one.tile);
      products.begin(handle.block(), geometry_[one.view].light_count);
      // Operations lie where their batches are, their weights and entries where the hits are: each is fetched ahead.
      constexpr std::size_t kAhead = 12;
      const std::size_t count = items.size();
      for (std::size_t i = 0; i < count; ++i) {
        if (i + 4 * kAhead < count) __builtin_prefetch(items[i + 4 * kAhead].operation);
        if (i + 2 * kAhead < count)
          products.prefetchWeights(*items[i + 2 * kAhead].operation, *items[i + 2 * kAhead].lights);
        if (i + kAhead < count) products.prefetchEntries(*items[i + kAhead].operation, *items[i + kAhead].lights);
        products.add(*items[i].operation, *items[i].lights, *items[i].result);
      }
      products.flush();
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
