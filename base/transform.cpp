#include "base/transform.h"

#include <cmath>

namespace srf {

Quaternion quaternionFromRotation(const Mat3& rotation) {
  const auto& r = rotation.row;
  // 4 q_i^2 for each component; the largest is at least 1, so its root keeps all digits.
  const double w2 = 1 + r[0].x + r[1].y + r[2].z, x2 = 1 + r[0].x - r[1].y - r[2].z;
  const double y2 = 1 - r[0].x + r[1].y - r[2].z, z2 = 1 - r[0].x - r[1].y + r[2].z;
  Quaternion q;
  if (w2 >= x2 && w2 >= y2 && w2 >= z2) {
    q = {w2, r[2].y - r[1].z, r[0].z - r[2].x, r[1].x - r[0].y};
  } else if (x2 >= y2 && x2 >= z2) {
    q = {r[2].y - r[1].z, x2, r[1].x + r[0].y, r[0].z + r[2].x};
  } else if (y2 >= z2) {
    q = {r[0].z - r[2].x, r[1].x + r[0].y, y2, r[2].y + r[1].z};
  } else {
    q = {r[1].x - r[0].y, r[0].z + r[2].x, r[2].y + r[1].z, z2};
  }
  const double scale = (q.w < 0 ? -1.0 : 1.0) / std::sqrt(q.w * q.w + q.x * q.x + q.y * q.y + q.z * q.z);
  return {q.w * scale, q.x * scale, q.y * scale, q.z * scale};
}

Mat3 rotationFromQuaternion(const Quaternion& q) {
  const double n = q.w * q.w + q.x * q.x + q.y * q.y + q.z * q.z, s = 2 / n;
  const Mat3 k = crossMatrix({q.x, q.y, q.z});
  return Mat3{} + (s * q.w) * k + s * (k * k);
}

}  // namespace srf
