// What the program holds of the machine's memory.
#pragma once

#include <cstddef>

namespace srf {

/// Bytes resident now; 0 where the system does not tell.
std::size_t residentBytes();

/// Gives what was freed back to the system, then tells how much of a budget for the whole process is left: an eighth of
/// it at least.
std::size_t memoryLeft(std::size_t budget);

}  // namespace srf
