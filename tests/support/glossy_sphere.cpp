#include "tests/support/glossy_sphere.h"

#include "base/numeric.h"

namespace srf::test {
namespace {

PointReflectance glossyAt(const Vec3& n) {
  const auto normal = Direction<AcquisitionSpace>::fromUnit(n);
  const Vec3 t = anyPerpendicular(normal).raw();
  PointReflectance point;
  for (int c = 0; c < 3; ++c) {
    point.normal[c] = static_cast<float>(n[c]);
    point.tangent[c] = static_cast<float>(t[c]);
    point.coefficient[0][c] = 0.3f + 0.1f * c;
    point.coefficient[1][c] = 0.1f;
    point.coefficient[2][c] = 0.05f;
    point.coefficient[3][c] = 0.5f;
  }
  point.alpha_x = point.alpha_y = 0.15f;
  return point;
}

}  // namespace

Vec3 glossy(const Vec3& n, const Vec3& l, const Vec3& v) {
  const PointReflectance point = glossyAt(n);
  const auto terms =
      modelTermsReference(point, Direction<AcquisitionSpace>::fromUnit(l), Direction<AcquisitionSpace>::fromUnit(v));
  Vec3 sum;
  for (int c = 0; c < 3; ++c)
    for (int k = 0; k < kModelTerms; ++k) sum[c] += terms[k] * point.coefficient[k][c];
  return sum;
}

ReflectanceFit fitOf(const FormulaField& field, float gate) {
  const DeformableModel& model = field.model;
  ReflectanceFit fit;
  fit.lit = fit.lit_by_rays = fit.lit_around = fit.worse = VisibilityBits(model.size(), field.manifest.lights.size());
  fit.seen_around = model.visible;
  for (std::size_t i = 0; i < model.size(); ++i) {
    const Vec3 n = rotationFromRodrigues(model.r0[i]).raw().column(2);
    fit.points.push_back({glossyAt(n), gate, 0});
    for (std::size_t j = 0; j < field.manifest.lights.size(); ++j)
      if (dot(field.manifest.lights[j].directionFrom(model.p0[i]).raw(), n) > 0)
        for (VisibilityBits* bits : {&fit.lit, &fit.lit_by_rays, &fit.lit_around}) bits->set(i, j);
  }
  return fit;
}

}  // namespace srf::test
