// A small cache of decoded blocks with a budget in bytes (claim 19). A handle pins its block: eviction cannot free what
// is in use. What is in the cache never changes a result, only the time.
//
// Who knows the order in which blocks will be wanted says so (plan): then several threads read them ahead, many
// requests at a time and neighbours in a file as one, while the threads that ask for blocks decode and use those that
// have come. Of what must go, blocks that the plan still wants go last, those wanted latest first.
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
  std::uint64_t bytes_read = 0;                    ///< from the files, of blocks that were asked for
  std::uint64_t requests = 0;                      ///< that the files were asked for
  std::uint64_t peak_bytes = 0;                    ///< most decoded bytes held at once
  std::uint64_t peak_ahead_bytes = 0;              ///< most bytes held that were read ahead, or being read
  double seconds_reading = 0;  ///< from asking for a block to having it decoded; summed over threads
  double seconds_waiting = 0;  ///< of these until its bytes had come
};

/// A tile of a view's store; keys rise by view, then tile.
constexpr std::uint64_t blockKey(std::uint32_t view, std::uint32_t tile) {
  return static_cast<std::uint64_t>(view) << 32 | tile;
}

class BlockCache {
 public:
  struct ReadAhead {
    std::size_t bytes = std::size_t{4} << 20;  ///< read before they are asked for; at least one request's
    int requests = 16;                         ///< at a time; 0: every block is read when it is asked for
  };
  /// `stores[i]` is the store of ViewId{i}; they must outlive the cache. At least one block is always allowed: a
  /// budget below one block a thread makes threads wait for each other, never fail.
  BlockCache(std::span<const ReflectanceStore* const> stores, std::size_t budget_bytes, const ReadAhead& ahead);
  BlockCache(std::span<const ReflectanceStore* const> stores, std::size_t budget_bytes)
      : BlockCache(stores, budget_bytes, ReadAhead{}) {}
  ~BlockCache();

  class Handle {
   public:
    Handle() = default;
    const ReflectanceBlock& block() const { return *block_; }

   private:
    friend class BlockCache;
    std::shared_ptr<void> pin_;
    std::shared_ptr<const ReflectanceBlock> block_;  // goes first: a block that nobody pins is nobody else's
  };
  /// Says which blocks will be asked for next, as keys in that order; a key that is named n times will be asked for n
  /// times. What an earlier plan had read ahead stays where this one wants it too.
  void plan(std::span<const std::uint64_t> keys);
  /// The decoded block; read at most once while it stays. Thread-safe. A thread may hold one handle at a time.
  Handle get(ViewId view, std::uint32_t tile);
  CacheStatistics statistics() const;

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace srf
