// Backward over the pixels of a tile; kernels/reference/backward.py is the definition.
//
// The list of a tile is walked front to back, as it was drawn, with the same transmittance to the last bit. Behind each splat
// there is the light R that is still to come: it starts as the whole light of the pixel, (∂·C), and each splat takes its own
// share away. So nothing of the forward pass is stored but the picture. R cancels as it shrinks: its error is 1e-7 of the whole
// light.
//
// The sums of a pair are gathered in 16 lanes and written once, at the pair's own place: a tile owns its pairs, so the sums of a
// splat, added up pair by pair afterwards, have the same bits for any number of threads.
#include "cpu/frame/blend_backward.h"

#include <string.h>

#include "cpu/frame/brush.h"
#include "cpu/runtime/isa.h"
#include "cpu/runtime/pool.h"
#include "cpu/runtime/quad.h"

namespace splatree::SPLATREE_ISA {
namespace {

constexpr int AHEAD = 8;  // pairs between the fetch of a record and its use

struct alignas(64) Tile {
  float transmittance[CELLS][LANES];
  float behind[CELLS][LANES];                                        // R
  float red[CELLS][LANES], green[CELLS][LANES], blue[CELLS][LANES];  // ∂loss/∂C
  float depth[CELLS][LANES];                                         // ∂loss/∂(Σ w z)
  float error[CELLS][LANES];
};

struct alignas(64) Lanes {
  float sum[NUM_SUMS][LANES];
};

struct Plain {
  static constexpr bool OF_DEPTHS = false, OF_ERRORS = false;
};
struct WithDepths {
  static constexpr bool OF_DEPTHS = true, OF_ERRORS = false;
};
struct WithErrors {
  static constexpr bool OF_DEPTHS = false, OF_ERRORS = true;
};
struct WithBoth {
  static constexpr bool OF_DEPTHS = true, OF_ERRORS = true;
};

void load_tile(const BlendBackwardJob& job, int x0, int y0, Tile& tile) {
  memset(&tile, 0, sizeof tile);
  for (int cell = 0; cell < CELLS; ++cell)
    for (int l = 0; l < LANES; ++l) {
      const int x = x0 + 4 * (cell & 3) + (l & 3), y = y0 + 4 * (cell >> 2) + (l >> 2);
      tile.transmittance[cell][l] = -1.f;  // outside: finished
      if (x >= job.width || y >= job.height) continue;
      const int64_t pixel = int64_t(y) * job.width + x;
      const float *by = job.by_image + 3 * pixel, *color = job.image + 3 * pixel;
      float light = by[0] * color[0] + by[1] * color[1] + by[2] * color[2];
      float by_alpha = job.by_alpha ? job.by_alpha[pixel] : 0.f;
      const float alpha = job.alpha[pixel];
      if (job.by_depth && alpha > 0.f) {  // depth = (Σ w z) / alpha
        tile.depth[cell][l] = job.by_depth[pixel] / alpha;
        by_alpha -= tile.depth[cell][l] * job.depth[pixel];
        light += job.by_depth[pixel] * job.depth[pixel];
      }
      tile.transmittance[cell][l] = 1.f;
      tile.behind[cell][l] = light - (1.f - alpha) * by_alpha;
      tile.red[cell][l] = by[0], tile.green[cell][l] = by[1], tile.blue[cell][l] = by[2];
      if (job.errors) tile.error[cell][l] = job.errors[pixel];
    }
}

template <class Keeps>
SPLATREE_FN void backward_cell(const Brush& brush, int cell, const Limits& limits, Tile& tile, Lanes& lanes) {
  const float u_of_cell = brush.u_of_cell[cell], v_of_cell = brush.v_of_cell[cell];
  float *transmittance = tile.transmittance[cell], *behind = tile.behind[cell];
  const float *red = tile.red[cell], *green = tile.green[cell], *blue = tile.blue[cell];
  const float *by_depth = tile.depth[cell], *error = tile.error[cell];
#pragma omp simd
  for (int l = 0; l < LANES; ++l) {
    // As blend.cpp, to the bit.
    const float u = u_of_cell + brush.u_of_lane[l], v = v_of_cell + brush.v_of_lane[l];
    const float log2_alpha = brush.log2_opacity - (u * u + v * v);
    const float whole = exp2_within(log2_alpha);
    const float alpha = least(whole, limits.alpha_max);
    const float before = transmittance[l];
    const float after = before * (1.f - alpha);
    const bool seen = (log2_alpha >= brush.log2_threshold) & (before > 0.f);
    const bool drawn = seen & (after >= TRANSMITTANCE_MIN);
    const float weight = drawn ? before * alpha : 0.f;
    transmittance[l] = drawn ? after : seen ? -before : before;

    const float depth_part = Keeps::OF_DEPTHS ? by_depth[l] * brush.depth : 0.f;
    const float light = weight * (red[l] * brush.red + green[l] * brush.green + blue[l] * brush.blue + depth_part);
    const float left = behind[l] - light;
    behind[l] = left;
    const float moved = light - left * alpha / (1.f - alpha);
    const bool moves = drawn & (whole <= limits.alpha_max);
    const float h = moves ? moved : 0.f;
    const float hu = h * u, hv = h * v;
    lanes.sum[SUM_H][l] += h;
    lanes.sum[SUM_HU][l] += hu;
    lanes.sum[SUM_HV][l] += hv;
    lanes.sum[SUM_HUU][l] += hu * u;
    lanes.sum[SUM_HUV][l] += hu * v;
    lanes.sum[SUM_HVV][l] += hv * v;
    lanes.sum[SUM_RED][l] += weight * red[l];
    lanes.sum[SUM_GREEN][l] += weight * green[l];
    lanes.sum[SUM_BLUE][l] += weight * blue[l];
    if (Keeps::OF_DEPTHS) lanes.sum[SUM_DEPTH][l] += weight * by_depth[l];
    if (Keeps::OF_ERRORS) lanes.sum[SUM_WEIGHT][l] += weight, lanes.sum[SUM_ERROR][l] += weight * error[l];
  }
}

// The sums of the lanes, four sums at a time, always in the same order.
void sum_lanes(const Lanes& lanes, float* sums) {
  for (int k = 0; k < NUM_SUMS; k += 4) {
    Quad row[4];
    for (int j = 0; j < 4; ++j) {
      const float* lane = lanes.sum[k + j];
      row[j] = (load_quad(lane) + load_quad(lane + 8)) + (load_quad(lane + 4) + load_quad(lane + 12));
    }
    transpose(row[0], row[1], row[2], row[3]);
    store_quad(sums + k, (row[0] + row[2]) + (row[1] + row[3]));
  }
}

template <class Keeps>
void backward_tile(const BlendBackwardJob& job, const PairSums& pairs, int64_t index) {
  const int64_t begin = job.tile_start[index], end = job.tile_start[index + 1];
  if (begin == end) return;
  memset(pairs.touched + begin, 0, end - begin);
  const int x0 = int(index % job.num_tiles_x) * TILE, y0 = int(index / job.num_tiles_x) * TILE;
  Tile tile;
  load_tile(job, x0, y0, tile);
  const Limits limits = {unknown(ALPHA_MAX), unknown(0.f), 0.f};
  int open = open_cells(tile.transmittance);
  for (int64_t i = begin; i < end; ++i) {
    if ((i - begin + 1) % PERIOD == 0) {
      open = open_cells(tile.transmittance);
      if (!open) break;
    }
    if (i + AHEAD < end) __builtin_prefetch(job.records + int64_t(job.splat_from_pair[i + AHEAD]) * NUM_COLUMNS);
    Brush brush;
    const float* record = job.records + int64_t(job.splat_from_pair[i]) * NUM_COLUMNS;
    int left = load_brush(record, x0, y0, job.log2_threshold, limits, brush) & open;
    if (!left) continue;
    Lanes lanes;
    memset(&lanes, 0, sizeof lanes);
    for (; left; left &= left - 1) backward_cell<Keeps>(brush, __builtin_ctz(left), limits, tile, lanes);
    sum_lanes(lanes, pairs.sums + i * NUM_SUMS);
    pairs.touched[i] = 1;
  }
}

template <class Keeps>
void backward_all(const BlendBackwardJob& job, const PairSums& pairs) {
  parallel_chunks(int64_t(job.num_tiles_x) * job.num_tiles_y, job.threads,
                  [&](int64_t index) { backward_tile<Keeps>(job, pairs, index); });
}

}  // namespace

void blend_backward(const BlendBackwardJob& job, const PairSums& pairs) {
  if (job.errors)
    job.by_depth ? backward_all<WithBoth>(job, pairs) : backward_all<WithErrors>(job, pairs);
  else
    job.by_depth ? backward_all<WithDepths>(job, pairs) : backward_all<Plain>(job, pairs);
}

}  // namespace splatree::SPLATREE_ISA
