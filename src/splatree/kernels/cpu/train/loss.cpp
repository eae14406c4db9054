// The loss against a photograph and its derivative; kernels/reference/loss.py is the definition.
//
// An area of the picture is walked row by row. Red, green and blue lie side by side, so a blur along a row takes every third
// number and nothing has to be sorted. Rows of X and Y, and of P, Q and R blurred along the row, are kept in rings of 16; a row
// of the picture leaves when the rows five below it have come. All of it fits the second-level cache. Sums are kept for each area
// and added up in order.
#include <stdlib.h>
#include <string.h>

#include "cpu/runtime/isa.h"
#include "cpu/runtime/pool.h"
#include "cpu/train/train.h"
#include "shared/portable.h"

namespace splatree::SPLATREE_ISA {
namespace {

constexpr int HALF = LOSS_TAPS / 2, RING = 16, MAPS = 5;
constexpr int LINE = 3 * (LOSS_EDGE_X + 4 * HALF);  // numbers of a row with what the blurs need beside it

struct alignas(64) Area {
  float x[RING][LINE], y[RING][LINE];
  float along[3][RING][LINE];  // P, Q, R, blurred along the row
  float sums[MAPS][LINE];      // blurred down the rows
  float means[MAPS][LINE];     // and along the row
  float maps[3][LINE];         // P, Q, R
  float counts[RING][LINE];    // 1 where a pixel counts, 0 where it is masked or beyond the picture
};

int slot_of(int row) { return (row + RING) & (RING - 1); }

// Row `row` of X and Y; 0 beyond the picture, and X as Y where masked.
void load_row(const LossJob& job, int row, int x_first, int num_pixels, Area& a) {
  float *x = a.x[slot_of(row)], *y = a.y[slot_of(row)], *counts = a.counts[slot_of(row)];
  memset(x, 0, LINE * sizeof(float)), memset(y, 0, LINE * sizeof(float)), memset(counts, 0, LINE * sizeof(float));
  if (row < 0 || row >= job.height) return;
  const int begin = x_first < 0 ? -x_first : 0, end = x_first + num_pixels > job.width ? job.width - x_first : num_pixels;
  const int64_t first = int64_t(row) * job.width + x_first;
  for (int i = begin; i < end; ++i) {
    const bool is_counted = !job.mask || job.mask[first + i];
    for (int c = 0; c < 3; ++c) {
      const int64_t from = 3 * (first + i) + c;
      y[3 * i + c] = job.photo[from] * (1.f / 255.f);
      x[3 * i + c] = is_counted ? job.gain[c] * job.image[from] : y[3 * i + c];
      counts[3 * i + c] = is_counted ? 1.f : 0.f;
    }
  }
}

// Blurs a row along itself, from `begin` to `end`.
void blur_along(const float* taps, const float* from, int begin, int end, float* to) {
#pragma omp simd
  for (int j = begin; j < end; ++j) {
    float sum = taps[HALF] * from[j];
    for (int t = 1; t <= HALF; ++t) sum += taps[HALF + t] * (from[j - 3 * t] + from[j + 3 * t]);
    to[j] = sum;
  }
}

// The five maps around a row, blurred down the rows.
void blur_down(const LossJob& job, int row, int length, Area& a) {
  const float *x[LOSS_TAPS], *y[LOSS_TAPS];
  for (int t = 0; t < LOSS_TAPS; ++t) x[t] = a.x[slot_of(row + t - HALF)], y[t] = a.y[slot_of(row + t - HALF)];
#pragma omp simd
  for (int j = 0; j < length; ++j) {
    float mx = 0.f, my = 0.f, xx = 0.f, yy = 0.f, xy = 0.f;
    for (int t = 0; t < LOSS_TAPS; ++t) {
      const float wx = job.taps[t] * x[t][j], wy = job.taps[t] * y[t][j];
      mx += wx, my += wy, xx += wx * x[t][j], yy += wy * y[t][j], xy += wx * y[t][j];
    }
    a.sums[0][j] = mx, a.sums[1][j] = my, a.sums[2][j] = xx, a.sums[3][j] = yy, a.sums[4][j] = xy;
  }
}

// P, Q and R of a row; the index summed over the pixels from `begin` to `end` that count.
double compare_row(const LossJob& job, int row, int from, int to, int begin, int end, bool sums, Area& a) {
  const float* counts = a.counts[slot_of(row)];
  float total = 0.f;
#pragma omp simd reduction(+ : total)
  for (int j = from; j < to; ++j) {
    const float mx = a.means[0][j], my = a.means[1][j], both = mx * my, squares = mx * mx + my * my;
    const float a1 = 2.f * both + job.c1, a2 = 2.f * (a.means[4][j] - both) + job.c2;
    const float b1 = squares + job.c1, b2 = a.means[2][j] + a.means[3][j] - squares + job.c2;
    const float inverse = counts[j] / (b1 * b2), index = a1 * a2 * inverse;
    a.maps[0][j] = 2.f * (my * (a2 - a1) * inverse + mx * index * (1.f / b2 - 1.f / b1));
    a.maps[1][j] = -index / b2;
    a.maps[2][j] = 2.f * a1 * inverse;
    total += j >= begin && j < end ? index : 0.f;
  }
  return sums ? double(total) : 0.;
}

// The derivative by a row of the picture, and the sums of the row.
void finish_row(const LossJob& job, int row, int x0, int begin, int end, Area& a, double* sums) {
  const float *x = a.x[slot_of(row)], *y = a.y[slot_of(row)], *counts = a.counts[slot_of(row)];
  const float* maps[3][LOSS_TAPS];
  for (int m = 0; m < 3; ++m)
    for (int t = 0; t < LOSS_TAPS; ++t) maps[m][t] = a.along[m][slot_of(row + t - HALF)];
  float* out = a.maps[0];
#pragma omp simd
  for (int j = begin; j < end; ++j) {
    float p = 0.f, q = 0.f, r = 0.f;
    for (int t = 0; t < LOSS_TAPS; ++t)
      p += job.taps[t] * maps[0][t][j], q += job.taps[t] * maps[1][t][j], r += job.taps[t] * maps[2][t][j];
    const float difference = x[j] - y[j];
    const float sign = (difference > 0.f ? 1.f : 0.f) - (difference < 0.f ? 1.f : 0.f);
    out[j] = counts[j] * (job.by_difference * sign - job.by_index * (p + 2.f * x[j] * q + y[j] * r));
  }
  const int64_t first = int64_t(row) * job.width + x0;
  const int num_pixels = (end - begin) / 3;
  float total = 0.f, products[3] = {}, squares[3] = {};
  for (int i = 0; i < num_pixels; ++i) {
    float error = 0.f;
    for (int c = 0; c < 3; ++c) {
      const int j = begin + 3 * i + c;
      job.by_image[3 * (first + i) + c] = job.gain[c] * out[j];
      error += __builtin_fabsf(x[j] - y[j]);
      const float bare = counts[j] * job.image[3 * (first + i) + c];
      products[c] += bare * y[j], squares[c] += bare * bare;
    }
    job.errors[first + i] = error * (1.f / 3.f);
    total += error;
  }
  sums[SUM_DIFFERENCE] += total;
  for (int c = 0; c < 3; ++c) sums[SUM_PRODUCT + c] += products[c], sums[SUM_SQUARE + c] += squares[c];
}

void compare_area(const LossJob& job, int64_t index, Area& a) {
  const int areas_x = (job.width + LOSS_EDGE_X - 1) / LOSS_EDGE_X;
  const int x0 = int(index % areas_x) * LOSS_EDGE_X, y0 = int(index / areas_x) * LOSS_EDGE_Y;
  const int x1 = x0 + LOSS_EDGE_X < job.width ? x0 + LOSS_EDGE_X : job.width;
  const int y1 = y0 + LOSS_EDGE_Y < job.height ? y0 + LOSS_EDGE_Y : job.height;
  // Place 0 of a line is 2 HALF pixels before x0.
  const int num_pixels = x1 - x0 + 4 * HALF, length = 3 * num_pixels;
  const int begin = 6 * HALF, end = length - 6 * HALF;
  double* sums = job.sums + index * NUM_LOSS_SUMS;
  memset(sums, 0, NUM_LOSS_SUMS * sizeof(double));
  for (int row = y0 - 2 * HALF; row < y0; ++row) load_row(job, row, x0 - 2 * HALF, num_pixels, a);
  for (int row = y0 - HALF; row < y1 + HALF; ++row) {
    load_row(job, row + HALF, x0 - 2 * HALF, num_pixels, a);
    blur_down(job, row, length, a);
    for (int m = 0; m < MAPS; ++m) blur_along(job.taps, a.sums[m], 3 * HALF, length - 3 * HALF, a.means[m]);
    const bool is_own = row >= y0 && row < y1;
    sums[SUM_INDEX] += compare_row(job, row, 3 * HALF, length - 3 * HALF, begin, end, is_own, a);
    for (int m = 0; m < 3; ++m) blur_along(job.taps, a.maps[m], begin, end, a.along[m][slot_of(row)]);
    if (row - HALF >= y0) finish_row(job, row - HALF, x0, begin, end, a, sums);
  }
}

}  // namespace

void photo_loss(const LossJob& job) {
  const int64_t areas_x = (job.width + LOSS_EDGE_X - 1) / LOSS_EDGE_X, areas_y = (job.height + LOSS_EDGE_Y - 1) / LOSS_EDGE_Y;
  parallel_chunks(areas_x * areas_y, job.threads, [&](int64_t index) {
    Area area;
    compare_area(job, index, area);
  });
}

}  // namespace splatree::SPLATREE_ISA
