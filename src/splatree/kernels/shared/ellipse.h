// Which tiles of a row an ellipse touches; kernels/reference/bin.py is the definition.
//
// Relative to its centre the ellipse |L d| <= k is, at height dy, the interval -(b/a) dy ± √(k² - c² dy²) / a. Over a strip of
// heights its right end is greatest at the height where the whole ellipse is (or at the strip's nearest border), likewise the
// left end; the part of a convex set in a strip touches all tiles between its ends. Bounds are widened by what float32 may
// lose, so a tile is left out only if no pixel in it can pass the blend's own test.
#pragma once
#include "shared/elementary.h"
#include "shared/record.h"

namespace splatree {
namespace {

struct Ellipse {
  float x, y;          // centre, px
  float k_squared, c_squared;
  float skew;          // -b/a: the middle moves by skew dy
  float inverse_a;
  float height;        // half height, px
  float dy_of_right;   // height at which the ellipse is widest to the right; to the left it is minus that
  float margin;        // px
};

SPLATREE_FN Ellipse ellipse_of(const float* record, float log2_threshold) {
  Ellipse e;
  e.x = record[X], e.y = record[Y];
  const float a = record[FACTOR_A], b = record[FACTOR_B], c = record[FACTOR_C];
  e.k_squared = 1.38629436f * greatest(record[LOG2_OPACITY] - log2_threshold, 0.f) * (1.f + 4e-6f) + 4e-6f;
  e.c_squared = c * c;
  e.inverse_a = 1.f / a;
  e.skew = -b * e.inverse_a;
  const float k = __builtin_sqrtf(e.k_squared);
  e.height = k / c;
  // d/d(dy) of skew dy + √(k² - c² dy²) / a vanishes where c dy = k t / √(1 + t²), t = skew a / c = -b / c.
  const float t = -b / c;
  e.dy_of_right = e.height * t / __builtin_sqrtf(1.f + t * t);
  e.margin = 2e-3f + 2e-6f * (record[EXTENT_X] + record[EXTENT_Y]);
  return e;
}

// The right end (side = 1) or the negated left end (side = -1) over heights top to bottom, relative to the centre.
SPLATREE_FN float reach_of(const Ellipse& e, float side, float top, float bottom) {
  const float dy = least(greatest(side * e.dy_of_right, top), bottom);
  return side * e.skew * dy + __builtin_sqrtf(greatest(e.k_squared - e.c_squared * dy * dy, 0.f)) * e.inverse_a + e.margin;
}

}  // namespace
}  // namespace splatree
