// A small cache of decoded blocks with a budget in bytes (claim 19). A handle pins its block: eviction cannot free what
// is in use. What is in the cache never changes a result, only the time.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "field/capture.h"
#include "field/reflectance_store.h"

namespace srf {

struct CacheStatistics {
  std::uint64_t hits = 0, misses = 0, reread = 0;  ///< reread: misses of blocks that had been read before
  std::uint64_t bytes_read = 0;                    ///< from the files
  std::uint64_t peak_bytes = 0;                    ///< most decoded bytes held at once
  double seconds_reading = 0;                      ///< summed over threads
};

class BlockCache {
 public:
  /// `stores[i]` is the store of ViewId{i}; they must outlive the cache. At least one block is always allowed: a
  /// budget below one block a thread makes threads wait for each other, never fail.
  BlockCache(std::span<const ReflectanceStore* const> stores, std::size_t budget_bytes);
  ~BlockCache();

  class Handle {
   public:
    Handle() = default;
    std::span<const std::uint16_t> halves() const;

   private:
    friend class BlockCache;
    std::shared_ptr<const std::vector<std::uint16_t>> block_;
    std::shared_ptr<void> pin_;
  };
  /// The decoded block; read at most once while it stays. Thread-safe. A thread may hold one handle at a time.
  Handle get(ViewId view, int tile_x, int tile_y);
  CacheStatistics statistics() const;

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace srf
