#include "field/block_cache.h"

#include <algorithm>
#include <chrono>
#include <condition_variable>
#include <list>
#include <mutex>
#include <thread>
#include <unordered_map>

#include "base/check.h"

namespace srf {

struct BlockCache::State {
  using Block = std::shared_ptr<const std::vector<std::uint16_t>>;
  struct Entry {
    Block block;  ///< empty while a thread reads it
    int pins = 0;
    std::size_t bytes = 0;
    std::list<std::uint64_t>::iterator place;  ///< in `unpinned`, where pins is 0
  };

  std::vector<const ReflectanceStore*> stores;
  std::size_t budget = 0, used = 0;
  std::mutex mutex;
  std::condition_variable changed;
  std::unordered_map<std::uint64_t, Entry> entries;
  std::list<std::uint64_t> unpinned;  ///< least recently used first
  std::unordered_map<std::thread::id, int> held;
  std::vector<std::vector<bool>> read_before;
  CacheStatistics statistics;

  void pin(Entry& entry) {
    if (entry.pins++ == 0 && entry.block) unpinned.erase(entry.place);
    ++held[std::this_thread::get_id()];
  }
  void unpin(std::uint64_t key, std::thread::id owner) {
    const std::lock_guard lock(mutex);
    Entry& entry = entries.at(key);
    if (--entry.pins == 0) entry.place = unpinned.insert(unpinned.end(), key);
    if (--held[owner] == 0) held.erase(owner);
    changed.notify_all();
  }
  void drop(std::uint64_t key) {
    const auto it = entries.find(key);
    used -= it->second.bytes;
    entries.erase(it);
  }
  /// Whether `bytes` may be added now, after everything that is not in use has been let go as far as needed. A thread
  /// that holds a block already never waits: the others might be waiting for that one.
  bool makeRoom(std::size_t bytes) {
    while (used + bytes > budget && !unpinned.empty()) {
      const std::uint64_t oldest = unpinned.front();
      unpinned.pop_front();
      drop(oldest);
    }
    return used + bytes <= budget || entries.empty() || held.contains(std::this_thread::get_id());
  }
};

BlockCache::BlockCache(std::span<const ReflectanceStore* const> stores, std::size_t budget_bytes)
    : state_(std::make_unique<State>()) {
  state_->stores.assign(stores.begin(), stores.end());
  state_->budget = budget_bytes;
  for (const ReflectanceStore* store : stores)
    state_->read_before.emplace_back(store ? store->geometry().tileCount() : 0, false);
}

BlockCache::~BlockCache() {
  SRF_CHECK(!state_ || state_->held.empty());
}

std::span<const std::uint16_t> BlockCache::Handle::halves() const {
  return block_ ? std::span<const std::uint16_t>(*block_) : std::span<const std::uint16_t>();
}

BlockCache::Handle BlockCache::get(ViewId view, int tile_x, int tile_y) {
  State& s = *state_;
  const ReflectanceStore& store = *s.stores[view.value];
  const StoreGeometry& g = store.geometry();
  SRF_DCHECK(tile_x >= 0 && tile_x < g.tiles_x && tile_y >= 0 && tile_y < g.tiles_y);
  const std::uint32_t tile = static_cast<std::uint32_t>(tile_y) * g.tiles_x + tile_x;
  const std::uint64_t key = static_cast<std::uint64_t>(view.value) << 32 | tile;

  const auto handle = [&](State::Entry& entry) {
    Handle h;
    h.block_ = entry.block;
    h.pin_ =
        std::shared_ptr<void>(nullptr, [&s, key, owner = std::this_thread::get_id()](void*) { s.unpin(key, owner); });
    return h;
  };

  std::unique_lock lock(s.mutex);
  for (;;) {
    const auto it = s.entries.find(key);
    if (it != s.entries.end() && it->second.block) {
      ++s.statistics.hits;
      s.pin(it->second);
      return handle(it->second);
    }
    if (it == s.entries.end() && s.makeRoom(g.blockBytes())) break;
    s.changed.wait(lock);
  }

  // Room is taken before reading, so that the others count with it.
  State::Entry& entry = s.entries[key];
  entry.bytes = g.blockBytes();
  s.pin(entry);
  s.used += entry.bytes;
  ++s.statistics.misses;
  s.statistics.reread += s.read_before[view.value][tile];
  s.read_before[view.value][tile] = true;
  s.statistics.peak_bytes = std::max<std::uint64_t>(s.statistics.peak_bytes, s.used);
  lock.unlock();

  const auto start = std::chrono::steady_clock::now();
  try {
    const auto block = std::make_shared<std::vector<std::uint16_t>>(g.blockHalves());
    const std::size_t bytes = store.readTile(tile_x, tile_y, *block);
    const double seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
    lock.lock();
    s.statistics.bytes_read += bytes;
    s.statistics.seconds_reading += seconds;
    entry.block = block;
  } catch (...) {
    lock.lock();
    if (--s.held[std::this_thread::get_id()] == 0) s.held.erase(std::this_thread::get_id());
    s.drop(key);
    s.changed.notify_all();
    throw;
  }
  s.changed.notify_all();
  return handle(entry);
}

CacheStatistics BlockCache::statistics() const {
  const std::lock_guard lock(state_->mutex);
  return state_->statistics;
}

}  // namespace srf
