// Exponential and logarithm: polynomials where a call of the C library would not vectorise, instructions where a GPU has them.
#pragma once
#include "shared/portable.h"

namespace splatree {
namespace {

#if defined(__CUDACC__)

// As below, with the instructions of the device; their relative error is 2^-22.5, the logarithm's near 1 an absolute one.
SPLATREE_FN float exp2_within(float x) {
  asm("ex2.approx.ftz.f32 %0, %1;" : "=f"(x) : "f"(x));
  return x;
}

SPLATREE_FN float log2_of(float x) {
  asm("lg2.approx.ftz.f32 %0, %1;" : "=f"(x) : "f"(x));
  return x;
}

#else

// 2^x with a relative error below 2e-7, for x in [-126, 127]; anything for others.
SPLATREE_FN float exp2_within(float x) {
  // Adding 1.5 · 2^23 rounds to an integer, which then is in the low bits.
  const float shifted = x + 12582912.f;
  const float f = x - (shifted - 12582912.f);  // in [-½, ½]
  // Minimax polynomial of degree 5 for the relative error, 7.5e-8.
  float p = 1.327647129e-3f;
  p = p * f + 9.675540961e-3f;
  p = p * f + 5.550713092e-2f;
  p = p * f + 2.402212024e-1f;
  p = p * f + 6.931469440e-1f;
  p = p * f + 1.f;
  // Unsigned: what is shifted out, and anything for other x, is no overflow.
  return float_of(int(unsigned(bits_of(p)) + (unsigned(bits_of(shifted)) << 23)));
}

// log2 of a positive normal number with an absolute error of about 1e-7 max(1, |log2 x|).
SPLATREE_FN float log2_of(float x) {
  const int exponent = int(unsigned(bits_of(x)) - 0x3f3504f3u) >> 23;  // so that 1 + f is in [√½, √2)
  const float f = float_of(int(unsigned(bits_of(x)) - (unsigned(exponent) << 23))) - 1.f;
  // Minimax polynomial of degree 8 for log2(1 + f) / f, absolute error 6.7e-09.
  float p = 1.254124186e-01f;
  p = p * f - 2.103033353e-01f;
  p = p * f + 2.173793867e-01f;
  p = p * f - 2.385194383e-01f;
  p = p * f + 2.876566747e-01f;
  p = p * f - 3.607211953e-01f;
  p = p * f + 4.809225289e-01f;
  p = p * f - 7.213471285e-01f;
  p = p * f + 1.442694869e+00f;
  return exponent + p * f;
}

#endif

// The same; x is held within [-126, 127].
SPLATREE_FN float exp2_of(float x) { return exp2_within(least(greatest(x, -126.f), 127.f)); }

SPLATREE_FN float exp_of(float x) { return exp2_of(x * 1.44269504f); }

SPLATREE_FN float sigmoid_of(float logit) { return 1.f / (1.f + exp_of(-logit)); }

// A power of two that brings |x|, from 0 to below infinity, below 2; 2^127 for 0.
SPLATREE_FN float power_of_two_over(float x) { return float_of((254 << 23) - (bits_of(x) & 0x7f800000)); }

}  // namespace
}  // namespace splatree
