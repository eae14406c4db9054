// Harmonics of a turned scene: 16 rows at a time are laid out as planes, so that each product of a matrix entry is one vector
// operation. Compiled for the baseline alone: loads and stores cost as much as the sums, and without fused multiply-add every
// processor gives the same bits.
#include "cpu/codec/rotate.h"

#include "cpu/runtime/pool.h"

namespace splatree {
namespace {

constexpr int LANES = 16;
constexpr int MAX_PLANES = 48;  // 16 coefficients of three channels
constexpr int64_t ROWS_PER_CHUNK = 4096;

// out = matrix · in for the 2l + 1 coefficients of one degree, for each channel and lane.
void apply(const float* matrix, int width, const float (*in)[LANES], float (*out)[LANES]) {
  for (int k = 0; k < width; ++k)
    for (int c = 0; c < 3; ++c) {
      float sum[LANES] = {};
      for (int j = 0; j < width; ++j) {
        const float entry = matrix[k * width + j];
        const float* plane = in[3 * j + c];
#pragma omp simd
        for (int i = 0; i < LANES; ++i) sum[i] += entry * plane[i];
      }
#pragma omp simd
      for (int i = 0; i < LANES; ++i) out[3 * k + c][i] = sum[i];
    }
}

}  // namespace

void rotate_harmonics(const float* in, int64_t num_rows, int degree, const float* matrices, float* out, int threads) {
  const int num_planes = 3 * (degree + 1) * (degree + 1);
  parallel_ranges(num_rows, ROWS_PER_CHUNK, threads, [&](int64_t begin, int64_t end) {
    for (int64_t first = begin; first < end; first += LANES) {
      const int count = static_cast<int>(end - first < LANES ? end - first : LANES);
      alignas(64) float from[MAX_PLANES][LANES] = {}, to[MAX_PLANES][LANES];
      for (int i = 0; i < count; ++i)
        for (int p = 0; p < num_planes; ++p) from[p][i] = in[(first + i) * num_planes + p];
      for (int c = 0; c < 3; ++c)
        for (int i = 0; i < LANES; ++i) to[c][i] = from[c][i];
      const float* matrix = matrices;
      for (int l = 1; l <= degree; ++l) {
        const int width = 2 * l + 1;
        apply(matrix, width, from + 3 * l * l, to + 3 * l * l);
        matrix += width * width;
      }
      for (int i = 0; i < count; ++i)
        for (int p = 0; p < num_planes; ++p) out[(first + i) * num_planes + p] = to[p][i];
    }
  });
}

}  // namespace splatree
