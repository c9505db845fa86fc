#include "model/normal_spread.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <optional>

#include "base/numeric.h"
#include "base/parallel.h"
#include "model/points_around.h"

namespace srf {
namespace {

constexpr std::size_t kChunk = 256;  // points
constexpr double kSameWay = 0.5;     // cosine between normals of one surface
constexpr double kEvenly = 1e-3;     // of the points around: determinant over squared trace of where they lie
constexpr int kMostDoublings = 3;    // of the reach, where points lie farther apart
constexpr float kAlike = 0.01f;      // axes of a lobe that differ by less are made one, which is faster to draw
constexpr float kOfLongTails = 3;    // see the top of the header

// Sums over weighted places (x, y) in a tangent plane and the slopes (a, b) of the normals there.
struct SlopeSums {
  double weight = 0, x = 0, y = 0, a = 0, b = 0, xx = 0, xy = 0, yy = 0, xa = 0, ya = 0, xb = 0, yb = 0;

  void add(double w, double px, double py, double pa, double pb) {
    weight += w;
    x += w * px, y += w * py, a += w * pa, b += w * pb;
    xx += w * px * px, xy += w * px * py, yy += w * py * py;
    xa += w * px * pa, ya += w * py * pa, xb += w * px * pb, yb += w * py * pb;
  }
  /// The symmetric straight fit of slopes to places, about their means. None where the places do not tell it.
  std::optional<SymmetricMatrix> turn(const Vec3& u, const Vec3& v) const {
    if (!(weight > 0)) return std::nullopt;
    const auto about = [&](double sum, double p, double q) { return sum - p * q / weight; };
    const double cxx = about(xx, x, x), cxy = about(xy, x, y), cyy = about(yy, y, y);
    const double cxa = about(xa, x, a), cya = about(ya, y, a), cxb = about(xb, x, b), cyb = about(yb, y, b);
    const double determinant = cxx * cyy - cxy * cxy;
    if (!(determinant > kEvenly * square(cxx + cyy))) return std::nullopt;
    const double across = (cxx * cya - cxy * cxa + cyy * cxb - cxy * cyb) / 2;
    return symmetricInPlane((cyy * cxa - cxy * cya) / determinant, across / determinant,
                            (cxx * cyb - cxy * cxb) / determinant, u, v);
  }
};

// Of the points that are not told yet.
void turnsWithin(const std::vector<Point<AcquisitionSpace>>& points,
                 std::span<const Direction<AcquisitionSpace>> normals, double reach,
                 std::vector<SymmetricMatrix>& turns, std::vector<std::uint8_t>& told) {
  const PointsAround around(points, reach);
  parallelFor(points.size(), kChunk, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) {
      if (told[i]) continue;
      const Vec3 n = normals[i].raw(), u = anyPerpendicular(normals[i]).raw(), v = cross(n, u);
      SlopeSums sums;
      around(i, [&](std::uint32_t j) {
        const Vec3 from = points[j].raw() - points[i].raw(), m = normals[j].raw();
        const double same = dot(m, n);
        if (same > kSameWay)
          sums.add(square(1 - dot(from, from) / square(reach)), dot(from, u), dot(from, v), dot(m, u) / same,
                   dot(m, v) / same);
      });
      const auto turn = sums.turn(u, v);
      if (turn) turns[i] = *turn, told[i] = true;
    }
  });
}

}  // namespace

SymmetricMatrix symmetricInPlane(double a, double b, double c, const Vec3& u, const Vec3& v) {
  SymmetricMatrix m;
  int at = 0;
  for (int i = 0; i < 3; ++i)
    for (int j = i; j < 3; ++j)
      m[at++] = static_cast<float>(a * u[i] * u[j] + b * (u[i] * v[j] + v[i] * u[j]) + c * v[i] * v[j]);
  return m;
}

std::vector<SymmetricMatrix> normalTurns(const std::vector<Point<AcquisitionSpace>>& points,
                                         std::span<const Direction<AcquisitionSpace>> normals, double reach) {
  std::vector<SymmetricMatrix> turns(points.size());
  std::vector<std::uint8_t> told(points.size(), !(reach > 0));
  for (int wider = 0; wider <= kMostDoublings; ++wider, reach *= 2) {
    if (std::all_of(told.begin(), told.end(), [](std::uint8_t is) { return is; })) break;
    turnsWithin(points, normals, reach, turns, told);
  }
  return turns;
}

PointReflectance seenThrough(const PointReflectance& point, const SymmetricMatrix& spread) {
  const auto [xx, xy, xz, yy, yz, zz] = spread;
  if (!(xx + yy + zz > 0)) return point;
  const auto& n = point.normal;
  const auto& t = point.tangent;
  const std::array<float, 3> b{n[1] * t[2] - n[2] * t[1], n[2] * t[0] - n[0] * t[2], n[0] * t[1] - n[1] * t[0]};
  const auto product = [&](const std::array<float, 3>& p, const std::array<float, 3>& q) {
    return kOfLongTails * (p[0] * (xx * q[0] + xy * q[1] + xz * q[2]) + p[1] * (xy * q[0] + yy * q[1] + yz * q[2]) +
                           p[2] * (xz * q[0] + yz * q[1] + zz * q[2]));
  };
  const float ax2 = point.alpha_x * point.alpha_x, ay2 = point.alpha_y * point.alpha_y;
  const float tt = ax2 + (1 - ax2) * product(t, t), tb = (1 - 0.5f * (ax2 + ay2)) * product(t, b),
              bb = ay2 + (1 - ay2) * product(b, b);
  // Along the axes of the 2 x 2: twice the angle of the longer one has cosine half / root.
  const float middle = 0.5f * (tt + bb), half = 0.5f * (tt - bb), root = std::sqrt(half * half + tb * tb);
  const float least = std::min(point.alpha_x, point.alpha_y);
  const auto alpha = [least](float squared) { return std::clamp(std::sqrt(std::max(squared, 0.f)), least, 1.f); };
  PointReflectance seen = point;
  seen.alpha_x = alpha(middle + root), seen.alpha_y = alpha(middle - root);
  if (!(root > kAlike * middle)) {
    seen.alpha_x = seen.alpha_y = alpha(middle);
    return seen;
  }
  const float cosine = std::sqrt(std::max(0.5f * (1 + half / root), 0.f)),
              sine = std::copysign(std::sqrt(std::max(0.5f * (1 - half / root), 0.f)), tb);
  for (int k = 0; k < 3; ++k) seen.tangent[k] = cosine * t[k] + sine * b[k];
  return seen;
}

}  // namespace srf
