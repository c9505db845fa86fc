#include "model/nonnegative_least_squares.h"

#include <algorithm>
#include <cmath>

namespace srf {
namespace {

constexpr double kLeastPivot = 1e-6;  // of a column's own square: below it the others in use make it up

// Solves for the unknowns of `used`; false where they depend on each other.
template <std::size_t n>
bool solve(const NormalEquations<n>& e, unsigned used, std::array<double, n>& x) {
  std::array<std::size_t, n> index{};
  std::size_t m = 0;
  for (std::size_t k = 0; k < n; ++k)
    if (used >> k & 1) index[m++] = k;
  std::array<std::array<double, n>, n> factor{};  // Cholesky, lower
  std::array<double, n> y{};
  for (std::size_t i = 0; i < m; ++i) {
    double sum = e.right[index[i]];
    for (std::size_t j = 0; j < i; ++j) {
      double entry = e.matrix[index[i]][index[j]];
      for (std::size_t k = 0; k < j; ++k) entry -= factor[i][k] * factor[j][k];
      factor[i][j] = entry / factor[j][j];
      sum -= factor[i][j] * y[j];
    }
    double pivot = e.matrix[index[i]][index[i]];
    for (std::size_t k = 0; k < i; ++k) pivot -= factor[i][k] * factor[i][k];
    if (!(pivot > kLeastPivot * e.matrix[index[i]][index[i]])) return false;
    factor[i][i] = std::sqrt(pivot);
    y[i] = sum / factor[i][i];
  }
  x.fill(0);
  for (std::size_t i = m; i-- > 0;) {
    double sum = y[i];
    for (std::size_t k = i + 1; k < m; ++k) sum -= factor[k][i] * x[index[k]];
    x[index[i]] = sum / factor[i][i];
  }
  return true;
}

}  // namespace

template <std::size_t n>
std::array<double, n> nonnegativeLeastSquares(const NormalEquations<n>& e, unsigned usable) {
  std::array<double, n> x{}, tried{};
  unsigned used = 0;
  double least = 0;  // a gain that is rounding
  for (std::size_t k = 0; k < n; ++k)
    if (e.matrix[k][k] > 0) least = std::max(least, 1e-9 * std::fabs(e.right[k]) / std::sqrt(e.matrix[k][k]));
  // Each round lets the unknown in that gains most; a few rounds settle n of them.
  for (int round = 0; round < 3 * static_cast<int>(n); ++round) {
    std::size_t best = n;
    double most = least;
    for (std::size_t k = 0; k < n; ++k) {
      if ((used >> k & 1) || !(usable >> k & 1) || !(e.matrix[k][k] > 0)) continue;
      double gradient = e.right[k];
      for (std::size_t j = 0; j < n; ++j) gradient -= e.matrix[k][j] * x[j];
      gradient /= std::sqrt(e.matrix[k][k]);  // the gain, whatever unit the unknown has
      if (gradient > most) best = k, most = gradient;
    }
    if (best == n) break;
    used |= 1u << best;
    if (!solve(e, used, tried)) {
      used &= ~(1u << best), usable &= ~(1u << best);
      continue;
    }
    // Back to the first boundary on the way, until all that is used is positive.
    for (;;) {
      double step = 1;
      std::size_t at = n;
      for (std::size_t k = 0; k < n; ++k)
        if ((used >> k & 1) && !(tried[k] > 0)) {
          const double reach = x[k] / (x[k] - tried[k]);
          if (at == n || reach < step) step = reach, at = k;
        }
      if (at == n) break;
      if (!(step >= 0 && step <= 1)) step = 0;  // both 0
      for (std::size_t k = 0; k < n; ++k)
        if (used >> k & 1) x[k] += step * (tried[k] - x[k]);
      used &= ~(1u << at), x[at] = 0;
      if (at == best) usable &= ~(1u << best);  // rounding: it gains nothing
      if (used == 0 || !solve(e, used, tried)) {
        tried = x;
        break;
      }
    }
    x = tried;
  }
  for (double& value : x)
    if (!(value > 0)) value = 0;
  return x;
}

template std::array<double, 4> nonnegativeLeastSquares<4>(const NormalEquations<4>&, unsigned);

}  // namespace srf
