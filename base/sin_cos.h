// Sine and cosine of many angles at once: a plain loop that compilers make wide.
#pragma once

#include <bit>
#include <cmath>
#include <cstddef>
#include <cstdint>

namespace srf {

/// sine[i] and cosine[i] of angle[i] (radians) for i < count; the arrays must not overlap. Each is off by at most
/// 2^-52; 0 gives exactly 0 and 1. An angle gives the same bits wherever it stands. Beyond 1e5 rad, and of what is not
/// finite, the standard library's. Reduction to +-pi/4 and the polynomials there: fdlibm (Sun Microsystems, 1993).
inline void sinCos(const double* angle, double* sine, double* cosine, std::size_t count) {
  constexpr double kFarthest = 1e5;
  constexpr double kQuarters = 0.63661977236758134308;  // 2 / pi
  constexpr double kRound = 0x1.8p52;                   // added, it leaves an integer in the lowest bits
  // pi / 2 in three parts; the first two have 33 bits, so that their multiples are exact.
  constexpr double kFirst = 1.57079632673412561417, kSecond = 6.07710050630396597660e-11,
                   kThird = 2.02226624879595063154e-21;
  for (std::size_t i = 0; i < count; ++i) {
    const double shifted = angle[i] * kQuarters + kRound, n = shifted - kRound;
    const double x = ((angle[i] - n * kFirst) - n * kSecond) - n * kThird, z = x * x;
    const double s = x + x * z *
                             (-1.66666666666666324348e-01 +
                              z * (8.33333333332248946124e-03 +
                                   z * (-1.98412698298579493134e-04 +
                                        z * (2.75573137070700676789e-06 +
                                             z * (-2.50507602534068634195e-08 + z * 1.58969099521155010221e-10)))));
    const double c =
        1 - (0.5 * z - z * z *
                           (4.16666666666666019037e-02 +
                            z * (-1.38888888888741095749e-03 +
                                 z * (2.48015872894767294178e-05 +
                                      z * (-2.75573143513906633035e-07 +
                                           z * (2.08757232129817482790e-09 + z * -1.13596475577881948265e-11))))));
    const auto quarter = std::bit_cast<std::uint64_t>(shifted), swapped = 0 - (quarter & 1);
    const auto s_bits = std::bit_cast<std::uint64_t>(s), c_bits = std::bit_cast<std::uint64_t>(c);
    sine[i] = std::bit_cast<double>(((s_bits & ~swapped) | (c_bits & swapped)) ^ ((quarter & 2) << 62));
    cosine[i] = std::bit_cast<double>(((c_bits & ~swapped) | (s_bits & swapped)) ^ (((quarter + 1) & 2) << 62));
  }
  for (std::size_t i = 0; i < count; ++i)
    if (!(std::fabs(angle[i]) <= kFarthest)) {
      sine[i] = std::sin(angle[i]);
      cosine[i] = std::cos(angle[i]);
    }
}

}  // namespace srf
