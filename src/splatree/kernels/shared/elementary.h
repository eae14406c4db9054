// Exponential and logarithm as polynomials: a call of the C library would not vectorise.
#pragma once
#include "shared/portable.h"

namespace splatree {
namespace {

// 2^x with a relative error below 2e-7; x is held within [-126, 127].
SPLATREE_FN float exp2_of(float x) {
  x = least(greatest(x, -126.f), 127.f);
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
  return float_of(bits_of(p) + (bits_of(shifted) << 23));
}

SPLATREE_FN float exp_of(float x) { return exp2_of(x * 1.44269504f); }

// log2 of a positive normal number with an absolute error of about 1e-7 max(1, |log2 x|).
SPLATREE_FN float log2_of(float x) {
  const int exponent = (bits_of(x) - 0x3f3504f3) >> 23;  // so that m is in [√½, √2)
  const float m = float_of(bits_of(x) - exponent * (1 << 23));
  // ln m = 2 artanh s, s = (m - 1) / (m + 1), |s| < 0.172: the next term of the series is below 1e-9.
  const float s = (m - 1.f) / (m + 1.f);
  const float w = s * s;
  const float series = 1.f + w * (1.f / 3 + w * (1.f / 5 + w * (1.f / 7 + w * (1.f / 9))));
  return exponent + 2.88539008f * s * series;
}

}  // namespace
}  // namespace splatree
