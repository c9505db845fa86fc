#include "model/reflectance_model.h"

#include <algorithm>
#include <cmath>

#include "base/numeric.h"

namespace srf {
namespace {

constexpr float kInversePi = 0.318309886183790672f;
// Below this a view is taken to graze: the lobe's denominator stays away from 0.
constexpr float kLeastCosine = 1e-3f;

template <class Real>
Real fifth(Real x) {
  return x * x * (x * x) * x;
}

// F of the header.
template <class Real>
Real fresnelRise(Real x) {
  const auto [third, fourth, fifth, sixth] = kFresnelRise;
  return x * x * x * (Real{third} + x * (Real{fourth} + x * (Real{fifth} + x * Real{sixth})));
}

}  // namespace

ModelSight modelSight(const std::array<float, 3>& n, const std::array<float, 3>& t, const std::array<float, 3>& b,
                      const std::array<float, 3>& view) {
  const auto product = [&](const std::array<float, 3>& a) { return a[0] * view[0] + a[1] * view[1] + a[2] * view[2]; };
  ModelSight sight{view, product(n), product(t), product(b)};
  if (sight.nv >= kLeastCosine) return sight;
  // All of it is raised, or h would not be of length 1, and the lobe of any height.
  const double flat = std::hypot(double{sight.tv}, double{sight.bv});
  const double length = std::sqrt(1 - square(double{kLeastCosine}));
  const double tv = flat > 1e-6 ? sight.tv * (length / flat) : length;  // straight from behind: any azimuth
  const double bv = flat > 1e-6 ? sight.bv * (length / flat) : 0;
  sight.nv = kLeastCosine, sight.tv = static_cast<float>(tv), sight.bv = static_cast<float>(bv);
  for (int k = 0; k < 3; ++k) sight.v[k] = static_cast<float>(kLeastCosine * n[k] + tv * t[k] + bv * b[k]);
  return sight;
}

void modelTerms(const PointReflectance& point, const std::array<float, 3>& view, const LightDirections& lights,
                const std::array<float*, kModelTerms>& term) {
  const auto [nx, ny, nz] = point.normal;
  const auto [tx, ty, tz] = point.tangent;
  const float bx = ny * tz - nz * ty, by = nz * tx - nx * tz, bz = nx * ty - ny * tx;
  const ModelSight sight = modelSight(point.normal, point.tangent, {bx, by, bz}, view);
  const float nv = sight.nv, tv = sight.tv, bv = sight.bv;
  const float ax = point.alpha_x, ay = point.alpha_y, ax2 = ax * ax, ay2 = ay * ay;
  const float inverse_ax2 = 1 / ax2, inverse_ay2 = 1 / ay2;
  // G1(v) / (n.v), with the 2 of each G1 and the 1/4 taken together: D G1(l) G1(v) n.l / (4 n.l n.v)
  //   = D n.l / ((n.l + s_l) (n.v + s_v)), s_x = sqrt((ax t.x)^2 + (ay b.x)^2 + (n.x)^2).
  const float masking_v = 1 / (nv + std::sqrt(ax2 * tv * tv + ay2 * bv * bv + nv * nv));
  const float lobe = masking_v / (static_cast<float>(kPi) * ax * ay);
  const float transmitted_v = kInversePi * (1 - fifth(1 - nv));
  const int padded = (lights.count + 7) / 8 * 8;
  float* const lambert = term[0];
  float* const transmitted = term[1];
  float* const specular = term[2];
  float* const fresnel = term[3];
  for (int i = 0; i < padded; ++i) {
    const float lx = lights.x[i], ly = lights.y[i], lz = lights.z[i];
    const float cosine = nx * lx + ny * ly + nz * lz;
    const float nl = std::max(cosine, 0.f);
    const float tl = tx * lx + ty * ly + tz * lz, bl = bx * lx + by * ly + bz * lz;
    // h = l + v, from its parts: 2 + 2 l.v has no digits left where both graze from opposite sides. Squares are enough
    // for D, and v.h is half its length.
    const float nh = nl + nv, th = tl + tv, bh = bl + bv, nh2 = nh * nh;
    const float half2 = std::max(th * th + bh * bh + nh2, 1e-6f);
    const float slope = (th * th * inverse_ax2 + bh * bh * inverse_ay2 + nh2) / half2;
    const float masking_l = nl / (nl + std::sqrt(ax2 * tl * tl + ay2 * bl * bl + nl * nl) + 1e-12f);
    const float value = lobe * masking_l / (slope * slope);
    const float vh = 0.5f * std::sqrt(half2);
    lambert[i] = kInversePi * nl;
    transmitted[i] = transmitted_v * nl * (1 - fifth(1 - nl));
    specular[i] = value;
    fresnel[i] = value * fresnelRise(std::max(1 - vh, 0.f));
  }
}

std::array<double, kModelTerms> modelTermsReference(const PointReflectance& point,
                                                    const Direction<AcquisitionSpace>& light,
                                                    const Direction<AcquisitionSpace>& view) {
  const auto vec = [](const std::array<float, 3>& a) { return Vec3{a[0], a[1], a[2]}; };
  const Vec3 n = vec(point.normal), t = vec(point.tangent), b = cross(n, t), l = light.raw();
  Vec3 v = view.raw();
  if (dot(n, v) < kLeastCosine) {
    const auto flat = normalize(Vector<AcquisitionSpace>(v - dot(n, v) * n));
    const double sine = std::sqrt(1 - square(double{kLeastCosine}));
    v = double{kLeastCosine} * n + sine * (flat ? flat->raw() : t);
  }
  const double nl = dot(n, l), nv = dot(n, v);
  if (!(nl > 0)) return {};
  const double half = std::max(length(l + v), 1e-3);
  const double nh = (nl + nv) / half, th = (dot(t, l) + dot(t, v)) / half, bh = (dot(b, l) + dot(b, v)) / half;
  const double ax = point.alpha_x, ay = point.alpha_y;
  const double slope = square(th / ax) + square(bh / ay) + square(nh);
  const double distribution = 1 / (kPi * ax * ay * square(slope));
  const auto masking = [&](double cosine, const Vec3& d) {
    return 2 * cosine / (cosine + std::sqrt(square(ax * dot(t, d)) + square(ay * dot(b, d)) + square(cosine)));
  };
  const double specular = distribution * masking(nl, l) * masking(nv, v) / (4 * nv);
  return {nl / kPi, nl / kPi * (1 - fifth(1 - nl)) * (1 - fifth(1 - nv)), specular,
          specular * fresnelRise(std::max(1 - 0.5 * half, 0.0))};
}

}  // namespace srf
