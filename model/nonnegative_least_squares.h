// Least squares in a few non-negative unknowns, by its normal equations.
#pragma once

#include <array>
#include <cstddef>

namespace srf {

template <std::size_t n>
struct NormalEquations {
  std::array<std::array<double, n>, n> matrix{};  ///< A^T W A, symmetric
  std::array<double, n> right{};                  ///< A^T W b
};

/// x >= 0 that makes x^T M x - 2 r^T x least (Lawson and Hanson 1974, chapter 23, on the normal equations), for a
/// positive semidefinite M. Unknowns whose column is 0, or lies within 1e-6 of the others in use, stay 0. `usable`:
/// bit k allows x[k].
template <std::size_t n>
std::array<double, n> nonnegativeLeastSquares(const NormalEquations<n>& equations, unsigned usable = (1u << n) - 1);

extern template std::array<double, 4> nonnegativeLeastSquares<4>(const NormalEquations<4>&, unsigned);

}  // namespace srf
