#include "field/block_cache.h"

#include <pthread.h>

#include <algorithm>
#include <chrono>
#include <condition_variable>
#include <exception>
#include <list>
#include <map>
#include <mutex>
#include <thread>
#include <unordered_map>

#include "base/check.h"

namespace srf {
namespace {

using Clock = std::chrono::steady_clock;
double secondsSince(Clock::time_point start) {
  return std::chrono::duration<double>(Clock::now() - start).count();
}

// Neighbours in a file are read as one: up to so many bytes, across gaps that cost less than another request would.
constexpr std::size_t kRequestBytes = std::size_t{128} << 10;
constexpr std::size_t kGapBytes = std::size_t{16} << 10;
// Readers only wait for the disk. The system's default of 8 MiB would count against a limit on the program's data.
constexpr std::size_t kReaderStack = std::size_t{256} << 10;

}  // namespace

struct BlockCache::State {
  struct Entry {
    std::shared_ptr<ReflectanceBlock> block;  ///< empty while a thread reads it
    int pins = 0;
    std::size_t bytes = 0;
    bool wanted = false;                         ///< where it waits while nobody pins it: in `wanted` or in `unpinned`
    std::uint32_t position = 0;                  ///< in `wanted`
    std::list<std::uint64_t>::iterator place{};  ///< in `unpinned`
  };
  /// A request: one part of a file with the bytes of one or more tiles.
  struct Request {
    const ReflectanceStore* store = nullptr;
    ReflectanceStore::Place place;
    ReadBuffer buffer;
    std::span<const std::byte> bytes;  ///< once done
    bool done = false;
    std::exception_ptr failure;
    int tiles = 0;  ///< whose bytes nobody has taken yet
  };
  /// Of the plan.
  struct Use {
    std::uint32_t position, times;
  };

  std::vector<const ReflectanceStore*> stores;
  std::size_t budget = 0, used = 0;
  ReadAhead ahead;
  std::mutex mutex;
  std::condition_variable changed;  ///< a block or room for one
  std::condition_variable to_read;  ///< for the readers
  std::unordered_map<std::uint64_t, Entry> entries;
  std::list<std::uint64_t> unpinned;              ///< least recently used first; none of them in the plan
  std::map<std::uint32_t, std::uint64_t> wanted;  ///< unpinned ones that the plan wants, by position there
  std::shared_ptr<ReflectanceBlock> dropped;      ///< let go for the block that is read next, which takes its memory
  std::unordered_map<std::thread::id, int> held;
  std::vector<std::vector<bool>> read_before;
  CacheStatistics statistics;

  std::vector<std::uint64_t> planned;
  std::size_t next = 0;  ///< first of `planned` that no reader has looked at
  std::unordered_map<std::uint64_t, Use> uses;
  std::unordered_map<std::uint64_t, std::shared_ptr<Request>> requested;  ///< by tile; until they are asked for
  std::vector<ReadBuffer> spare;
  std::size_t ahead_used = 0;
  bool stopping = false;
  std::vector<pthread_t> readers;

  // Where an entry that nobody pins waits.
  void rest(std::uint64_t key, Entry& entry) {
    const auto use = uses.find(key);
    entry.wanted = use != uses.end();
    if (entry.wanted) {
      entry.position = use->second.position;
      wanted.emplace(entry.position, key);
    } else {
      entry.place = unpinned.insert(unpinned.end(), key);
    }
  }
  void pin(Entry& entry) {
    if (entry.pins++ == 0 && entry.block) {
      if (entry.wanted)
        wanted.erase(entry.position);
      else
        unpinned.erase(entry.place);
    }
    ++held[std::this_thread::get_id()];
  }
  void unpin(std::uint64_t key, std::thread::id owner) {
    const std::lock_guard lock(mutex);
    Entry& entry = entries.at(key);
    if (--entry.pins == 0) rest(key, entry);
    if (--held[owner] == 0) held.erase(owner);
    changed.notify_all();
  }
  void drop(std::uint64_t key) {
    const auto it = entries.find(key);
    used -= it->second.bytes;
    if (it->second.block && it->second.block.use_count() == 1 && it->second.block->rank == 0)
      dropped = std::move(it->second.block);
    entries.erase(it);
  }
  /// Whether `bytes` may be added now, after everything that is not in use has been let go as far as needed. A thread
  /// that holds a block already never waits: the others might be waiting for that one.
  bool makeRoom(std::size_t bytes) {
    while (used + bytes > budget && !(unpinned.empty() && wanted.empty())) {
      if (!unpinned.empty()) {
        const std::uint64_t oldest = unpinned.front();
        unpinned.pop_front();
        drop(oldest);
      } else {
        const auto latest = std::prev(wanted.end());
        const std::uint64_t key = latest->second;
        wanted.erase(latest);
        drop(key);
      }
    }
    return used + bytes <= budget || entries.empty() || held.contains(std::this_thread::get_id());
  }

  // ---- reading ahead ----

  bool mustRead(std::uint64_t key) const {
    return uses.contains(key) && !entries.contains(key) && !requested.contains(key) &&
           stores[key >> 32]->hasTile(static_cast<std::uint32_t>(key));
  }
  ReflectanceStore::Place placeOf(std::uint64_t key) const {
    return stores[key >> 32]->place(static_cast<std::uint32_t>(key));
  }
  /// The next request of the plan; none where nothing is left to read or there is no room for it.
  std::shared_ptr<Request> nextRequest() {
    while (next < planned.size() && !mustRead(planned[next])) ++next;
    if (next == planned.size()) return nullptr;
    ReflectanceStore::Place place = placeOf(planned[next]);
    if (ahead_used > 0 && ahead_used + std::max<std::size_t>(place.bytes, kRequestBytes) > ahead.bytes) return nullptr;
    auto request = std::make_shared<Request>();
    request->store = stores[planned[next] >> 32];
    for (;;) {
      requested.emplace(planned[next], request);
      ++request->tiles;
      for (++next; next < planned.size() && !mustRead(planned[next]); ++next) {}
      if (next == planned.size() || stores[planned[next] >> 32] != request->store) break;
      const ReflectanceStore::Place more = placeOf(planned[next]);
      const std::uint64_t end = place.offset + place.bytes;
      if (more.offset < end || more.offset - end > kGapBytes || more.offset + more.bytes - place.offset > kRequestBytes)
        break;
      place.bytes = static_cast<std::uint32_t>(more.offset + more.bytes - place.offset);
    }
    request->place = place;
    if (!spare.empty()) {
      request->buffer = std::move(spare.back());
      spare.pop_back();
    }
    ahead_used += place.bytes;
    statistics.peak_ahead_bytes = std::max<std::uint64_t>(statistics.peak_ahead_bytes, ahead_used);
    ++statistics.requests;
    return request;
  }
  /// One tile of the request has been taken, or is wanted no more.
  void letGo(const std::shared_ptr<Request>& request) {
    if (--request->tiles == 0 && request->done) finish(*request);
  }
  void finish(Request& request) {
    ahead_used -= request.place.bytes;
    spare.push_back(std::move(request.buffer));
    to_read.notify_one();
  }
  void readAhead() {
    std::unique_lock lock(mutex);
    for (;;) {
      std::shared_ptr<Request> request;
      to_read.wait(lock, [&] { return stopping || (request = nextRequest()); });
      if (stopping) return;
      lock.unlock();
      try {
        request->bytes = request->store->read(request->place, request->buffer);
      } catch (...) {
        request->failure = std::current_exception();
      }
      lock.lock();
      request->done = true;
      if (request->tiles == 0) finish(*request);
      changed.notify_all();
    }
  }
  void startReaders() {
    pthread_attr_t attributes;
    pthread_attr_init(&attributes);
    pthread_attr_setstacksize(&attributes, kReaderStack);
    const auto body = [](void* state) -> void* {
      static_cast<State*>(state)->readAhead();
      return nullptr;
    };
    while (static_cast<int>(readers.size()) < ahead.requests) {
      pthread_t reader;
      if (pthread_create(&reader, &attributes, body, this) != 0) break;  // blocks are read when they are asked for
      readers.push_back(reader);
    }
    pthread_attr_destroy(&attributes);
  }
};

BlockCache::BlockCache(std::span<const ReflectanceStore* const> stores, std::size_t budget_bytes,
                       const ReadAhead& ahead)
    : state_(std::make_unique<State>()) {
  state_->stores.assign(stores.begin(), stores.end());
  state_->budget = budget_bytes;
  state_->ahead = ahead;
  for (const ReflectanceStore* store : stores)
    state_->read_before.emplace_back(store ? store->geometry().allTiles() : 0, false);
}

BlockCache::~BlockCache() {
  SRF_CHECK(!state_ || state_->held.empty());
  if (!state_) return;
  {
    const std::lock_guard lock(state_->mutex);
    state_->stopping = true;
  }
  state_->to_read.notify_all();
  for (const pthread_t reader : state_->readers) pthread_join(reader, nullptr);
}

void BlockCache::plan(std::span<const std::uint64_t> keys) {
  State& s = *state_;
  const std::lock_guard lock(s.mutex);
  s.planned.clear();
  s.uses.clear();
  s.next = 0;
  for (const std::uint64_t key : keys) {
    const auto [use, added] = s.uses.try_emplace(key, State::Use{static_cast<std::uint32_t>(s.planned.size()), 0});
    ++use->second.times;
    if (added) s.planned.push_back(key);
  }
  for (auto it = s.requested.begin(); it != s.requested.end();) {
    if (s.uses.contains(it->first)) {
      ++it;
      continue;
    }
    s.letGo(it->second);
    it = s.requested.erase(it);
  }
  for (const auto& [position, key] : s.wanted) {
    State::Entry& entry = s.entries.at(key);
    entry.wanted = false;
    entry.place = s.unpinned.insert(s.unpinned.end(), key);
  }
  s.wanted.clear();
  for (auto it = s.unpinned.begin(); it != s.unpinned.end();) {
    const std::uint64_t key = *it;
    if (!s.uses.contains(key)) {
      ++it;
      continue;
    }
    it = s.unpinned.erase(it);
    s.rest(key, s.entries.at(key));
  }
  if (s.ahead.requests == 0) return;
  if (s.readers.empty() &&
      std::any_of(s.planned.begin(), s.planned.end(), [&](std::uint64_t key) { return s.mustRead(key); }))
    s.startReaders();
  s.to_read.notify_all();
}

BlockCache::Handle BlockCache::get(ViewId view, std::uint32_t tile) {
  State& s = *state_;
  const ReflectanceStore& store = *s.stores[view.value];
  const std::size_t most_bytes = store.geometry().blockBytes();
  SRF_DCHECK(tile < store.geometry().allTiles());
  const std::uint64_t key = blockKey(view.value, tile);

  const auto handle = [&](State::Entry& entry) {
    Handle h;
    h.block_ = entry.block;
    h.pin_ =
        std::shared_ptr<void>(nullptr, [&s, key, owner = std::this_thread::get_id()](void*) { s.unpin(key, owner); });
    return h;
  };

  std::unique_lock lock(s.mutex);
  // While it is pinned it rests nowhere, so that its place in the plan may change.
  const auto use = [&] {
    const auto it = s.uses.find(key);
    if (it != s.uses.end() && --it->second.times == 0) s.uses.erase(it);
  };
  for (;;) {
    const auto it = s.entries.find(key);
    if (it != s.entries.end() && it->second.block) {
      ++s.statistics.hits;
      s.pin(it->second);
      use();
      return handle(it->second);
    }
    if (it == s.entries.end() && s.makeRoom(most_bytes)) break;
    s.changed.wait(lock);
  }

  // Room is taken before reading, so that the others count with it.
  const auto start = Clock::now();
  State::Entry& entry = s.entries[key];
  entry.bytes = most_bytes;
  s.pin(entry);
  use();
  s.used += entry.bytes;
  ++s.statistics.misses;
  s.statistics.reread += s.read_before[view.value][tile];
  s.read_before[view.value][tile] = true;
  s.statistics.peak_bytes = std::max<std::uint64_t>(s.statistics.peak_bytes, s.used);
  std::shared_ptr<ReflectanceBlock> block = std::move(s.dropped);
  std::shared_ptr<State::Request> request;
  if (const auto it = s.requested.find(key); it != s.requested.end()) {
    request = it->second;
    s.requested.erase(it);
    s.changed.wait(lock, [&] { return request->done; });
  } else if (store.hasTile(tile)) {
    ++s.statistics.requests;
  }
  lock.unlock();

  const ReflectanceStore::Place place = store.place(tile);
  double waited = secondsSince(start);
  try {
    if (!block) block = std::make_shared<ReflectanceBlock>();
    if (request) {
      if (request->failure) std::rethrow_exception(request->failure);
      store.decode(tile, request->bytes.subspan(place.offset - request->place.offset, place.bytes), *block);
    } else {
      thread_local ReadBuffer buffer;
      const auto bytes = place.bytes > 0 ? store.read(place, buffer) : std::span<const std::byte>();
      waited = secondsSince(start);
      store.decode(tile, bytes, *block);
    }
    if (block->rank > 0) block->halves.shrink_to_fit();  // it may have had another's memory
    lock.lock();
    s.statistics.bytes_read += place.bytes;
    s.statistics.seconds_waiting += waited;
    s.statistics.seconds_reading += secondsSince(start);
    entry.block = block;
    s.used -= entry.bytes;
    entry.bytes = std::min(block->bytes(), most_bytes);
    s.used += entry.bytes;
    if (request) s.letGo(request);
  } catch (...) {
    lock.lock();
    if (--s.held[std::this_thread::get_id()] == 0) s.held.erase(std::this_thread::get_id());
    s.drop(key);
    if (request) s.letGo(request);
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
