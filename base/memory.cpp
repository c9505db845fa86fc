#include "base/memory.h"

#include <malloc.h>
#include <unistd.h>

#include <algorithm>
#include <cstdio>

namespace srf {

std::size_t residentBytes() {
  std::size_t pages = 0;
  if (FILE* file = std::fopen("/proc/self/statm", "r")) {
    if (std::fscanf(file, "%*u %zu", &pages) != 1) pages = 0;
    std::fclose(file);
  }
  return pages * static_cast<std::size_t>(::sysconf(_SC_PAGESIZE));
}

std::size_t memoryLeft(std::size_t budget) {
  ::malloc_trim(0);
  const std::size_t held = residentBytes();
  return std::max(budget / 8, budget > held ? budget - held : 0);
}

}  // namespace srf
