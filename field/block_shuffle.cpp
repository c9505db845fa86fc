#include "field/reflectance_block.h"

namespace srf {

// Halves are bit patterns that grow with their values, so the difference to the texel above (in the first row: to the
// left) is mostly a small whole number. Low and high bytes are kept apart: the high ones are nearly all 0 or 255. How
// this was chosen is in doc/field_format.md.
void shuffleBlock(const StoreGeometry& g, const std::uint16_t* block, std::byte* out) {
  const std::size_t all = g.blockHalves(), texel = g.texelHalves(), row = kTile * texel;
  const auto differ = [&](std::size_t begin, std::size_t end, std::size_t back) {
    for (std::size_t i = begin; i < end; ++i) {
      const unsigned d = block[i] - (back ? block[i - back] : 0u);
      out[i] = static_cast<std::byte>(d);
      out[all + i] = static_cast<std::byte>(d >> 8);
    }
  };
  differ(0, texel, 0);
  differ(texel, row, texel);
  differ(row, all, row);
}

void unshuffleBlock(const StoreGeometry& g, const std::byte* in, std::uint16_t* block) {
  const std::size_t all = g.blockHalves(), texel = g.texelHalves(), row = kTile * texel;
  const auto* low = reinterpret_cast<const std::uint8_t*>(in);
  const std::uint8_t* high = low + all;
  const auto add = [&](std::size_t begin, std::size_t end, std::size_t back) {
    std::uint16_t* to = block + begin;
    const std::uint16_t* from =
        to - back;  // a row or a texel before `to`: never the same numbers within one step below
    for (std::size_t i = begin; i < end; i += kLightGroup, to += kLightGroup, from += kLightGroup)
      for (int k = 0; k < kLightGroup; ++k)
        to[k] = static_cast<std::uint16_t>((back ? from[k] : 0) + (low[i + k] | high[i + k] << 8));
  };
  add(0, texel, 0);
  add(texel, row, texel);
  add(row, all, row);
}

}  // namespace srf
