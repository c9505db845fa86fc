// Threads. TBB is the one scheduler (Embree uses it too). Nothing here may change a result: work is split by index, and
// sums are taken in index order by the caller.
#pragma once

#include <cstddef>
#include <functional>

namespace srf {

/// Upper bound on the threads of the program from construction on; 0 means all cores.
void setThreadCount(int threads);
int threadCount();

/// Calls body(begin, end) over disjoint sub-ranges that cover [0, count), each at most `grain` long, in any order and
/// from several threads. Exceptions of the body reach the caller. Ranges begin at multiples of `grain`.
void parallelFor(std::size_t count, std::size_t grain, const std::function<void(std::size_t, std::size_t)>& body);

}  // namespace srf
