// A glossy sphere whose reflectance the fitted model can express, and the fit that knows it.
#pragma once

#include "model/reflectance_fit.h"
#include "tests/support/formula_field.h"

namespace srf::test {

Vec3 glossy(const Vec3& n, const Vec3& l, const Vec3& v);  ///< as ReflectanceFormula
/// The fit of `field`, a sphere that hides no light from itself but by its horizon; each point guided as `gate` says.
ReflectanceFit fitOf(const FormulaField& field, float gate);

}  // namespace srf::test
