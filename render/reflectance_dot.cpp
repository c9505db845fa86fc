#include "render/reflectance_dot.h"

#include <algorithm>

#include "base/image_io.h"
#include "field/reflectance_store.h"

#if defined(__AVX2__) && defined(__F16C__) && defined(__FMA__)
#include <immintrin.h>
#define SRF_WIDE_DOT
#endif

namespace srf {
namespace {

/// The four texels. One beyond the tile has weight 0 and is read from inside it instead.
std::array<const std::uint16_t*, 4> taps(const std::uint16_t* block, int light_pad, const ShadingOperation& o) {
  const int x1 = std::min(o.x + 1, kTile - 1), y1 = std::min(o.y + 1, kTile - 1);
  const auto texel = [&](int x, int y) { return block + static_cast<std::size_t>(y * kTile + x) * 3 * light_pad; };
  return {texel(o.x, o.y), texel(x1, o.y), texel(o.x, y1), texel(x1, y1)};
}

}  // namespace

std::array<double, 3> reflectanceDotReference(const std::uint16_t* block, int light_pad, const ShadingOperation& o,
                                              const float* weights) {
  const auto texel = taps(block, light_pad, o);
  std::array<double, 3> sum{};
  for (int c = 0; c < 3; ++c)
    for (int j = 0; j < light_pad; ++j)
      for (int t = 0; t < 4; ++t)
        sum[c] +=
            static_cast<double>(o.tap[t]) * floatFromHalf(texel[t][c * light_pad + j]) * weights[c * light_pad + j];
  return sum;
}

#ifdef SRF_WIDE_DOT

Rgb reflectanceDot(const std::uint16_t* block, int light_pad, const ShadingOperation& o, const float* weights) {
  const auto texel = taps(block, light_pad, o);
  const __m256 w0 = _mm256_set1_ps(o.tap[0]), w1 = _mm256_set1_ps(o.tap[1]);
  const __m256 w2 = _mm256_set1_ps(o.tap[2]), w3 = _mm256_set1_ps(o.tap[3]);
  const auto eight = [](const std::uint16_t* halves) {
    return _mm256_cvtph_ps(_mm_loadu_si128(reinterpret_cast<const __m128i*>(halves)));
  };
  // Interpolates 8 lights over the taps (4 roundings), then multiplies and adds (1).
  const auto product = [&](int i, __m256 sum) {
    __m256 s = _mm256_mul_ps(w0, eight(texel[0] + i));
    s = _mm256_fmadd_ps(w1, eight(texel[1] + i), s);
    s = _mm256_fmadd_ps(w2, eight(texel[2] + i), s);
    s = _mm256_fmadd_ps(w3, eight(texel[3] + i), s);
    return _mm256_fmadd_ps(s, _mm256_loadu_ps(weights + i), sum);
  };
  Rgb result;
  for (int c = 0; c < 3; ++c) {
    __m256 even = _mm256_setzero_ps(), odd = _mm256_setzero_ps();
    const int end = (c + 1) * light_pad;
    int i = c * light_pad;
    for (; i + 16 <= end; i += 16) {
      even = product(i, even);
      odd = product(i + 8, odd);
    }
    if (i < end) even = product(i, even);
    const __m256 both = _mm256_add_ps(even, odd);
    __m128 four = _mm_add_ps(_mm256_castps256_ps128(both), _mm256_extractf128_ps(both, 1));
    four = _mm_add_ps(four, _mm_movehl_ps(four, four));
    result[c] = _mm_cvtss_f32(_mm_add_ss(four, _mm_shuffle_ps(four, four, 1)));
  }
  return result;
}

#else

Rgb reflectanceDot(const std::uint16_t* block, int light_pad, const ShadingOperation& operation, const float* weights) {
  const auto sum = reflectanceDotReference(block, light_pad, operation, weights);
  return {static_cast<float>(sum[0]), static_cast<float>(sum[1]), static_cast<float>(sum[2])};
}

#endif

void addBlend(float* sum, const std::array<float, 4>& share, const std::array<const float*, 4>& vector, int count) {
  for (int i = 0; i < count; ++i)
    sum[i] = (((sum[i] + share[0] * vector[0][i]) + share[1] * vector[1][i]) + share[2] * vector[2][i]) +
             share[3] * vector[3][i];
}

}  // namespace srf
