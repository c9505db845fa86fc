// A glossy sphere whose reflectance the fitted model can express, and the fit that knows it.
#pragma once

#include <gtest/gtest.h>

#include <memory>

#include "model/reflectance_fit.h"
#include "tests/support/formula_field.h"
#include "tests/support/test_support.h"

namespace srf::test {

Vec3 glossy(const Vec3& n, const Vec3& l, const Vec3& v);  ///< as ReflectanceFormula
/// The fit of `field`, a sphere that hides no light from itself but by its horizon; each point guided as `gate` says.
ReflectanceFit fitOf(const FormulaField& field, float gate);

/// A suite about one sphere and the fit of it, made once by setUp.
class FittedSphereTest : public ::testing::Test {
 protected:
  static void setUp(const FormulaFieldOptions& options, const ReflectanceFormula& formula, float gate) {
    folder_ = std::make_unique<TemporaryFolder>();
    field_ = std::make_unique<FormulaField>(makeSphereField(*folder_ / "x.srf", options, formula));
    fit_ = std::make_unique<ReflectanceFit>(fitOf(*field_, gate));
  }
  static void TearDownTestSuite() { fit_.reset(), field_.reset(), folder_.reset(); }

  inline static std::unique_ptr<TemporaryFolder> folder_;
  inline static std::unique_ptr<FormulaField> field_;
  inline static std::unique_ptr<ReflectanceFit> fit_;
};

}  // namespace srf::test
