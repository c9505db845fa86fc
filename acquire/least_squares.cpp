#include "acquire/least_squares.h"

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <cmath>

#include "base/check.h"
#include "base/parallel.h"

namespace srf {
namespace {

struct BlockTerms {
  Eigen::VectorXd residuals;
  Eigen::MatrixXd jacobian;
};

// Central differences: with steps of 1e-6 of a parameter's scale they keep 9 digits or so.
BlockTerms linearized(const LeastSquaresProblem& problem, const LeastSquaresProblem::Block& block) {
  const auto n = static_cast<Eigen::Index>(block.parameters.size());
  BlockTerms terms{Eigen::VectorXd(block.residual_count), Eigen::MatrixXd(block.residual_count, n)};
  std::vector<double> delta(block.parameters.size(), 0.0);
  Eigen::VectorXd ahead(block.residual_count), behind(block.residual_count);
  block.evaluate(delta.data(), terms.residuals.data());
  for (Eigen::Index j = 0; j < n; ++j) {
    const double h = 1e-6 * problem.scale[static_cast<std::size_t>(block.parameters[j])];
    delta[j] = h;
    block.evaluate(delta.data(), ahead.data());
    delta[j] = -h;
    block.evaluate(delta.data(), behind.data());
    delta[j] = 0;
    terms.jacobian.col(j) = (ahead - behind) / (2 * h);
  }
  return terms;
}

struct NormalEquations {
  Eigen::MatrixXd matrix;
  Eigen::VectorXd gradient;
  double squares = 0;
};

NormalEquations normalEquations(const LeastSquaresProblem& problem) {
  std::vector<BlockTerms> terms(problem.blocks.size());
  parallelFor(terms.size(), 1, [&](std::size_t begin, std::size_t end) {
    for (std::size_t b = begin; b < end; ++b) terms[b] = linearized(problem, problem.blocks[b]);
  });
  const auto n = static_cast<Eigen::Index>(problem.scale.size());
  NormalEquations sums{Eigen::MatrixXd::Zero(n, n), Eigen::VectorXd::Zero(n)};
  for (std::size_t b = 0; b < terms.size(); ++b) {
    const auto& used = problem.blocks[b].parameters;
    const Eigen::MatrixXd square = terms[b].jacobian.transpose() * terms[b].jacobian;
    const Eigen::VectorXd slope = terms[b].jacobian.transpose() * terms[b].residuals;
    for (std::size_t i = 0; i < used.size(); ++i) {
      sums.gradient[used[i]] += slope[static_cast<Eigen::Index>(i)];
      for (std::size_t j = 0; j < used.size(); ++j)
        sums.matrix(used[i], used[j]) += square(static_cast<Eigen::Index>(i), static_cast<Eigen::Index>(j));
    }
    sums.squares += terms[b].residuals.squaredNorm();
  }
  return sums;
}

double squaresAt(const LeastSquaresProblem& problem, const Eigen::VectorXd& step) {
  std::vector<double> sums(problem.blocks.size());
  parallelFor(sums.size(), 1, [&](std::size_t begin, std::size_t end) {
    for (std::size_t b = begin; b < end; ++b) {
      const auto& block = problem.blocks[b];
      std::vector<double> delta;
      for (const int p : block.parameters) delta.push_back(step[p]);
      Eigen::VectorXd residuals(block.residual_count);
      block.evaluate(delta.data(), residuals.data());
      sums[b] = residuals.squaredNorm();
    }
  });
  double sum = 0;
  for (const double s : sums) sum += s;
  return sum;
}

// The inverse by eigenvalues of the equations scaled to a unit diagonal, so that units do not matter.
void addCovariance(const NormalEquations& equations, LeastSquaresResult& result) {
  const Eigen::Index n = equations.gradient.size();
  const auto freedom = static_cast<double>(result.residual_count) - static_cast<double>(n);
  Eigen::VectorXd unit(n);
  for (Eigen::Index i = 0; i < n; ++i) {
    unit[i] = 1 / std::sqrt(equations.matrix(i, i));
    if (!std::isfinite(unit[i])) {
      result.undetermined = static_cast<int>(i);
      return;
    }
  }
  const Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> solver(unit.asDiagonal() * equations.matrix * unit.asDiagonal());
  if (solver.info() != Eigen::Success || !(solver.eigenvalues()[0] > 1e-13 * solver.eigenvalues()[n - 1])) {
    Eigen::Index weakest = 0;
    solver.eigenvectors().col(0).cwiseAbs().maxCoeff(&weakest);
    result.undetermined = static_cast<int>(weakest);
    return;
  }
  if (!(freedom > 0)) return;
  const Eigen::MatrixXd inverse =
      solver.eigenvectors() * solver.eigenvalues().cwiseInverse().asDiagonal() * solver.eigenvectors().transpose();
  const Eigen::MatrixXd covariance =
      (result.squares / freedom) * (unit.asDiagonal() * inverse * unit.asDiagonal()).eval();
  result.covariance.resize(static_cast<std::size_t>(n * n));
  for (Eigen::Index i = 0; i < n; ++i)
    for (Eigen::Index j = 0; j < n; ++j) result.covariance[static_cast<std::size_t>(i * n + j)] = covariance(i, j);
}

}  // namespace

LeastSquaresResult minimize(const LeastSquaresProblem& problem, int most_iterations) {
  LeastSquaresResult result;
  for (const auto& block : problem.blocks) result.residual_count += static_cast<std::size_t>(block.residual_count);
  NormalEquations equations = normalEquations(problem);
  double damping = 1e-4;
  while (result.iterations < most_iterations && !result.converged) {
    throwIfInterrupted();
    ++result.iterations;
    bool better = false;
    for (int tries = 0; tries < 20 && !better; ++tries) {
      Eigen::MatrixXd damped = equations.matrix;
      for (Eigen::Index i = 0; i < damped.rows(); ++i)
        damped(i, i) += damping * std::max(equations.matrix(i, i), 1e-30);
      const Eigen::VectorXd step = damped.ldlt().solve(-equations.gradient);
      const double squares = step.allFinite() ? squaresAt(problem, step) : INFINITY;
      better = squares < equations.squares;
      if (!better) {
        damping *= 8;
        continue;
      }
      damping = std::max(damping / 16, 1e-14);
      problem.accept({step.data(), step.data() + step.size()});
      const double before = equations.squares;
      equations = normalEquations(problem);
      // 1e-12 of the squares is far below any parameter's uncertainty.
      result.converged = before - equations.squares <= 1e-12 * before;
    }
    if (!better) result.converged = true;  // no step of any length lowers the squares: rounding is all that is left
  }
  result.squares = equations.squares;
  addCovariance(equations, result);
  return result;
}

}  // namespace srf
