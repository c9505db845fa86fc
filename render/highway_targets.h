// The instruction sets that kernels are compiled for; which one runs is decided at run time (Highway). Included before
// hwy/foreach_target.h.
//
// The rest of the program is built for SRF_MARCH, by default AVX2 with FMA and F16C: lesser sets are left out then.
// Kernels use only operations whose result does not depend on the vector length: element by element, or in sums over 16
// lanes that are folded in halves. So AVX2 and AVX-512 give the same bits.
#pragma once

#if defined(__AVX2__) && defined(__FMA__) && defined(__F16C__)
#define HWY_BASELINE_TARGETS HWY_AVX2
#define HWY_DISABLED_TARGETS HWY_AVX3_DL
#elif defined(__x86_64__)
// Without wide code: vectors of four, the narrowest that kernels are written for.
#define HWY_BASELINE_TARGETS HWY_SSSE3
#define HWY_DISABLED_TARGETS (HWY_SSE4 | HWY_AVX2 | HWY_AVX3 | HWY_AVX3_DL)
#endif
