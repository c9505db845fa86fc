// What the program holds of the machine's memory.
#pragma once

#include <cstddef>

namespace srf {

/// Bytes resident now; 0 where the system does not tell.
std::size_t residentBytes();
/// Those of them that are no file's pages (the program and its libraries are).
std::size_t ownBytes();

/// Gives what was freed back to the system, then tells how much of a budget for the whole process is left: an eighth of
/// it at least.
std::size_t memoryLeft(std::size_t budget);

}  // namespace srf
