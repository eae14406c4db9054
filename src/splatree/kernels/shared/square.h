// The square extents of published code; kernels/reference/square.py is the definition.
#pragma once
#include "shared/portable.h"

namespace splatree {

// Which tiles a splat is listed in: all that its ellipse, its box or its square touches.
enum class TileRule { ELLIPSE, BOX, SQUARE };

// `3sigma` is `tau` with no share left to shrink and no pad.
struct Square {
  float log2_threshold;    // τ
  float energy_min;        // of ln(o/τ)
  float ratio_min;         // smallest share of 3 σ
  float pad;               // px
  float eigenvalue_floor;  // under the root of the eigenvalue, px⁴
};

namespace {

// Half the side, px, of a splat with the dilated covariance ((xx, xy), (xy, yy)).
SPLATREE_FN float half_side_of(const Square& square, float xx, float xy, float yy, float log2_opacity) {
  const float half_difference = 0.5f * (xx - yy);
  const float root = __builtin_sqrtf(greatest(half_difference * half_difference + xy * xy, square.eigenvalue_floor));
  const float sigma = __builtin_sqrtf(0.5f * (xx + yy) + root);
  const float energy = greatest(0.69314718f * (log2_opacity - square.log2_threshold), square.energy_min);
  const float reach = greatest(least(__builtin_sqrtf(2.f * energy), 3.f), 3.f * square.ratio_min);
  return greatest(__builtin_ceilf(reach * sigma + square.pad), 1.f);
}

// The same from the triangular factor a, b, c of the inverse covariance.
SPLATREE_FN float half_side_of_factor(const Square& square, float a, float b, float c, float log2_opacity) {
  const float inverse_a = 1.f / a, sigma_y = 1.f / c;
  const float skew = -b * inverse_a * sigma_y;
  return half_side_of(square, inverse_a * inverse_a + skew * skew, skew * sigma_y, sigma_y * sigma_y, log2_opacity);
}

// The tiles from first to before end, of num_tiles, that a side of the square is listed in; as Kerbl's code counts, in whose
// pixels the centre of the first is 0, and a square ends 15 px before the tile that it ends in.
struct Side {
  float first, end;
};

SPLATREE_FN Side side_of(float centre, float half_side, float num_tiles) {
  const float p = centre - 0.5f;
  const float first = __builtin_floorf((p - half_side) * (1.f / 16)), end = __builtin_floorf((p + half_side + 15) * (1.f / 16));
  return {least(greatest(first, 0.f), num_tiles), least(greatest(end, 0.f), num_tiles)};
}

SPLATREE_FN float tiles_along(float size) { return __builtin_ceilf(size * (1.f / 16)); }

}  // namespace
}  // namespace splatree
