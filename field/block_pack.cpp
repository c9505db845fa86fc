#include <algorithm>
#include <array>
#include <bit>
#include <cstring>

#include "field/reflectance_block.h"

#if defined(__AVX2__)
#include <immintrin.h>
#define SRF_WIDE_UNPACK
#endif

// The differences that block_shuffle.cpp has, kept in as few bits as the 16 of a row of texels need under one light:
// noise leaves nothing in them that a model of their bytes would find, and vector code takes them out several times
// faster than a disk gives them. Why so is in doc/field_format.md.
namespace srf {
namespace {

constexpr int kNumbers = kTile;         // differences that share a width
constexpr std::size_t kBehind = 16;     // zero bytes at the end, so that wide reads stay inside
constexpr int kWhole = 8;               // bits of a number that stand apart where it has more
constexpr std::size_t kLow = kNumbers;  // bytes of these

/// 15 bits are kept as 16, so that half a byte tells every width.
constexpr int widthOf(unsigned code) {
  return code == 15 ? 16 : static_cast<int>(code);
}

std::size_t codeBytes(const StoreGeometry& g) {
  return kTile * g.texelHalves() / 2;
}

// The lowest `width` <= 8 bits of each number, one after the other; numbers lie kLightGroup apart.
std::byte* put(std::byte* to, const std::int16_t* numbers, int width) {
  const std::uint64_t mask = (1u << width) - 1;
  for (int half = 0; half < kNumbers; half += 8, to += width) {
    std::uint64_t bits = 0;
    for (int i = 0; i < 8; ++i)
      bits |= (static_cast<std::uint64_t>(numbers[(half + i) * kLightGroup]) & mask) << (i * width);
    std::memcpy(to, &bits, static_cast<std::size_t>(width));
  }
  return to;
}

/// Whether the widths account for the bytes, all of them.
bool fits(const StoreGeometry& g, std::span<const std::byte> stored) {
  const std::size_t codes = codeBytes(g);
  if (stored.size() < codes + kBehind) return false;
  std::size_t bits = 0;
  for (std::size_t row = 0; row < codes; row += codes / kTile) {
    unsigned sum = 0;
    for (std::size_t i = row; i < row + codes / kTile; ++i) {
      const auto two = static_cast<unsigned>(stored[i]);
      sum += (two & 15) + ((two & 15) == 15) + (two >> 4) + (two >> 4 == 15);
    }
    bits += sum;
  }
  return stored.size() == codes + 2 * bits + kBehind;
}

}  // namespace

void packBlock(const StoreGeometry& g, const std::uint16_t* block, std::vector<std::byte>& out) {
  const std::size_t texel = g.texelHalves(), row = kTile * texel;
  out.assign(codeBytes(g) + g.blockBytes() + kBehind, std::byte{0});
  std::byte *code = out.data(), *to = code + codeBytes(g);
  std::int16_t numbers[kNumbers * kLightGroup];  // [texel][light]
  for (int y = 0; y < kTile; ++y)
    for (std::size_t first = 0; first < texel; first += kLightGroup) {
      std::uint16_t any[kLightGroup] = {}, magnitude[kLightGroup] = {};
      for (int x = 0; x < kNumbers; ++x) {
        const std::uint16_t* const at = block + y * row + x * texel + first;
        const std::uint16_t* const before = y > 0 ? at - row : x > 0 ? at - texel : nullptr;
        std::int16_t* const of_texel = numbers + x * kLightGroup;
        for (int k = 0; k < kLightGroup; ++k) {
          const auto number = static_cast<std::int16_t>(at[k] - (before ? before[k] : 0));
          of_texel[k] = number;
          any[k] |= static_cast<std::uint16_t>(number);
          magnitude[k] |= static_cast<std::uint16_t>(number ^ (number >> 15));
        }
      }
      for (int k = 0; k < kLightGroup; ++k) {
        if (!any[k]) continue;
        const unsigned of_numbers = std::min(15u, 1u + static_cast<unsigned>(std::bit_width(magnitude[k])));
        code[(y * texel + first + k) / 2] |= static_cast<std::byte>(of_numbers << (k % 2 * 4));
        int width = widthOf(of_numbers);
        if (width > kWhole) {
          to = put(to, numbers + k, kWhole);
          for (int x = 0; x < kNumbers; ++x) numbers[x * kLightGroup + k] >>= kWhole;
          width -= kWhole;
        }
        to = put(to, numbers + k, width);
      }
    }
  out.resize(static_cast<std::size_t>(to - out.data()) + kBehind);
}

bool unpackBlockPlain(const StoreGeometry& g, std::span<const std::byte> stored, std::uint16_t* block) {
  if (!fits(g, stored)) return false;
  const std::size_t texel = g.texelHalves(), row = kTile * texel;
  const std::byte *code = stored.data(), *from = code + codeBytes(g);
  for (int y = 0; y < kTile; ++y)
    for (std::size_t i = 0; i < texel; ++i) {
      const int width = widthOf(static_cast<unsigned>(code[(y * texel + i) / 2]) >> (i % 2 * 4) & 15);
      const std::byte* const low = from;
      const int packed = width > kWhole ? width - kWhole : width;
      if (width > kWhole) from += kLow;
      for (int x = 0; x < kNumbers; ++x) {
        unsigned number = 0;
        for (int b = 0; b < packed; ++b) {
          const int bit = x * packed + b;
          number |= (static_cast<unsigned>(from[bit / 8]) >> (bit % 8) & 1) << b;
        }
        if (packed > 0 && (number >> (packed - 1) & 1)) number |= ~0u << packed;
        if (width > kWhole) number = number << kWhole | static_cast<unsigned>(low[x]);
        std::uint16_t* const at = block + y * row + x * texel + i;
        const unsigned before = y > 0 ? *(at - row) : x > 0 ? *(at - texel) : 0;
        *at = static_cast<std::uint16_t>(before + number);
      }
      from += 2 * packed;
    }
  return true;
}

#ifdef SRF_WIDE_UNPACK

namespace {

/// How 8 numbers of one width come out of a vector: the two bytes that hold each, moved up to the top of its lane by a
/// product, then down with its sign.
struct Taking {
  alignas(16) std::uint8_t bytes[16];
  alignas(16) std::uint16_t factor[8];
  alignas(16) std::uint64_t down[2], up[2];  ///< shifts
  alignas(16) std::uint16_t low[8];          ///< mask of the bytes that stand apart
  std::uint32_t packed, skipped;             ///< bytes of 8 numbers; of those that stand apart
};
constexpr std::array<Taking, 16> kTakings = [] {
  std::array<Taking, 16> all{};
  for (unsigned code = 0; code < 16; ++code) {
    Taking& t = all[code];
    const int width = widthOf(code);
    const int packed = width > kWhole ? width - kWhole : width;
    for (int i = 0; i < 8; ++i) {
      const int bit = i * packed;
      t.bytes[2 * i] = static_cast<std::uint8_t>(bit / 8);
      t.bytes[2 * i + 1] = static_cast<std::uint8_t>(bit / 8 + 1);
      t.factor[i] = static_cast<std::uint16_t>(packed > 0 ? 1u << (16 - packed - bit % 8) : 0);
      t.low[i] = width > kWhole ? 0xffff : 0;
    }
    t.down[0] = static_cast<std::uint64_t>(16 - packed);
    t.up[0] = width > kWhole ? kWhole : 0;
    t.packed = static_cast<std::uint32_t>(packed);
    t.skipped = width > kWhole ? kLow : 0;
  }
  return all;
}();

// 16 numbers: of texels 0 to 7 in the lower half.
inline __m256i take(const std::byte*& from, unsigned code) {
  const Taking& t = kTakings[code];
  const auto load = [](const void* at) { return _mm_loadu_si128(static_cast<const __m128i*>(at)); };
  const __m256i low = _mm256_and_si256(_mm256_cvtepu8_epi16(load(from)), _mm256_broadcastsi128_si256(load(t.low)));
  from += t.skipped;
  __m256i v = _mm256_inserti128_si256(_mm256_castsi128_si256(load(from)), load(from + t.packed), 1);
  from += 2 * t.packed;
  v = _mm256_shuffle_epi8(v, _mm256_broadcastsi128_si256(load(t.bytes)));
  v = _mm256_mullo_epi16(v, _mm256_broadcastsi128_si256(load(t.factor)));
  v = _mm256_sll_epi16(_mm256_sra_epi16(v, load(t.down)), load(t.up));
  return _mm256_or_si256(v, low);
}

// Rows of 8 x 8 numbers in each half become columns.
inline void turn(__m256i* v) {
  __m256i a[8], b[8];
  for (int i = 0; i < 4; ++i) {
    a[2 * i] = _mm256_unpacklo_epi16(v[2 * i], v[2 * i + 1]);
    a[2 * i + 1] = _mm256_unpackhi_epi16(v[2 * i], v[2 * i + 1]);
  }
  for (int i = 0; i < 2; ++i)
    for (int k = 0; k < 2; ++k) {
      b[4 * i + 2 * k] = _mm256_unpacklo_epi32(a[4 * i + k], a[4 * i + k + 2]);
      b[4 * i + 2 * k + 1] = _mm256_unpackhi_epi32(a[4 * i + k], a[4 * i + k + 2]);
    }
  for (int i = 0; i < 4; ++i) {
    v[2 * i] = _mm256_unpacklo_epi64(b[i], b[i + 4]);
    v[2 * i + 1] = _mm256_unpackhi_epi64(b[i], b[i + 4]);
  }
}

}  // namespace

bool unpackBlock(const StoreGeometry& g, std::span<const std::byte> stored, std::uint16_t* block) {
  if (!fits(g, stored)) return false;
  const std::size_t texel = g.texelHalves(), row = kTile * texel;
  const std::byte *code = stored.data(), *from = code + codeBytes(g);
  static_assert(kLightGroup == 16 && kNumbers == 16);
  for (int y = 0; y < kTile; ++y)
    for (std::size_t i = 0; i < texel; i += kLightGroup, code += 8) {
      std::uint64_t codes = 0;
      std::memcpy(&codes, code, sizeof codes);
      __m256i v[16];
      for (int k = 0; k < 16; ++k, codes >>= 4) v[k] = take(from, codes & 15);
      turn(v);
      turn(v + 8);
      for (int x = 0; x < 8; ++x) {  // the lights of texels x and x + 8 together
        const __m256i first = v[x], last = v[x + 8];
        v[x] = _mm256_permute2x128_si256(first, last, 0x20);
        v[x + 8] = _mm256_permute2x128_si256(first, last, 0x31);
      }
      std::uint16_t* const to = block + y * row + i;
      const auto at = [&](std::uint16_t* halves) { return reinterpret_cast<__m256i*>(halves); };
      if (y > 0) {
        for (int x = 0; x < kTile; ++x) {
          const __m256i above = _mm256_loadu_si256(at(to + x * texel - row));
          _mm256_storeu_si256(at(to + x * texel), _mm256_add_epi16(above, v[x]));
        }
      } else {
        __m256i sum = _mm256_setzero_si256();
        for (int x = 0; x < kTile; ++x) {
          sum = _mm256_add_epi16(sum, v[x]);
          _mm256_storeu_si256(at(to + x * texel), sum);
        }
      }
    }
  return true;
}

#else

bool unpackBlock(const StoreGeometry& g, std::span<const std::byte> stored, std::uint16_t* block) {
  return unpackBlockPlain(g, stored, block);
}

#endif

}  // namespace srf
