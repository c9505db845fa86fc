// Vectors whose new elements hold nothing in particular until they are written.
#pragma once

#include <memory>
#include <utility>
#include <vector>

namespace srf {

/// As std::allocator, but resize() leaves numbers unwritten: for what is filled at once and too large to fill twice.
template <class T>
struct UninitialisedAllocator : std::allocator<T> {
  template <class U>
  struct rebind {
    using other = UninitialisedAllocator<U>;
  };
  template <class U>
  void construct(U* at) {
    ::new (static_cast<void*>(at)) U;
  }
  template <class U, class... Arguments>
  void construct(U* at, Arguments&&... arguments) {
    ::new (static_cast<void*>(at)) U(std::forward<Arguments>(arguments)...);
  }
};
template <class T>
using UninitialisedVector = std::vector<T, UninitialisedAllocator<T>>;

}  // namespace srf
