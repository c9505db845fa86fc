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

}  // namespace

void modelTerms(const PointReflectance& point, const std::array<float, 3>& view, const LightDirections& lights,
                const std::array<float*, kModelTerms>& term) {
  const auto [nx, ny, nz] = point.normal;
  const auto [tx, ty, tz] = point.tangent;
  const float bx = ny * tz - nz * ty, by = nz * tx - nx * tz, bz = nx * ty - ny * tx;
  const auto [vx, vy, vz] = view;
  const float nv = std::max(nx * vx + ny * vy + nz * vz, kLeastCosine);
  const float tv = tx * vx + ty * vy + tz * vz, bv = bx * vx + by * vy + bz * vz;
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
    // h = l + v of length sqrt(2 + 2 l.v): squares are enough for D, and v.h is half its length.
    const float half2 = std::max(2 + 2 * (lx * vx + ly * vy + lz * vz), 1e-6f);  // |h|^2
    const float nh = nl + nv, th = tl + tv, bh = bl + bv;
    const float slope = (th * th * inverse_ax2 + bh * bh * inverse_ay2 + nh * nh) / half2;
    const float masking_l = nl / (nl + std::sqrt(ax2 * tl * tl + ay2 * bl * bl + nl * nl) + 1e-12f);
    const float value = lobe * masking_l / (slope * slope);
    const float vh = 0.5f * std::sqrt(half2);
    lambert[i] = kInversePi * nl;
    transmitted[i] = transmitted_v * nl * (1 - fifth(1 - nl));
    specular[i] = value;
    fresnel[i] = value * fifth(std::max(1 - vh, 0.f));
  }
}

std::array<double, kModelTerms> modelTermsReference(const PointReflectance& point,
                                                    const Direction<AcquisitionSpace>& light,
                                                    const Direction<AcquisitionSpace>& view) {
  const auto vec = [](const std::array<float, 3>& a) { return Vec3{a[0], a[1], a[2]}; };
  const Vec3 n = vec(point.normal), t = vec(point.tangent), b = cross(n, t), l = light.raw(), v = view.raw();
  const double nl = dot(n, l), nv = std::max<double>(dot(n, v), kLeastCosine);
  if (!(nl > 0)) return {};
  // The half vector is that of the view as it is; at a view below the horizon n.v alone is raised to it.
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
          specular * fifth(std::max(1 - 0.5 * half, 0.0))};
}

}  // namespace srf
