// What the program holds of the machine's memory.
#pragma once

#include <cstddef>

namespace srf {

/// Bytes resident now; 0 where the system does not tell.
std::size_t residentBytes();

}  // namespace srf
