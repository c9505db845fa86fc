// Small dense non-linear least squares with covariance: Levenberg and Marquardt's method (Marquardt, SIAM 1963) on
// normal equations, which Eigen factors. Calibrations have some hundred parameters; Ceres, the usual library, is linked
// in Debian with parts of SuiteSparse that are under the GPL.
#pragma once

#include <functional>
#include <vector>

#include "base/reporter.h"

namespace srf {

/// Residuals are functions of a step `delta` away from a state that the caller keeps: so a rotation is a matrix there,
/// and its three parameters are small angles about the axes.
struct LeastSquaresProblem {
  /// A group of residuals that depends on some of the parameters.
  struct Block {
    std::vector<int> parameters;  ///< indices, each once
    int residual_count = 0;
    /// `delta`: one value for each of `parameters`; writes residual_count values. Called from several threads.
    std::function<void(const double* delta, double* residuals)> evaluate;
  };
  std::vector<double> scale;  ///< of each parameter: a change that matters; derivatives take 1e-6 of it as their step
  std::vector<Block> blocks;
  std::function<void(const std::vector<double>& delta)> accept;  ///< moves the state by a step
};

struct LeastSquaresResult {
  double squares = 0;  ///< sum of the squared residuals
  std::size_t residual_count = 0;
  int iterations = 0;
  bool converged = false;
  /// [parameter][parameter], row-major: inverse of the normal equations times the residuals' variance, which is the
  /// sum of squares over (residuals - parameters). Empty where a parameter is not determined; `undetermined` is its
  /// index then.
  std::vector<double> covariance;
  int undetermined = -1;
};

/// Same input, same bits, any thread count.
LeastSquaresResult minimize(const LeastSquaresProblem& problem, int most_iterations = 100);

}  // namespace srf
