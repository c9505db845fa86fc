// Rows of half floats to and from floats; the wide form where the processor has it, with the same bits as the plain
// one.
#pragma once

#include <cstdint>

#include "base/image_io.h"

#if defined(__AVX2__) && defined(__F16C__)
#include <immintrin.h>
#endif

namespace srf {

/// `count` is a multiple of 8.
inline void floatsFromHalves(const std::uint16_t* halves, float* floats, int count) {
#if defined(__AVX2__) && defined(__F16C__)
  for (int i = 0; i < count; i += 8)
    _mm256_storeu_ps(floats + i, _mm256_cvtph_ps(_mm_loadu_si128(reinterpret_cast<const __m128i*>(halves + i))));
#else
  for (int i = 0; i < count; ++i) floats[i] = floatFromHalf(halves[i]);
#endif
}

/// Round to nearest even; values are within the range of halves. `count` is a multiple of 8.
inline void halvesFromFloats(const float* floats, std::uint16_t* halves, int count) {
#if defined(__AVX2__) && defined(__F16C__)
  for (int i = 0; i < count; i += 8)
    _mm_storeu_si128(reinterpret_cast<__m128i*>(halves + i),
                     _mm256_cvtps_ph(_mm256_loadu_ps(floats + i), _MM_FROUND_TO_NEAREST_INT));
#else
  for (int i = 0; i < count; ++i) halves[i] = halfFromFloat(floats[i]);
#endif
}

}  // namespace srf
