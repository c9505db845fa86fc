#include "model/frame_kernels.h"

#include <cmath>

namespace srf {
namespace {

inline Vec3 at(const FrameVector& from, std::size_t i) {
  return {from[0][i], from[1][i], from[2][i]};
}
inline void put(const Vec3& a, FrameVector& to, std::size_t i) {
  to[0][i] = a.x, to[1][i] = a.y, to[2][i] = a.z;
}
/// Where the vectors are far from parallel: then the plain differences lose nothing.
inline Vec3 plainCross(const Vec3& a, const Vec3& b) {
  return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}

}  // namespace

void blendFrames(BlendedFrames& f, double phase_cosine, double least_squared) {
  for (std::size_t i = 0; i < f.count; ++i) {
    Vec3 u0{0, 0, 0}, v0 = u0, u = u0, v = u0;
    const Vec3 reference = at(f.reference, i);
    for (int k = 0; k < 3; ++k) {
      const Vec3 own_u = at(f.rest_u[k], i), own_v = at(f.rest_v[k], i);
      const Vec3 carried_u = at(f.u[k], i), carried_v = at(f.v[k], i);
      const double weight = f.weight[k][i];
      // The angle in this point's plane from its own phase to the reference's.
      const double x = dot(reference, own_u), y = dot(reference, own_v), squared = x * x + y * y;
      const double root = std::sqrt(squared), near = x > 0 ? x * x : 0.0;
      const double most = squared > 1e-6 ? phase_cosine * phase_cosine * squared : -1.0;
      const double c = near > most ? 1.0 : x / root, s = near > most ? 0.0 : y / root;
      u0 += weight * c * own_u + weight * s * own_v;
      v0 += weight * c * own_v - weight * s * own_u;
      u += weight * c * carried_u + weight * s * carried_v;
      v += weight * c * carried_v - weight * s * carried_u;
    }
    const Vec3 n = plainCross(u0, v0);
    const double squared = dot(n, n);
    f.holds[i] = squared > least_squared;
    const Vec3 n_bar = n / std::sqrt(squared);
    const Vec3 sum = u0 + plainCross(v0, n_bar);
    const Vec3 u_bar = sum / std::sqrt(dot(sum, sum)), v_bar = plainCross(n_bar, u_bar);
    const double uu = dot(u0, u_bar), uv = dot(u0, v_bar), vu = dot(v0, u_bar), vv = dot(v0, v_bar);
    const double scale = 1 / (uu * vv - uv * vu);
    put(u_bar, f.r_u, i);
    put(v_bar, f.r_v, i);
    put(n_bar, f.r_n, i);
    put(scale * vv * u - scale * uv * v, f.t_u, i);
    put(scale * uu * v - scale * vu * u, f.t_v, i);
  }
}

void lookUpFrames(FramesToLookUp& f) {
  constexpr double kLeast = 1e-250, kMost = 1e250;  // of a squared length that needs no scaling
  const double half = std::sqrt(0.5);
  for (std::size_t i = 0; i < f.count; ++i) {
    const Vec3 u = at(f.t_u, i), v = at(f.t_v, i);
    const double uu = dot(u, u), vv = dot(v, v);
    const Vec3 u_hat = u / std::sqrt(uu), v_hat = v / std::sqrt(vv);
    const Vec3 normal = cross(u_hat, v_hat);
    const double sine = std::sqrt(dot(normal, normal));
    const double least = uu < vv ? uu : vv, most = uu < vv ? vv : uu;
    f.holds[i] = (sine > kCollapsedSine) & (least > kLeast) & (most < kMost);
    const Vec3 n_bar = normal / sine;
    // Eq. 8 and 9, as bisectorPair has it.
    const Vec3 sum = u_hat + v_hat, difference = u_hat - v_hat;
    const double ss = dot(sum, sum), mm = dot(difference, difference);
    const bool by_sum = ss >= mm;
    const Vec3 longer{by_sum ? sum.x : difference.x, by_sum ? sum.y : difference.y, by_sum ? sum.z : difference.z};
    const Vec3 unit = longer / std::sqrt(by_sum ? ss : mm);
    const Vec3 a = cross(unit, n_bar), b = cross(n_bar, unit);
    const Vec3 s{by_sum ? unit.x : b.x, by_sum ? unit.y : b.y, by_sum ? unit.z : b.z};
    const Vec3 m{by_sum ? a.x : unit.x, by_sum ? a.y : unit.y, by_sum ? a.z : unit.z};
    const Vec3 u_bar = half * (s + m), v_bar = half * (s - m);
    const Vec3 n = (f.handedness[i] < 0 ? -1.0 : 1.0) * n_bar;
    for (int row = 0; row < 3; ++row) {
      const double ru = f.r_u[row][i], rv = f.r_v[row][i], rn = f.r_n[row][i];
      f.l[row][0][i] = ru * u_bar.x + rv * v_bar.x + rn * n.x;
      f.l[row][1][i] = ru * u_bar.y + rv * v_bar.y + rn * n.y;
      f.l[row][2][i] = ru * u_bar.z + rv * v_bar.z + rn * n.z;
    }
  }
}

}  // namespace srf
