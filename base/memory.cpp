#include "base/memory.h"

#include <malloc.h>
#include <unistd.h>

#include <algorithm>
#include <cstdio>

namespace srf {

namespace {

struct Held {
  std::size_t resident = 0, shared = 0;  // bytes
};
Held held() {
  Held pages;
  if (FILE* file = std::fopen("/proc/self/statm", "r")) {
    if (std::fscanf(file, "%*u %zu %zu", &pages.resident, &pages.shared) != 2) pages = {};
    std::fclose(file);
  }
  const auto page = static_cast<std::size_t>(::sysconf(_SC_PAGESIZE));
  return {pages.resident * page, pages.shared * page};
}

}  // namespace

std::size_t residentBytes() {
  return held().resident;
}

std::size_t ownBytes() {
  const Held now = held();
  return now.resident - std::min(now.resident, now.shared);
}

std::size_t memoryLeft(std::size_t budget) {
  ::malloc_trim(0);
  const std::size_t now = residentBytes();
  return std::max(budget / 8, budget > now ? budget - now : 0);
}

}  // namespace srf
