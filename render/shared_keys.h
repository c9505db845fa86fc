// Names of vectors that hits share, each with a number: a table without nodes (open addressing), for most names that
// are asked for are known.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <vector>

namespace srf {

/// Names a vector that many hits share: the distant lights seen through one orientation of L by one list of lights.
struct SharedKey {
  std::uint32_t list = 0;
  std::uint64_t corner = 0;
  friend bool operator==(const SharedKey&, const SharedKey&) = default;
};
struct SharedKeyHash {
  std::size_t operator()(const SharedKey& key) const {
    return (key.corner * 0x9e3779b97f4a7c15u ^ key.list) * 0xff51afd7ed558ccdu;
  }
};

/// Keys are numbered in the order in which they come.
class SharedKeys {
 public:
  std::uint32_t numberOf(const SharedKey& key) {
    if (2 * keys_.size() >= places_.size()) grow();
    std::uint32_t& number = place(key);
    if (number == kNone) {
      number = static_cast<std::uint32_t>(keys_.size());
      keys_.push_back(key);
    }
    return number;
  }
  const SharedKey& operator[](std::size_t number) const { return keys_[number]; }
  std::size_t size() const { return keys_.size(); }
  std::size_t bytes() const {
    return keys_.capacity() * sizeof(SharedKey) + places_.capacity() * sizeof(std::uint32_t);
  }
  /// Forgets all; its memory stays.
  void clear() {
    keys_.clear();
    std::fill(places_.begin(), places_.end(), kNone);
  }

 private:
  static constexpr std::uint32_t kNone = 0xffffffffu;

  /// Where the key's number stands, or would.
  std::uint32_t& place(const SharedKey& key) {
    const std::size_t last = places_.size() - 1;
    std::size_t at = SharedKeyHash()(key) >> 32 & last;
    while (places_[at] != kNone && keys_[places_[at]] != key) at = (at + 1) & last;
    return places_[at];
  }
  void grow() {
    places_.assign(std::max<std::size_t>(64, 2 * places_.size()), kNone);
    for (std::size_t i = 0; i < keys_.size(); ++i) place(keys_[i]) = static_cast<std::uint32_t>(i);
  }

  std::vector<SharedKey> keys_;
  std::vector<std::uint32_t> places_;  ///< a power of two of them, at most half in use
};

}  // namespace srf
