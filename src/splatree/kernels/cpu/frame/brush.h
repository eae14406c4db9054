// A splat as the loops over the pixels of a tile take it. A tile of 16 × 16 px is 16 cells of 4 × 4 px; a lane is a pixel of a
// cell.
#pragma once
#include "shared/constants.h"
#include "shared/elementary.h"
#include "shared/record.h"

namespace splatree {
namespace {

constexpr int TILE = 16, CELLS = 16, LANES = 16;
constexpr int PERIOD = 32;  // pairs between looks for finished cells
constexpr float ALPHA_MAX = float(constants::ALPHA_MAX), TRANSMITTANCE_MIN = float(constants::TRANSMITTANCE_MIN);
constexpr float SQRT_HALF_LOG2E = 0.849321800f;  // √(½ log2 e): exp(-½ q²) = 2^-(this q)²

// What one splat needs, in units in which the exponent is a power of 2.
struct alignas(64) Brush {
  float u_of_lane[LANES], v_of_lane[LANES];  // from the centre of a cell
  float u_of_cell[CELLS], v_of_cell[CELLS];  // of the centre of each cell
  float log2_opacity, log2_threshold;
  float red, green, blue, depth;
  float floor;                // opacity that is tapered to 1/255
  float contribution[LANES];  // Σ α T over the cells
};

// A number that the compiler does not know. Of a minimum with a constant GCC makes a comparison and a blend.
float unknown(float x) {
  asm("" : "+m"(x));
  return x;
}

struct Limits {
  float alpha_max, zero, least_light;
};

// Sets up the brush for a tile at (x, y) and returns a bit for each cell that the splat may touch.
SPLATREE_FN int load_brush(const float* record, float x, float y, float log2_threshold, const Limits& limits, Brush& brush) {
  const float a = SQRT_HALF_LOG2E * record[FACTOR_A], b = SQRT_HALF_LOG2E * record[FACTOR_B];
  const float c = SQRT_HALF_LOG2E * record[FACTOR_C];
  brush.log2_opacity = record[LOG2_OPACITY];
  brush.log2_threshold = log2_threshold;
  brush.red = record[RED], brush.green = record[GREEN], brush.blue = record[BLUE], brush.depth = record[DEPTH];

  const float abs_b = __builtin_fabsf(b);
  // |u| and |v| are at least those of the cell's centre less these; the second terms are what float32 may lose.
  const float u_reach = 1.5f * (a + abs_b) + 2e-6f * (a * (record[HALF_SIZE_X] + 16) + abs_b * (record[HALF_SIZE_Y] + 16));
  const float v_reach = 1.5f * c + 2e-6f * c * (record[HALF_SIZE_Y] + 16);
  const float limit = (record[LOG2_OPACITY] - log2_threshold) * (1 + 1e-5f) + 1e-5f;
  const float x_reach = record[HALF_SIZE_X] * (1 + 1e-5f) + 1.501f;
  const float offset_x = x + 2 - record[X], offset_y = y + 2 - record[Y];
  int touched = 0;
#pragma omp simd reduction(| : touched)
  for (int l = 0; l < LANES; ++l) {
    const float column = l & 3, row = l >> 2;
    brush.u_of_lane[l] = a * (column - 1.5f) + b * (row - 1.5f);
    brush.v_of_lane[l] = c * (row - 1.5f);
    const float dx = 4 * column + offset_x, dy = 4 * row + offset_y;
    const float u = a * dx + b * dy, v = c * dy;
    brush.u_of_cell[l] = u;
    brush.v_of_cell[l] = v;
    const float u_least = greatest(__builtin_fabsf(u) - u_reach, limits.zero);
    const float v_least = greatest(__builtin_fabsf(v) - v_reach, limits.zero);
    const bool touches = (u_least * u_least + v_least * v_least <= limit) & (__builtin_fabsf(dx) <= x_reach);
    touched |= touches ? 1 << l : 0;
  }
  return touched;
}

// The cells in which a pixel can still take light; the transmittance of a finished pixel has a minus sign.
SPLATREE_FN int open_cells(const float (&transmittance)[CELLS][LANES]) {
  int open = 0;
  for (int cell = 0; cell < CELLS; ++cell) {
    int any = 0;
#pragma omp simd reduction(| : any)
    for (int l = 0; l < LANES; ++l) any |= transmittance[cell][l] > 0.f ? 1 : 0;
    open |= any << cell;
  }
  return open;
}

}  // namespace
}  // namespace splatree
