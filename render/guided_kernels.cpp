#include "render/guided_kernels.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <type_traits>

#include "base/numeric.h"
#include "render/highway_targets.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "render/guided_kernels.cpp"
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

HWY_BEFORE_NAMESPACE();
namespace srf {
namespace HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

using F = hn::CappedTag<float, kVectorLanes>;
using I = hn::RebindToSigned<F>;
constexpr std::size_t kLanes = hn::MaxLanes(F());
constexpr std::size_t kParts = kVectorLanes / kLanes;
using V = hn::Vec<F>;

// A captured light this low over the surface tells nothing of it.
constexpr float kLowest = 0.05f, kLowEnough = 0.12f;

// 16 lanes to their sum, in halves.
float fold(V* parts) {
  alignas(64) float lane[kVectorLanes];
  for (std::size_t p = 0; p < kParts; ++p) hn::Store(parts[p], F(), lane + p * kLanes);
  for (std::size_t left = kVectorLanes / 2; left > 0; left /= 2)
    for (std::size_t i = 0; i < left; ++i) lane[i] += lane[i + left];
  return lane[0];
}

template <class D, class Mask>
unsigned bitsOf(D d, Mask mask) {
  std::uint8_t bytes[8] = {};
  hn::StoreMaskBits(d, mask, bytes);
  return bytes[0] | unsigned{bytes[1]} << 8;
}

V fifth(V x) {
  const V square = hn::Mul(x, x);
  return hn::Mul(hn::Mul(square, square), x);
}

V fresnelRise(V x) {
  const F f;
  V sum = hn::Set(f, kFresnelRise[3]);
  for (int i = 2; i >= 0; --i) sum = hn::MulAdd(sum, x, hn::Set(f, kFresnelRise[i]));
  return hn::Mul(sum, hn::Mul(x, hn::Mul(x, x)));
}

V dot3(const std::array<float, 3>& a, V x, V y, V z) {
  const F f;
  return hn::MulAdd(hn::Set(f, a[0]), x, hn::MulAdd(hn::Set(f, a[1]), y, hn::Mul(hn::Set(f, a[2]), z)));
}

/// value[c] = sum over views of share M_c for lights at `cosine`; as modelTerms has it, with one division:
/// D G1(l) G1(v) n.l / (4 n.l n.v) = lobe n.l |h|^4 / ((n.l + s_l) (..)^2). Where both roughnesses are the same,
/// (t.h)^2 + (b.h)^2 = |h|^2 - (n.h)^2 does without t and b.
template <bool kRound, bool kTransmits, class Value>
HWY_INLINE void values(const ModelOfPoint& m, const ModelView* views, std::size_t view_count, V x, V y, V z, V cosine,
                       const Value& value) {
  const F f;
  const V one = hn::Set(f, 1.f), zero = hn::Zero(f);
  const V nl = hn::Max(cosine, zero);
  V tl = zero, bl = zero, s = hn::Mul(nl, nl);
  if constexpr (kRound) {
    s = hn::Sqrt(hn::MulAdd(s, hn::Set(f, 1 - m.ax2), hn::Set(f, m.ax2)));
  } else {
    tl = dot3(m.t, x, y, z), bl = dot3(m.b, x, y, z);
    s = hn::Sqrt(hn::MulAdd(hn::Mul(tl, tl), hn::Set(f, m.ax2), hn::MulAdd(hn::Mul(bl, bl), hn::Set(f, m.ay2), s)));
  }
  const V masked = hn::Add(hn::Add(nl, s), hn::Set(f, 1e-12f));
  V specular = zero, fresnel = zero;
  for (std::size_t i = 0; i < view_count; ++i) {
    const ModelView& view = views[i];
    const V half2 = hn::Max(hn::MulAdd(hn::Set(f, 2.f), dot3(view.v, x, y, z), hn::Set(f, 2.f)), hn::Set(f, 1e-6f));
    const V nh = hn::Add(nl, hn::Set(f, view.nv));
    V slope = hn::Mul(nh, nh);
    if constexpr (kRound) {
      // No less than |h|^2 where the light is above the horizon; elsewhere the lobe counts nothing, but is finite.
      slope =
          hn::Max(half2, hn::MulAdd(half2, hn::Set(f, m.inverse_ax2), hn::Mul(slope, hn::Set(f, 1 - m.inverse_ax2))));
    } else {
      const V th = hn::Add(tl, hn::Set(f, view.tv)), bh = hn::Add(bl, hn::Set(f, view.bv));
      slope = hn::MulAdd(hn::Mul(th, th), hn::Set(f, m.inverse_ax2),
                         hn::MulAdd(hn::Mul(bh, bh), hn::Set(f, m.inverse_ay2), slope));
    }
    const V lobe =
        hn::Div(hn::Mul(hn::Set(f, view.share), hn::Mul(half2, half2)), hn::Mul(masked, hn::Mul(slope, slope)));
    specular = hn::Add(specular, lobe);
    const V grazing = hn::Max(hn::NegMulAdd(hn::Set(f, 0.5f), hn::Sqrt(half2), one), zero);
    fresnel = hn::MulAdd(lobe, fresnelRise(grazing), fresnel);
  }
  specular = hn::Mul(specular, nl);
  fresnel = hn::Mul(fresnel, nl);
  V transmitted = zero;
  if constexpr (kTransmits) transmitted = hn::NegMulAdd(nl, fifth(hn::Sub(one, nl)), nl);
  for (int c = 0; c < 3; ++c) {
    V diffuse = hn::Mul(hn::Set(f, m.lambert[c]), nl);
    if constexpr (kTransmits) diffuse = hn::MulAdd(hn::Set(f, m.transmitted[c]), transmitted, diffuse);
    value(c, hn::MulAdd(hn::Set(f, m.fresnel[c]), fresnel, hn::MulAdd(hn::Set(f, m.specular[c]), specular, diffuse)));
  }
}

/// Calls run with the two choices of values() that fit the point.
template <class Run>
HWY_INLINE void withKind(const ModelOfPoint& m, const Run& run) {
  constexpr float kSharpest = 0.08f;  // below, differences of |h|^2 and (n.h)^2 lose too many digits
  const bool round = m.ax2 == m.ay2 && m.ax2 > kSharpest * kSharpest && m.ax2 <= 1;
  const bool transmits = std::max({m.transmitted[0], m.transmitted[1], m.transmitted[2]}) > 0;
  const std::true_type yes;
  const std::false_type no;
  if (round)
    transmits ? run(yes, yes) : run(yes, no);
  else
    transmits ? run(no, yes) : run(no, no);
}

void sums(const ModelOfPoint& m, const ModelView* views, std::size_t view_count, const DirectionLanes& lights,
          const std::array<const float*, 3>& amount, std::size_t count, std::array<float, 3>& result) {
  const F f;
  V sum[3][kParts];
  for (auto& channel : sum)
    for (V& part : channel) part = hn::Zero(f);
  withKind(m, [&](auto round, auto transmits) {
    for (std::size_t i = 0; i < count; i += kVectorLanes)
      for (std::size_t p = 0; p < kParts; ++p) {
        const std::size_t at = i + p * kLanes;
        V amounts[3];
        for (int c = 0; c < 3; ++c) amounts[c] = hn::LoadU(f, amount[c] + at);
        const V any = hn::Or(amounts[0], hn::Or(amounts[1], amounts[2]));
        if (hn::AllTrue(f, hn::Eq(any, hn::Zero(f)))) continue;
        const V x = hn::LoadU(f, lights.x + at), y = hn::LoadU(f, lights.y + at), z = hn::LoadU(f, lights.z + at);
        values<round.value, transmits.value>(m, views, view_count, x, y, z, dot3(m.n, x, y, z), [&](int c, V value) {
          sum[c][p] = hn::MulAdd(amounts[c], value, sum[c][p]);
        });
      }
  });
  for (int c = 0; c < 3; ++c) result[c] = fold(sum[c]);
}

void blend(const std::array<const float*, 4>& vector, const std::array<float, 4>& share, std::size_t count,
           float* sum) {
  const F f;
  for (std::size_t i = 0; i < count; i += kLanes) {
    V of = hn::Mul(hn::Set(f, share[0]), hn::LoadU(f, vector[0] + i));
    for (int j = 1; j < 4; ++j) of = hn::MulAdd(hn::Set(f, share[j]), hn::LoadU(f, vector[j] + i), of);
    hn::StoreU(of, f, sum + i);
  }
}

std::size_t answers(const ModelOfPoint& m, const ModelView& view, const DirectionLanes& lights,
                    const std::array<const float*, 3>& irradiance, std::size_t count,
                    const std::array<float*, 3>& answer) {
  const F f;
  std::size_t facing = 0;
  withKind(m, [&](auto round, auto transmits) {
    for (std::size_t i = 0; i < count; i += kLanes) {
      const V x = hn::LoadU(f, lights.x + i), y = hn::LoadU(f, lights.y + i), z = hn::LoadU(f, lights.z + i);
      const V cosine = dot3(m.n, x, y, z);
      const auto faces = hn::Gt(cosine, hn::Zero(f));
      if (hn::AllFalse(f, faces)) {
        for (float* channel : answer) hn::StoreU(hn::Zero(f), f, channel + i);
        continue;
      }
      V shines = hn::Zero(f);
      values<round.value, transmits.value>(m, &view, 1, x, y, z, cosine, [&](int c, V value) {
        const V irradiated = hn::LoadU(f, irradiance[c] + i);
        shines = hn::Max(shines, irradiated);
        hn::StoreU(hn::IfThenElseZero(faces, hn::Mul(irradiated, value)), f, answer[c] + i);
      });
      facing += hn::CountTrue(f, hn::And(faces, hn::Gt(shines, hn::Zero(f))));
    }
  });
  return facing;
}

void keys(const std::array<const float*, 3>& answer, std::size_t count, float* key) {
  const F f;
  for (std::size_t i = 0; i < count; i += kLanes) {
    const V sum =
        hn::Add(hn::Add(hn::LoadU(f, answer[0] + i), hn::LoadU(f, answer[1] + i)), hn::LoadU(f, answer[2] + i));
    hn::StoreU(hn::Add(hn::LoadU(f, key + i), hn::Max(sum, hn::Zero(f))), f, key + i);
  }
}

void shownOf(const std::array<const float*, 3>& answer, const float* shown, std::size_t count,
             std::array<float, 3>& result) {
  const F f;
  V sum[3][kParts];
  for (auto& channel : sum)
    for (V& part : channel) part = hn::Zero(f);
  for (std::size_t i = 0; i < count; i += kVectorLanes)
    for (std::size_t p = 0; p < kParts; ++p)
      for (int c = 0; c < 3; ++c)
        sum[c][p] =
            hn::MulAdd(hn::LoadU(f, shown + i + p * kLanes), hn::LoadU(f, answer[c] + i + p * kLanes), sum[c][p]);
  for (int c = 0; c < 3; ++c) result[c] = fold(sum[c]);
}

std::size_t largest(const float* key, std::size_t count, std::size_t most, std::uint32_t* position,
                    std::int32_t& about) {
  // Not negative: as integers they are in the same order.
  const I d;
  const auto* bits = reinterpret_cast<const std::int32_t*>(key);
  const auto at_least = [&](std::int32_t least) {
    auto found = hn::Zero(d);
    for (std::size_t i = 0; i < count; i += kLanes)
      found = hn::Sub(found, hn::VecFromMask(d, hn::Gt(hn::LoadU(d, bits + i), hn::Set(d, least - 1))));
    return static_cast<std::size_t>(hn::GetLane(hn::SumOfLanes(d, found)));
  };
  std::int32_t low = 1;
  if (at_least(low) > most) {
    // More than `most` are at least `low`, fewer are at least `high`; until they are as many, or the rest are equal.
    // First in growing steps away from where it was last.
    std::int32_t high = 0x7fffffff, step = 1 << 19;
    bool up = false, down = false;
    for (std::int32_t middle = std::clamp(about, 2, high - 1); high - low > 1;) {
      const std::size_t found = at_least(middle);
      (found >= most ? low : high) = middle;
      if (found == most) break;
      (found > most ? up : down) = true;
      if (up && down) {
        middle = low + (high - low) / 2;
      } else {
        middle = up ? low + std::min(step, (high - low + 1) / 2) : high - std::min(step, (high - low + 1) / 2);
        step = std::min(2 * step, 1 << 28);
      }
    }
    about = low;
  }
  std::size_t found = 0;
  for (std::size_t i = 0; i < count; i += kLanes)
    for (unsigned rest = bitsOf(d, hn::Gt(hn::LoadU(d, bits + i), hn::Set(d, low - 1))); rest; rest &= rest - 1)
      position[found++] = static_cast<std::uint32_t>(i + std::countr_zero(rest));
  for (std::size_t last = found, over = found - std::min(found, most); over > 0; --last) {
    if (bits[position[last - 1]] != low) continue;
    std::copy(position + last, position + found, position + last - 1);
    --found, --over;
  }
  return found;
}

void shownTable(const float* lit, const float* facing, const float* disagree, std::size_t count, float* shown) {
  const F f;
  const V one = hn::Set(f, 1.f), zero = hn::Zero(f);
  for (std::size_t i = 0; i < count; i += kLanes) {
    const V light = hn::LoadU(f, lit + i), off = disagree ? hn::LoadU(f, disagree + i) : zero;
    const V unasked = hn::IfThenElse(hn::Gt(hn::LoadU(f, facing + i), zero), light, one);
    const V hidden = hn::Mul(off, light);
    hn::StoreU(hn::MulAdd(off, hn::Sub(light, unasked), unasked), f, shown + i);
    hn::StoreU(hidden, f, shown + count + i);
    hn::StoreU(hn::Add(hn::Sub(one, off), hidden), f, shown + 2 * count + i);
  }
}

void distant(const std::array<float, 3>& n, const DistantLanes& lights, const std::array<const float*, 3>& answer,
             const std::int8_t* sight, const std::uint32_t* about, const CapturedShadow& shadow, std::size_t count,
             float* energy_about, std::array<float, 3>& result) {
  const F f;
  const I d;
  const hn::Rebind<std::int8_t, F> bytes;
  const hn::FixedTag<float, 2> two;
  const auto stride = hn::Set(d, static_cast<std::int32_t>(shadow.stride));
  V sum[3][kParts];
  for (auto& channel : sum)
    for (V& part : channel) part = hn::Zero(f);
  for (std::size_t i = 0; i < count; i += kVectorLanes)
    for (std::size_t p = 0; p < kParts; ++p) {
      const std::size_t at = i + p * kLanes;
      const V cosine = dot3(n, hn::LoadU(f, lights.direction.x + at), hn::LoadU(f, lights.direction.y + at),
                            hn::LoadU(f, lights.direction.z + at));
      const V energy = hn::LoadU(f, lights.energy + at);
      const auto faces = hn::And(hn::Gt(cosine, hn::Zero(f)), hn::Gt(energy, hn::Zero(f)));
      if (hn::AllFalse(f, faces)) continue;
      const auto row = hn::Add(hn::PromoteTo(d, hn::LoadU(bytes, sight + at)), hn::Set(d, 1));
      const auto near = hn::LoadU(d, reinterpret_cast<const std::int32_t*>(about) + at);
      const V shown = hn::IfThenElseZero(faces, hn::GatherIndex(f, shadow.shown, hn::Add(hn::Mul(row, stride), near)));
      alignas(64) float energies[2 * kLanes];
      hn::StoreInterleaved2(hn::Mul(shown, energy), hn::IfThenElseZero(faces, energy), f, energies);
      // Neighbours in turn to two places: lights side by side mostly lie about the same captured one. Without
      // branches.
      for (std::size_t lane = 0; lane < kLanes; ++lane) {
        float* const to = energy_about + std::size_t{4} * about[at + lane] + 2 * (lane % 2);
        hn::Store(hn::Add(hn::Load(two, to), hn::Load(two, energies + 2 * lane)), two, to);
      }
      const V counts = shadow.trusted ? hn::Mul(shown, hn::GatherIndex(f, shadow.trusted, near)) : shown;
      for (int c = 0; c < 3; ++c) sum[c][p] = hn::MulAdd(counts, hn::LoadU(f, answer[c] + at), sum[c][p]);
    }
  for (int c = 0; c < 3; ++c) result[c] = fold(sum[c]);
}

V smoothstepOf(V x, float edge0, float edge1) {
  const F f;
  const V t = hn::Min(hn::Max(hn::Mul(hn::Sub(x, hn::Set(f, edge0)), hn::Set(f, 1 / (edge1 - edge0))), hn::Zero(f)),
                      hn::Set(f, 1.f));
  return hn::Mul(hn::Mul(t, t), hn::NegMulAdd(hn::Set(f, 2.f), t, hn::Set(f, 3.f)));
}

void captured(const std::array<float, 3>& n, const CapturedLanes& lights, std::size_t count, float* lit, float* usable,
              float* facing) {
  const F f;
  V any = hn::Zero(f);
  for (std::size_t i = 0; i < count; i += kLanes)
    any = hn::MulAdd(hn::LoadU(f, usable + i), hn::LoadU(f, lights.known + i), any);
  const bool none = hn::AllTrue(f, hn::Eq(any, hn::Zero(f)));
  for (std::size_t i = 0; i < count; i += kLanes) {
    const V known = hn::LoadU(f, lights.known + i);
    const V cosine = dot3(n, hn::LoadU(f, lights.direction.x + i), hn::LoadU(f, lights.direction.y + i),
                          hn::LoadU(f, lights.direction.z + i));
    const V faces = hn::Mul(known, smoothstepOf(cosine, kLowest, kLowEnough));
    const V lights_it = hn::Mul(known, hn::LoadU(f, lit + i));
    hn::StoreU(faces, f, facing + i);
    hn::StoreU(lights_it, f, lit + i);
    hn::StoreU(hn::Mul(none ? lights_it : hn::LoadU(f, usable + i), faces), f, usable + i);
  }
}

/// The lanes of `of` that are set, one after the other, and then others.
template <class Mask>
class Compression {
 public:
  explicit Compression(Mask mask) : mask_(mask), bits_(bitsOf(F(), mask)) {}
  V operator()(V of) const {
    if constexpr (kLanes == 8) {
      const auto lanes = hn::LoadU(hn::Rebind<std::uint8_t, F>(), kOrder.lane[bits_]);
      return hn::TableLookupLanes(of, hn::IndicesFromVec(F(), hn::PromoteTo(I(), lanes)));
    } else {
      return hn::Compress(of, mask_);
    }
  }
  std::size_t count() const { return static_cast<std::size_t>(std::popcount(bits_)); }

 private:
  struct Order {
    std::uint8_t lane[256][8];
    constexpr Order() : lane{} {
      for (int bits = 0; bits < 256; ++bits)
        for (int i = 0, at = 0; i < 8; ++i)
          if (bits >> i & 1) lane[bits][at++] = static_cast<std::uint8_t>(i);
    }
  };
  static constexpr Order kOrder{};
  Mask mask_;
  unsigned bits_;
};

std::size_t used(const CapturedLanes& lights, std::size_t count, const ResidualShares* distant,
                 const ResidualAmounts* single, const std::array<float*, 3>& out, const UsedLanes& to,
                 std::size_t& photographs) {
  const F f;
  const V zero = hn::Zero(f), one = hn::Set(f, 1.f);
  V scale = zero, dark_scale = zero;
  float *const amount_lit = out[0], *const reach = out[1];  // on their way
  if (distant) {
    const ResidualShares& s = *distant;
    V standing[kParts], reaching[kParts], dark[kParts], hidden[kParts];
    for (std::size_t p = 0; p < kParts; ++p) standing[p] = reaching[p] = dark[p] = hidden[p] = zero;
    for (std::size_t i = 0; i < count; i += kVectorLanes)
      for (std::size_t p = 0; p < kParts; ++p) {
        const std::size_t at = i + p * kLanes;
        V even, even_all, odd, odd_all;
        hn::LoadInterleaved4(f, s.energy + 4 * at, even, even_all, odd, odd_all);
        const V shown = hn::Add(even, odd), all = hn::Add(even_all, odd_all), share = hn::Div(shown, all);
        const auto some = hn::Gt(all, zero);
        const V amount = hn::Mul(hn::LoadU(f, s.usable + at), hn::IfThenElse(some, share, one));
        hn::StoreU(amount, f, amount_lit + at);
        const V lit = hn::LoadU(f, s.lit + at), reaches = hn::IfThenElse(some, share, lit);
        hn::StoreU(reaches, f, reach + at);
        const V energy = hn::Add(hn::Add(hn::LoadU(f, s.irradiance[0] + at), hn::LoadU(f, s.irradiance[1] + at)),
                                 hn::LoadU(f, s.irradiance[2] + at));
        standing[p] = hn::MulAdd(amount, energy, standing[p]);
        reaching[p] = hn::Add(reaching[p], shown);
        const V hides = hn::Mul(hn::Mul(hn::LoadU(f, lights.known + at), hn::Sub(one, reaches)), energy);
        hidden[p] = hn::Add(hidden[p], hides);
        dark[p] = hn::MulAdd(hn::Sub(one, lit), hides, dark[p]);
      }
    const float stands = fold(standing), reaches = fold(reaching);
    scale = hn::Set(f, stands > 0 ? (1 - s.indirect) * std::min(s.most_ratio, reaches / stands) : 0.f);
    const float hides = fold(hidden), unlit = fold(dark);
    dark_scale = hn::Set(f, unlit > 0 ? s.indirect_shadow * std::min(s.most_ratio, hides / unlit) : 0.f);
  }
  std::size_t found = 0;
  photographs = 0;
  for (std::size_t i = 0; i < count; i += kLanes) {
    V given[3] = {zero, zero, zero}, taken[3] = {zero, zero, zero};
    if (single)
      for (int c = 0; c < 3; ++c)
        given[c] = hn::LoadU(f, single->photograph[c] + i), taken[c] = hn::LoadU(f, single->model[c] + i);
    if (distant) {
      const V known = hn::LoadU(f, lights.known + i), gate = hn::LoadU(f, distant->gate + i);
      const V reaches = hn::LoadU(f, reach + i), lit = hn::LoadU(f, distant->lit + i);
      const V from_lit = hn::Mul(gate, hn::Mul(scale, hn::LoadU(f, amount_lit + i)));
      const V from_all = hn::Mul(gate, hn::Mul(hn::Set(f, distant->indirect), reaches));
      const V from_dark = hn::Mul(hn::Mul(gate, dark_scale), hn::Mul(hn::Sub(one, reaches), hn::Sub(one, lit)));
      const V give = hn::Mul(known, hn::Add(hn::Add(from_lit, from_all), hn::Add(from_dark, hn::Sub(one, gate))));
      const V take = hn::Mul(known, hn::MulAdd(from_all, lit, from_lit));
      for (int c = 0; c < 3; ++c) {
        const V irradiance = hn::LoadU(f, distant->irradiance[c] + i);
        given[c] = hn::MulAdd(give, irradiance, given[c]);
        taken[c] = hn::MulAdd(take, irradiance, taken[c]);
      }
    }
    V gives = zero, takes = zero;
    for (int c = 0; c < 3; ++c) {
      const V inverse = hn::LoadU(f, lights.inverse[c] + i);
      given[c] = hn::Mul(given[c], inverse);
      taken[c] = hn::IfThenElseZero(hn::Gt(inverse, zero), taken[c]);
      gives = hn::Max(gives, hn::Abs(given[c]));
      takes = hn::Max(takes, hn::Abs(taken[c]));
      hn::StoreU(given[c], f, out[c] + i);
    }
    photographs += hn::CountTrue(f, hn::Gt(gives, zero));
    const Compression pack(hn::Gt(takes, zero));
    // Whole vectors are written: no more than `i` lie before them.
    const auto append = [&](V of, float* lanes) { hn::StoreU(pack(of), f, lanes + found); };
    append(hn::LoadU(f, lights.direction.x + i), to.direction[0]);
    append(hn::LoadU(f, lights.direction.y + i), to.direction[1]);
    append(hn::LoadU(f, lights.direction.z + i), to.direction[2]);
    for (int c = 0; c < 3; ++c) append(taken[c], to.model[c]);
    found += pack.count();
  }
  for (std::size_t i = found; i < paddedLanes(found); ++i) {
    to.direction[0][i] = to.direction[1][i] = 0, to.direction[2][i] = 1;
    for (int c = 0; c < 3; ++c) to.model[c][i] = 0;
  }
  return found;
}

void bits(const std::uint64_t* const* rows, const float* weight, int points, std::size_t count, float* shares) {
  const F f;
  const I d;
  const auto lane_bit = hn::Shl(hn::Set(d, 1), hn::Iota(d, 0));
  for (std::size_t i = 0; i < count; i += kLanes) {
    V sum = hn::Zero(f);
    for (int p = 0; p < points; ++p) {
      const auto word = hn::Set(d, static_cast<std::int32_t>(rows[p][i / 64] >> (i % 64) & 0xffffu));
      const auto set = hn::VecFromMask(d, hn::TestBit(word, lane_bit));
      sum = hn::Add(sum, hn::And(hn::BitCast(f, set), hn::Set(f, weight[p])));
    }
    hn::StoreU(hn::Min(sum, hn::Set(f, 1.f)), f, shares + i);
  }
}

}  // namespace HWY_NAMESPACE
}  // namespace srf
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace srf {
HWY_EXPORT(sums);
HWY_EXPORT(answers);
HWY_EXPORT(keys);
HWY_EXPORT(shownOf);
HWY_EXPORT(blend);
HWY_EXPORT(largest);
HWY_EXPORT(distant);
HWY_EXPORT(shownTable);
HWY_EXPORT(captured);
HWY_EXPORT(bits);
HWY_EXPORT(used);

ModelOfPoint modelOfPoint(const PointReflectance& point) {
  const auto [nx, ny, nz] = point.normal;
  const auto [tx, ty, tz] = point.tangent;
  ModelOfPoint m;
  m.n = point.normal, m.t = point.tangent;
  m.b = {ny * tz - nz * ty, nz * tx - nx * tz, nx * ty - ny * tx};
  const float ax = point.alpha_x, ay = point.alpha_y;
  m.ax2 = ax * ax, m.ay2 = ay * ay, m.inverse_ax2 = 1 / m.ax2, m.inverse_ay2 = 1 / m.ay2;
  m.specular = point.coefficient[2], m.fresnel = point.coefficient[3];
  m.lambert = m.transmitted = {0, 0, 0};
  m.lobe = 1 / (static_cast<float>(kPi) * ax * ay);
  return m;
}
ModelView addView(ModelOfPoint& m, const PointReflectance& point, const std::array<float, 3>& view, float share) {
  constexpr float kInversePi = 0.318309886183790672f;
  ModelView to{modelSight(m.n, m.t, m.b, view), 0};
  to.share = share * m.lobe / (to.nv + std::sqrt(m.ax2 * to.tv * to.tv + m.ay2 * to.bv * to.bv + to.nv * to.nv));
  const float grazing = 1 - to.nv, squared = grazing * grazing;
  const float lambert = kInversePi * share, transmitted = lambert * (1 - squared * squared * grazing);
  for (int c = 0; c < 3; ++c) {
    m.lambert[c] += lambert * point.coefficient[0][c];
    m.transmitted[c] += transmitted * point.coefficient[1][c];
  }
  return to;
}
void turn(ModelOfPoint& model, ModelView& view, const Mat3& to_lights) {
  for (std::array<float, 3>* axis : {&model.n, &model.t, &model.b, &view.v}) {
    const Vec3 turned = to_lights * Vec3{(*axis)[0], (*axis)[1], (*axis)[2]};
    for (int k = 0; k < 3; ++k) (*axis)[k] = static_cast<float>(turned[k]);
  }
}

std::array<float, 3> modelSums(const ModelOfPoint& model, const ModelView* views, std::size_t view_count,
                               const DirectionLanes& lights, const std::array<const float*, 3>& amount,
                               std::size_t count) {
  std::array<float, 3> result;
  HWY_DYNAMIC_DISPATCH(sums)(model, views, view_count, lights, amount, count, result);
  return result;
}
std::array<double, 3> modelSumsReference(const PointReflectance& point, const std::array<float, 3>& view,
                                         const DirectionLanes& lights, const std::array<const float*, 3>& amount,
                                         std::size_t count) {
  std::array<double, 3> sum{};
  for (std::size_t i = 0; i < count; ++i) {
    const auto term =
        modelTermsReference(point, Direction<AcquisitionSpace>::fromUnit(Vec3{lights.x[i], lights.y[i], lights.z[i]}),
                            Direction<AcquisitionSpace>::fromUnit(Vec3{view[0], view[1], view[2]}));
    for (int c = 0; c < 3; ++c)
      for (int t = 0; t < kModelTerms; ++t) sum[c] += double{amount[c][i]} * point.coefficient[t][c] * term[t];
  }
  return sum;
}
std::size_t modelAnswers(const ModelOfPoint& model, const ModelView& view, const DirectionLanes& lights,
                         const std::array<const float*, 3>& irradiance, std::size_t count,
                         const std::array<float*, 3>& answer) {
  return HWY_DYNAMIC_DISPATCH(answers)(model, view, lights, irradiance, count, answer);
}
void addBrightness(const std::array<const float*, 3>& answer, std::size_t count, float* key) {
  HWY_DYNAMIC_DISPATCH(keys)(answer, count, key);
}
std::array<float, 3> shownSums(const std::array<const float*, 3>& answer, const float* shown, std::size_t count) {
  std::array<float, 3> result;
  HWY_DYNAMIC_DISPATCH(shownOf)(answer, shown, count, result);
  return result;
}
std::size_t largestKeys(const float* key, std::size_t count, std::size_t most, std::uint32_t* position,
                        std::int32_t& about) {
  return HWY_DYNAMIC_DISPATCH(largest)(key, count, most, position, about);
}
void blendVectors(const std::array<const float*, 4>& vector, const std::array<float, 4>& share, std::size_t count,
                  float* sum) {
  HWY_DYNAMIC_DISPATCH(blend)(vector, share, count, sum);
}
void shownBySight(const float* lit, const float* facing, const float* disagree, std::size_t count, float* shown) {
  HWY_DYNAMIC_DISPATCH(shownTable)(lit, facing, disagree, count, shown);
}
std::array<float, 3> distantSums(const std::array<float, 3>& n, const DistantLanes& lights,
                                 const std::array<const float*, 3>& answer, const std::int8_t* sight,
                                 const std::uint32_t* about, const CapturedShadow& shadow, std::size_t count,
                                 float* energy) {
  std::array<float, 3> result;
  HWY_DYNAMIC_DISPATCH(distant)(n, lights, answer, sight, about, shadow, count, energy, result);
  return result;
}
void facingCaptured(const std::array<float, 3>& n, const CapturedLanes& lights, std::size_t count, float* lit,
                    float* usable, float* facing) {
  HWY_DYNAMIC_DISPATCH(captured)(n, lights, count, lit, usable, facing);
}
std::size_t usedLights(const CapturedLanes& lights, std::size_t count, const ResidualShares* distant,
                       const ResidualAmounts* single, const std::array<float*, 3>& out, const UsedLanes& to,
                       std::size_t& photographs) {
  return HWY_DYNAMIC_DISPATCH(used)(lights, count, distant, single, out, to, photographs);
}
void shareBits(const std::uint64_t* const* rows, const float* weight, int points, std::size_t count, float* shares) {
  HWY_DYNAMIC_DISPATCH(bits)(rows, weight, points, count, shares);
}

}  // namespace srf
#endif
