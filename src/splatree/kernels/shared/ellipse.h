// Which tiles an ellipse touches; kernels/reference/bin.py is the definition.
//
// Relative to its centre the ellipse |L d| <= k is, at height dy, the interval skew dy ± √(k² - c² dy²) / a, skew = -b/a.
// Over a strip of heights its right end is greatest at the height where the whole ellipse is (or at the strip's nearest
// border), likewise the left end; the part of a convex set in a strip touches all tiles between its ends. Bounds are
// widened by what float32 may lose, so a tile is left out only if no pixel in it can pass the blend's own test.
#pragma once
#include "shared/constants.h"
#include "shared/elementary.h"

namespace splatree {
namespace {

constexpr float TILE_PX = constants::TILE_PX, FAR = 1e9f;
constexpr float LOG2_ALPHA_THRESHOLD = float(constants::LOG2_ALPHA_THRESHOLD);

struct Ellipse {
  float x, y;                  // centre, px
  float k_squared, c_squared;  // of |L d|; px⁻²
  float skew, inverse_a;
  float height;       // half height, px
  float dy_of_right;  // height at which it is widest to the right; to the left it is minus that
  float margin;       // px
};

// log2 of the opacity at which a splat ends: of τ, times (0.3 px² / area)^power, area = √det Σ' = 1 / (a c); but at least of
// 1/255, or of a smaller τ, and at most of τ. The power 0 gives τ.
SPLATREE_FN float log2_threshold_of(float log2_threshold, float area_power, float a, float c) {
  const float weighed = log2_threshold + area_power * (log2_of(a * c) + float(constants::LOG2_SHRINK_AREA_PX2));
  return greatest(least(weighed, log2_threshold), least(log2_threshold, LOG2_ALPHA_THRESHOLD));
}

// Empty if the splat's opacity is below the threshold.
SPLATREE_FN Ellipse ellipse_of(float x, float y, float a, float b, float c, float log2_opacity, float half_size_x,
                               float half_size_y, float log2_threshold) {
  Ellipse e;
  e.x = x, e.y = y;
  e.k_squared = 1.38629436f * greatest(log2_opacity - log2_threshold, 0.f) * (1.f + 4e-6f) + 4e-6f;
  e.c_squared = c * c;
  e.inverse_a = 1.f / a;
  e.skew = -b * e.inverse_a;
  e.height = log2_opacity >= log2_threshold ? __builtin_sqrtf(e.k_squared) / c : -FAR;
  // d/d(dy) of skew dy + √(k² - c² dy²) / a vanishes where c dy = k t / √(1 + t²) with t = skew a / c = -b / c.
  e.dy_of_right = e.height * -b / __builtin_sqrtf(b * b + e.c_squared);
  e.margin = 2e-3f + 2e-6f * (half_size_x + half_size_y);
  return e;
}

struct Interval {
  float low, high;  // px
};

// The part of the ellipse between the heights top and bottom of the picture, px.
SPLATREE_FN Interval reach_of(const Ellipse& e, float top, float bottom) {
  top -= e.y, bottom -= e.y;
  const float right = least(greatest(e.dy_of_right, top), bottom);
  const float left = least(greatest(-e.dy_of_right, top), bottom);
  const float half_at_right = __builtin_sqrtf(greatest(e.k_squared - e.c_squared * right * right, 0.f)) * e.inverse_a;
  const float half_at_left = __builtin_sqrtf(greatest(e.k_squared - e.c_squared * left * left, 0.f)) * e.inverse_a;
  return {e.x + e.skew * left - half_at_left - e.margin, e.x + e.skew * right + half_at_right + e.margin};
}

struct Tiles {
  int first, end;
};

// Tiles whose pixel centres, 16 i + ½ to 16 i + 15½, meet an interval; of those that cover `size` pixels.
SPLATREE_FN Tiles tiles_in(Interval interval, float size) {
  const float low = greatest(interval.low, 0.f), high = least(interval.high, size);
  const int first = int(__builtin_ceilf((low - (TILE_PX - 0.5f)) * (1 / TILE_PX)));
  const int end = int(__builtin_floorf((high - 0.5f) * (1 / TILE_PX))) + 1;
  const bool some = (interval.high >= 0.5f) & (interval.low <= size - 0.5f) & (first < end);
  return {some ? first : 0, some ? end : 0};
}

// The heights of the pixel centres of a row of tiles.
SPLATREE_FN Interval strip_of(int row, float height) { return {TILE_PX * row + 0.5f, least(TILE_PX * (row + 1), height) - 0.5f}; }

// The smallest |L d|² in a strip of heights on the far side of an edge, px: right of it, or left of it with side −1.
//
// |L d|² = a² (dx − skew dy)² + c² dy². If the strip's point of least c² dy² and dx = skew dy lies beyond the edge, it is the
// nearest; else the nearest is on the edge, where the sum is a parabola in dy.
SPLATREE_FN float nearest_beyond(const Ellipse& e, float side, float edge, Interval strip) {
  const float dx = side * (edge - e.x), skew = side * e.skew;
  const float top = strip.low - e.y, bottom = strip.high - e.y;
  const float dy = least(greatest(0.f, top), bottom);
  const float a_squared = 1.f / (e.inverse_a * e.inverse_a);
  const float dy_on_edge = a_squared * skew * dx / (a_squared * skew * skew + e.c_squared);
  const float held = least(greatest(dy_on_edge, top), bottom), gap = dx - skew * held;
  const float inside = e.c_squared * dy * dy, on_edge = a_squared * gap * gap + e.c_squared * held * held;
  return dx <= skew * dy ? inside : on_edge;
}

// The same over the tiles left and right of those of a row, of num_tiles.
SPLATREE_FN float nearest_beside(const Ellipse& e, Tiles columns, Interval strip, int num_tiles) {
  const float left = nearest_beyond(e, -1.f, TILE_PX * columns.first - 0.5f, strip);
  const float right = nearest_beyond(e, 1.f, TILE_PX * columns.end + 0.5f, strip);
  return least(columns.first > 0 ? left : FAR, columns.end < num_tiles ? right : FAR);
}

// The same over the rows of tiles above and below, of num_tiles; wherever in these rows.
SPLATREE_FN float nearest_above_or_below(const Ellipse& e, Tiles rows, int num_tiles) {
  const float up = TILE_PX * rows.first - 0.5f - e.y, down = TILE_PX * rows.end + 0.5f - e.y;
  const float above = e.c_squared * up * up, below = e.c_squared * down * down;
  return least(rows.first > 0 ? above : FAR, rows.end < num_tiles ? below : FAR);
}

// The largest opacity in a tile that the splat is not listed in, but 1/255 at least and τ at most; `nearest` is the smallest
// |L d|² there.
SPLATREE_FN float floor_of(float log2_opacity, float nearest, float log2_threshold) {
  return exp2_of(least(greatest(log2_opacity - 0.72134752f * nearest, LOG2_ALPHA_THRESHOLD), log2_threshold));
}

}  // namespace
}  // namespace splatree
