// The lossless coding of blocks on drawn input: every bit comes back, the wide reader is the plain one, and bytes that
// are no block are refused without reading beyond them (rapidcheck).
#include <gtest/gtest.h>
#include <rapidcheck.h>
#include <rapidcheck/gtest.h>

#include <algorithm>
#include <memory>
#include <optional>
#include <random>

#include "field/reflectance_block.h"

namespace srf {
namespace {

/// Lights of very different contrast side by side: differences of every width, rows without any.
std::vector<std::uint16_t> drawBlock(const StoreGeometry& g) {
  std::mt19937 random(*rc::gen::arbitrary<unsigned>());
  const unsigned most_bits = static_cast<unsigned>(*rc::gen::inRange(0, 17));
  const bool dark_rows = *rc::gen::arbitrary<bool>();
  std::vector<std::uint16_t> block(g.blockHalves(), 0);
  for (std::size_t i = 0; i < block.size(); ++i) {
    const std::size_t light = i % g.lightPad(), row = i / (kTile * g.texelHalves());
    if (light >= static_cast<std::size_t>(g.light_count) || (dark_rows && row % 3 == 1)) continue;
    const unsigned bits = most_bits > 0 ? static_cast<unsigned>(light * 7 % (most_bits + 1)) : 0;
    block[i] = static_cast<std::uint16_t>(random() & ((1u << bits) - 1));
  }
  return block;
}

StoreGeometry drawGeometry() {
  StoreGeometry g{16, 16, 0, 0, 1, 1, 1};
  g.light_count = *rc::gen::inRange(1, 50);
  return g;
}

// Bytes in memory of exactly their size, so that the address sanitizer sees a step beyond them.
std::optional<std::vector<std::uint16_t>> unpacked(const StoreGeometry& g, const std::vector<std::byte>& bytes,
                                                   bool plain) {
  const auto exact = std::make_unique<std::byte[]>(bytes.size());
  std::copy(bytes.begin(), bytes.end(), exact.get());
  std::vector<std::uint16_t> block(g.blockHalves(), 0xffff);
  const bool whole = (plain ? unpackBlockPlain : unpackBlock)(g, {exact.get(), bytes.size()}, block.data());
  return whole ? std::optional(block) : std::nullopt;
}

RC_GTEST_PROP(PackedBlock, KeepsEveryBit, ()) {
  const StoreGeometry g = drawGeometry();
  const auto block = drawBlock(g);
  std::vector<std::byte> bytes;
  packBlock(g, block.data(), bytes);
  RC_ASSERT(unpacked(g, bytes, false) == block);
  RC_ASSERT(unpacked(g, bytes, true) == block);
}

RC_GTEST_PROP(PackedBlock, OfOtherBytesIsRefusedOrReadAlikeBothWays, ()) {
  const StoreGeometry g = drawGeometry();
  std::vector<std::byte> bytes;
  packBlock(g, drawBlock(g).data(), bytes);
  const auto size = static_cast<int>(bytes.size());
  for (int i = *rc::gen::inRange(0, 4); i > 0; --i)
    bytes[*rc::gen::inRange(0, size)] = static_cast<std::byte>(*rc::gen::inRange(0, 256));
  bytes.resize(*rc::gen::element(size, size - 1, size + 1, 16, 0, *rc::gen::inRange(0, 2 * size)));
  const auto wide = unpacked(g, bytes, false), plain = unpacked(g, bytes, true);
  RC_ASSERT(wide == plain);
}

RC_GTEST_PROP(PackedBlock, InABasisOfOtherBytesIsRefusedOrReadWithoutHarm, ()) {
  StoreGeometry g = drawGeometry();
  g.light_count = *rc::gen::inRange(17, 50);
  const int rank = *rc::gen::inRange(1, 17);
  std::vector<std::byte> bytes(4 + rank * (4 + 2 * static_cast<std::size_t>(g.light_count)), std::byte{0}), packed;
  bytes[0] = static_cast<std::byte>(rank);
  const StoreGeometry coefficients{16, 16, 0, 0, 1, 1, rank};
  packBlock(coefficients, drawBlock(coefficients).data(), packed);
  bytes.insert(bytes.end(), packed.begin(), packed.end());
  ReflectanceBlock block;
  RC_ASSERT(unpackCompressed(g, bytes, block));
  RC_ASSERT(block.rank == rank && block.lit.empty());
  const auto size = static_cast<int>(bytes.size());
  for (int i = *rc::gen::inRange(1, 4); i > 0; --i)
    bytes[*rc::gen::inRange(0, *rc::gen::element(8, size))] = static_cast<std::byte>(*rc::gen::inRange(0, 256));
  bytes.resize(*rc::gen::element(size, size - 1, 3, *rc::gen::inRange(0, size)));
  const std::vector<std::byte> exact(bytes);
  if (unpackCompressed(g, exact, block)) RC_ASSERT(block.bytes() <= g.blockBytes() + 4 * 50 * 65);
}

RC_GTEST_PROP(PackedBlock, ShortOfOneByteOrLongerByOneIsRefused, ()) {
  const StoreGeometry g = drawGeometry();
  std::vector<std::byte> bytes;
  packBlock(g, drawBlock(g).data(), bytes);
  auto longer = bytes;
  longer.emplace_back();
  bytes.pop_back();
  for (const bool plain : {false, true}) {
    RC_ASSERT(!unpacked(g, bytes, plain));
    RC_ASSERT(!unpacked(g, longer, plain));
  }
}

}  // namespace
}  // namespace srf
