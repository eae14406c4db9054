// Which spheres or boxes can be seen; kernels/reference/cull.py is the definition. Float64, so that only the drawing's own
// rounding needs a margin.
#include "cpu/frame/cull.h"

#include "cpu/runtime/isa.h"

namespace splatree::SPLATREE_ISA {
namespace {

constexpr int LANES = 16;

}  // namespace

void cull_spheres(const CullJob& job, int64_t begin, int64_t end) {
  alignas(64) double x[LANES], y[LANES], z[LANES], radius[LANES], near_radius[LANES];
  alignas(64) int64_t kept[LANES];
  for (int64_t first = begin; first < end; first += LANES) {
    for (int l = 0; l < LANES; ++l) {
      const int64_t j = first + l < end ? first + l : end - 1;
      x[l] = job.centers[3 * j], y[l] = job.centers[3 * j + 1], z[l] = job.centers[3 * j + 2];
      radius[l] = job.radii[j], near_radius[l] = job.near_radii[j];
    }
#pragma omp simd
    for (int l = 0; l < LANES; ++l) {
      const double away =
          __builtin_fabs(x[l] - job.eye[0]) + __builtin_fabs(y[l] - job.eye[1]) + __builtin_fabs(z[l] - job.eye[2]);
      const double added = job.slack * away + job.margin;
      const double used = job.scale * radius[l] + added;
      int64_t outside = 0;
      for (int s = 0; s < CULL_SIDES - 1; ++s) {
        const double* n = job.plane[s];
        outside |= n[0] * x[l] + n[1] * y[l] + n[2] * z[l] + n[3] > job.reach[s] * used;
      }
      const double* n = job.plane[CULL_SIDES - 1];
      const double behind = n[0] * x[l] + n[1] * y[l] + n[2] * z[l] + n[3];
      outside |= behind > job.reach[CULL_SIDES - 1] * (job.scale * near_radius[l] + added);
      kept[l] = (1 - outside) | (job.guard & (__builtin_fabs(behind) <= radius[l]));
    }
    for (int l = 0; l < LANES && first + l < end; ++l) job.kept[first + l] = uint8_t(kept[l]);
  }
}

void cull_boxes(const CullBoxesJob& job, int64_t begin, int64_t end) {
  alignas(64) double low[3][LANES], high[3][LANES];
  alignas(64) int64_t kept[LANES];
  for (int64_t first = begin; first < end; first += LANES) {
    for (int l = 0; l < LANES; ++l) {
      const int64_t j = first + l < end ? first + l : end - 1;
      for (int i = 0; i < 3; ++i) low[i][l] = job.low[3 * j + i], high[i][l] = job.high[3 * j + i];
    }
#pragma omp simd
    for (int l = 0; l < LANES; ++l) {
      const double x = 0.5 * (low[0][l] + high[0][l]), half_x = 0.5 * (high[0][l] - low[0][l]);
      const double y = 0.5 * (low[1][l] + high[1][l]), half_y = 0.5 * (high[1][l] - low[1][l]);
      const double z = 0.5 * (low[2][l] + high[2][l]), half_z = 0.5 * (high[2][l] - low[2][l]);
      const double away = __builtin_fabs(x - job.eye[0]) + __builtin_fabs(y - job.eye[1]) + __builtin_fabs(z - job.eye[2]);
      const double added = job.slack * away + job.margin;
      int64_t outside = 0;
      for (int s = 0; s < CULL_SIDES; ++s) {
        const double *n = job.plane[s], *reach = job.box_reach[s];
        const double used = reach[0] * half_x + reach[1] * half_y + reach[2] * half_z + job.reach[s] * added;
        outside |= n[0] * x + n[1] * y + n[2] * z + n[3] > used;  // false for NaN: an infinite box is kept
      }
      kept[l] = 1 - outside;
    }
    for (int l = 0; l < LANES && first + l < end; ++l) job.kept[first + l] = uint8_t(kept[l]);
  }
}

}  // namespace splatree::SPLATREE_ISA
