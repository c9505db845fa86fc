// Executes gathered shading operations block by block against the cache, and adds them up (M15; claims 19, 20).
#pragma once

#include <span>
#include <vector>

#include "field/block_cache.h"
#include "render/light_weights.h"
#include "render/shading_operation.h"

namespace srf {

/// Operations of a batch on one block of the store.
struct BlockRun {
  std::uint64_t key;
  std::uint32_t begin, end;
};

/// The operations of one block of pixels. Which operations share a batch is fixed by the frame alone.
struct ShadingBatch {
  std::uint32_t targets = 0;                 ///< hits
  std::vector<ShadingOperation> operations;  ///< in any order until they are sorted
  std::vector<BlockRun> runs;                ///< of sorted operations
  LightGather lights;
  std::vector<Rgb> results;  ///< of each operation
};

/// Orders the operations by blockKey, and alike ones as they were gathered; tells their runs.
void sortOperations(ShadingBatch& batch);

enum class ExecutionOrder {
  sorted,    ///< by block over all batches: each block is fetched once
  immediate  ///< one operation after the other as they stand, on one thread: the oracle, and what sorting is measured
             ///< by
};

class DeferredShading {
 public:
  /// `geometry[i]` is that of ViewId{i}'s store.
  DeferredShading(std::vector<StoreGeometry> geometry, BlockCache& cache);
  /// Fills `results` of every batch. Light vectors must be resolved, operations sorted
  /// (sortOperations) unless the order is immediate.
  void execute(std::span<ShadingBatch> batches, ExecutionOrder order = ExecutionOrder::sorted);
  /// The blocks that the last sorted execution asked for, in their order: another frame is likely to want them too.
  const std::vector<std::uint64_t>& lastPlan() const { return last_plan_; }

 private:
  std::vector<StoreGeometry> geometry_;
  BlockCache& cache_;
  std::vector<std::uint64_t> last_plan_;
};

/// The colour of each target: its operations' results, added in their order in the batch. The same bits whatever the
/// order of execution, the number of threads and the size of the cache.
std::vector<std::array<double, 3>> sumResults(const ShadingBatch& batch);

}  // namespace srf
