// Promises of the code to itself. A failed check is a bug: it prints the expression and ends the program.
#pragma once

#include <cstdio>
#include <cstdlib>

#define SRF_CHECK(condition)                                                               \
  do {                                                                                     \
    if (!(condition)) {                                                                    \
      std::fprintf(stderr, "%s:%d: broken promise: %s\n", __FILE__, __LINE__, #condition); \
      std::abort();                                                                        \
    }                                                                                      \
  } while (false)

#ifdef NDEBUG
#define SRF_DCHECK(condition) \
  do {                        \
  } while (false)
#else
#define SRF_DCHECK(condition) SRF_CHECK(condition)
#endif
