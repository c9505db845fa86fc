#include "render/guided_kernels.h"

#include <algorithm>
#include <bit>
#include <cmath>

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

V dot3(const std::array<float, 3>& a, V x, V y, V z) {
  const F f;
  return hn::MulAdd(hn::Set(f, a[0]), x, hn::MulAdd(hn::Set(f, a[1]), y, hn::Mul(hn::Set(f, a[2]), z)));
}

/// value[c] = sum over views of share M_c for lights at `cosine`; as modelTerms has it, with one division:
/// D G1(l) G1(v) n.l / (4 n.l n.v) = lobe n.l |h|^4 / ((n.l + s_l) (..)^2).
template <class Value>
HWY_INLINE void values(const ModelOfPoint& m, const ModelView* views, std::size_t view_count, V x, V y, V z, V cosine,
                       const Value& value) {
  const F f;
  const V one = hn::Set(f, 1.f), zero = hn::Zero(f);
  const V nl = hn::Max(cosine, zero);
  const V tl = dot3(m.t, x, y, z), bl = dot3(m.b, x, y, z);
  const V s = hn::Sqrt(
      hn::MulAdd(hn::Mul(tl, tl), hn::Set(f, m.ax2), hn::MulAdd(hn::Mul(bl, bl), hn::Set(f, m.ay2), hn::Mul(nl, nl))));
  const V masked = hn::Add(hn::Add(nl, s), hn::Set(f, 1e-12f));
  V specular = zero, fresnel = zero;
  for (std::size_t i = 0; i < view_count; ++i) {
    const ModelView& view = views[i];
    const V half2 = hn::Max(hn::MulAdd(hn::Set(f, 2.f), dot3(view.v, x, y, z), hn::Set(f, 2.f)), hn::Set(f, 1e-6f));
    const V nh = hn::Add(nl, hn::Set(f, view.nv)), th = hn::Add(tl, hn::Set(f, view.tv)),
            bh = hn::Add(bl, hn::Set(f, view.bv));
    const V slope = hn::MulAdd(hn::Mul(th, th), hn::Set(f, m.inverse_ax2),
                               hn::MulAdd(hn::Mul(bh, bh), hn::Set(f, m.inverse_ay2), hn::Mul(nh, nh)));
    const V lobe =
        hn::Div(hn::Mul(hn::Set(f, view.share), hn::Mul(half2, half2)), hn::Mul(masked, hn::Mul(slope, slope)));
    specular = hn::Add(specular, lobe);
    const V grazing = hn::Max(hn::NegMulAdd(hn::Set(f, 0.5f), hn::Sqrt(half2), one), zero);
    fresnel = hn::MulAdd(lobe, fifth(grazing), fresnel);
  }
  specular = hn::Mul(specular, nl);
  fresnel = hn::Mul(fresnel, nl);
  const V transmitted = hn::NegMulAdd(nl, fifth(hn::Sub(one, nl)), nl);
  for (int c = 0; c < 3; ++c)
    value(c, hn::MulAdd(hn::Set(f, m.fresnel[c]), fresnel,
                        hn::MulAdd(hn::Set(f, m.specular[c]), specular,
                                   hn::MulAdd(hn::Set(f, m.transmitted[c]), transmitted,
                                              hn::Mul(hn::Set(f, m.lambert[c]), nl)))));
}

void sums(const ModelOfPoint& m, const ModelView* views, std::size_t view_count, const DirectionLanes& lights,
          const std::array<const float*, 3>& amount, std::size_t count, std::array<float, 3>& result) {
  const F f;
  V sum[3][kParts];
  for (auto& channel : sum)
    for (V& part : channel) part = hn::Zero(f);
  for (std::size_t i = 0; i < count; i += kVectorLanes)
    for (std::size_t p = 0; p < kParts; ++p) {
      const std::size_t at = i + p * kLanes;
      const V x = hn::LoadU(f, lights.x + at), y = hn::LoadU(f, lights.y + at), z = hn::LoadU(f, lights.z + at);
      values(m, views, view_count, x, y, z, dot3(m.n, x, y, z),
             [&](int c, V value) { sum[c][p] = hn::MulAdd(hn::LoadU(f, amount[c] + at), value, sum[c][p]); });
    }
  for (int c = 0; c < 3; ++c) result[c] = fold(sum[c]);
}

void keys(const std::array<float, 3>& n, const DirectionLanes& lights, const float* energy, std::size_t count,
          float* key) {
  const F f;
  for (std::size_t i = 0; i < count; i += kLanes) {
    const V cosine = dot3(n, hn::LoadU(f, lights.x + i), hn::LoadU(f, lights.y + i), hn::LoadU(f, lights.z + i));
    hn::StoreU(hn::Mul(hn::Max(cosine, hn::Zero(f)), hn::LoadU(f, energy + i)), f, key + i);
  }
}

std::size_t largest(const float* key, std::size_t count, std::size_t most, std::uint32_t* position) {
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
    auto greatest = hn::Zero(d);
    for (std::size_t i = 0; i < count; i += kLanes) greatest = hn::Max(greatest, hn::LoadU(d, bits + i));
    std::int32_t high = hn::GetLane(hn::MaxOfLanes(d, greatest)) + 1;
    // More than `most` are at least `low`, fewer are at least `high`; until they are as many, or the rest are equal.
    while (high - low > 1) {
      const std::int32_t middle = low + (high - low) / 2;
      const std::size_t found = at_least(middle);
      (found >= most ? low : high) = middle;
      if (found == most) break;
    }
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

void distant(const ModelOfPoint& m, const ModelView& view, const DistantLanes& lights, const std::int8_t* sight,
             const std::uint32_t* about, const CapturedShadow& shadow, std::size_t count, std::uint32_t* facing,
             float* shown_energy, std::size_t& facing_count, std::array<float, 3>& result) {
  const F f;
  const I d;
  const hn::Rebind<std::int8_t, F> bytes;
  V sum[3][kParts];
  for (auto& channel : sum)
    for (V& part : channel) part = hn::Zero(f);
  std::size_t found = 0;
  for (std::size_t i = 0; i < count; i += kVectorLanes)
    for (std::size_t p = 0; p < kParts; ++p) {
      const std::size_t at = i + p * kLanes;
      const V x = hn::LoadU(f, lights.direction.x + at), y = hn::LoadU(f, lights.direction.y + at),
              z = hn::LoadU(f, lights.direction.z + at);
      const V cosine = dot3(m.n, x, y, z), energy = hn::LoadU(f, lights.energy + at);
      const auto faces = hn::And(hn::Gt(cosine, hn::Zero(f)), hn::Gt(energy, hn::Zero(f)));
      if (hn::AllFalse(f, faces)) continue;
      const auto seen = hn::PromoteTo(d, hn::LoadU(bytes, sight + at));
      const auto near = hn::LoadU(d, reinterpret_cast<const std::int32_t*>(about) + at);
      const auto not_asked = hn::MaskFromVec(hn::BitCast(f, hn::VecFromMask(d, hn::Lt(seen, hn::Zero(d)))));
      V shown = hn::ConvertTo(f, seen);
      if (shadow.asked)
        shown = hn::MulAdd(shown, hn::GatherIndex(f, shadow.asked, near), hn::GatherIndex(f, shadow.offset, near));
      if (!hn::AllFalse(f, not_asked))
        shown = hn::IfThenElse(not_asked, hn::GatherIndex(f, shadow.unasked, near), shown);
      shown = hn::IfThenElseZero(faces, shown);
      hn::StoreU(hn::Mul(shown, energy), f, shown_energy + at);
      for (unsigned rest = bitsOf(f, faces); rest; rest &= rest - 1)
        facing[found++] = static_cast<std::uint32_t>(at + std::countr_zero(rest));
      if (hn::AllTrue(f, hn::Eq(shown, hn::Zero(f)))) continue;
      const V counts = shadow.trusted ? hn::Mul(shown, hn::GatherIndex(f, shadow.trusted, near)) : shown;
      values(m, &view, 1, x, y, z, cosine, [&](int c, V value) {
        sum[c][p] = hn::MulAdd(hn::Mul(counts, hn::LoadU(f, lights.irradiance[c] + at)), value, sum[c][p]);
      });
    }
  facing_count = found;
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

void residual(const ResidualShares& s, const CapturedLanes& lights, float most_ratio, std::size_t count,
              const std::array<float*, 3>& photograph, const std::array<float*, 3>& model) {
  const F f;
  const V zero = hn::Zero(f), one = hn::Set(f, 1.f);
  struct Light {
    V lit, amount_lit, as_is, irradiance[3];
  };
  const auto read = [&](std::size_t i) {
    Light light;
    const V all = hn::LoadU(f, s.all + i), shown = hn::Div(hn::LoadU(f, s.shown + i), all);
    const auto some = hn::Gt(all, zero);
    light.lit = hn::LoadU(f, s.lit + i);
    light.amount_lit = hn::Mul(hn::LoadU(f, s.usable + i), hn::IfThenElse(some, shown, one));
    light.as_is = s.as_is ? hn::MulAdd(hn::IfThenElse(some, shown, light.lit),
                                       hn::Set(f, s.indirect - s.indirect_shadow), hn::Set(f, s.indirect_shadow))
                          : zero;
    for (int c = 0; c < 3; ++c)
      light.irradiance[c] = hn::Mul(hn::LoadU(f, s.weight[c] + i), hn::LoadU(f, lights.irradiance[c] + i));
    return light;
  };
  V standing[kParts], reaching[kParts];
  for (std::size_t p = 0; p < kParts; ++p) standing[p] = reaching[p] = zero;
  for (std::size_t i = 0; i < count; i += kVectorLanes)
    for (std::size_t p = 0; p < kParts; ++p) {
      const Light light = read(i + p * kLanes);
      const V all = hn::Add(hn::Add(light.irradiance[0], light.irradiance[1]), light.irradiance[2]);
      standing[p] = hn::MulAdd(light.amount_lit, all, standing[p]);
      reaching[p] = hn::Add(reaching[p], hn::LoadU(f, s.shown + i + p * kLanes));
    }
  const float stands = fold(standing), reaches = fold(reaching);
  const V scale = hn::Set(f, stands > 0 ? std::min(most_ratio, reaches / stands) : 0.f);
  for (std::size_t i = 0; i < count; i += kLanes) {
    const Light light = read(i);
    const V known = hn::LoadU(f, lights.known + i), gate = hn::LoadU(f, s.gate + i);
    const V from_lit = hn::Mul(gate, hn::Mul(hn::Mul(hn::Sub(one, light.as_is), scale), light.amount_lit));
    const V from_all = hn::Mul(gate, light.as_is);
    const V given = hn::Mul(known, hn::Add(hn::Add(from_lit, from_all), hn::Sub(one, gate)));
    const V taken = hn::Mul(known, hn::MulAdd(from_all, light.lit, from_lit));
    for (int c = 0; c < 3; ++c) {
      hn::StoreU(hn::Mul(given, light.irradiance[c]), f, photograph[c] + i);
      hn::StoreU(hn::Mul(taken, light.irradiance[c]), f, model[c] + i);
    }
  }
}

std::size_t used(const CapturedLanes& lights, std::size_t count, const std::array<const float*, 3>& photograph,
                 const std::array<const float*, 3>& model, const std::array<float*, 3>& out, const UsedLanes& to,
                 std::size_t& photographs) {
  const F f;
  const V zero = hn::Zero(f);
  std::size_t found = 0;
  photographs = 0;
  for (std::size_t i = 0; i < count; i += kLanes) {
    alignas(64) float taken[3][kLanes];
    auto gives = hn::Ne(zero, zero), takes = gives;
    for (int c = 0; c < 3; ++c) {
      const V inverse = hn::LoadU(f, lights.inverse[c] + i);
      const V given = hn::Mul(hn::LoadU(f, photograph[c] + i), inverse);
      const V away = hn::IfThenElseZero(hn::Gt(inverse, zero), hn::LoadU(f, model[c] + i));
      gives = hn::Or(gives, hn::Ne(given, zero));
      takes = hn::Or(takes, hn::Ne(away, zero));
      hn::StoreU(given, f, out[c] + i);
      hn::Store(away, f, taken[c]);
    }
    photographs += hn::CountTrue(f, gives);
    for (unsigned rest = bitsOf(f, takes); rest; rest &= rest - 1, ++found) {
      const int lane = std::countr_zero(rest);
      to.direction[0][found] = lights.direction.x[i + lane], to.direction[1][found] = lights.direction.y[i + lane];
      to.direction[2][found] = lights.direction.z[i + lane];
      for (int c = 0; c < 3; ++c) to.model[c][found] = taken[c][lane];
    }
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
HWY_EXPORT(keys);
HWY_EXPORT(largest);
HWY_EXPORT(distant);
HWY_EXPORT(captured);
HWY_EXPORT(residual);
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
  constexpr float kLeastCosine = 1e-3f;  // as modelTerms has it
  constexpr float kInversePi = 0.318309886183790672f;
  const auto dot = [&](const std::array<float, 3>& a) { return a[0] * view[0] + a[1] * view[1] + a[2] * view[2]; };
  ModelView to{view, std::max(dot(m.n), kLeastCosine), dot(m.t), dot(m.b), 0};
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
void facingEnergy(const std::array<float, 3>& n, const DirectionLanes& lights, const float* energy, std::size_t count,
                  float* key) {
  HWY_DYNAMIC_DISPATCH(keys)(n, lights, energy, count, key);
}
std::size_t largestKeys(const float* key, std::size_t count, std::size_t most, std::uint32_t* position) {
  return HWY_DYNAMIC_DISPATCH(largest)(key, count, most, position);
}
std::array<float, 3> distantSums(const ModelOfPoint& model, const ModelView& view, const DistantLanes& lights,
                                 const std::int8_t* sight, const std::uint32_t* about, const CapturedShadow& shadow,
                                 std::size_t count, std::uint32_t* facing, float* shown_energy,
                                 std::size_t& facing_count) {
  std::array<float, 3> result;
  HWY_DYNAMIC_DISPATCH(distant)
  (model, view, lights, sight, about, shadow, count, facing, shown_energy, facing_count, result);
  return result;
}
void facingCaptured(const std::array<float, 3>& n, const CapturedLanes& lights, std::size_t count, float* lit,
                    float* usable, float* facing) {
  HWY_DYNAMIC_DISPATCH(captured)(n, lights, count, lit, usable, facing);
}
void residualAmounts(const ResidualShares& shares, const CapturedLanes& lights, float most_ratio, std::size_t count,
                     const std::array<float*, 3>& photograph, const std::array<float*, 3>& model) {
  HWY_DYNAMIC_DISPATCH(residual)(shares, lights, most_ratio, count, photograph, model);
}
std::size_t usedLights(const CapturedLanes& lights, std::size_t count, const std::array<const float*, 3>& photograph,
                       const std::array<const float*, 3>& model, const std::array<float*, 3>& out, const UsedLanes& to,
                       std::size_t& photographs) {
  return HWY_DYNAMIC_DISPATCH(used)(lights, count, photograph, model, out, to, photographs);
}
void shareBits(const std::uint64_t* const* rows, const float* weight, int points, std::size_t count, float* shares) {
  HWY_DYNAMIC_DISPATCH(bits)(rows, weight, points, count, shares);
}

}  // namespace srf
#endif
