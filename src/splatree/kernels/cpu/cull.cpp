// Which spheres can be seen; kernels/reference/cull.py is the definition. Float64, so that only the drawing's own rounding needs a
// margin.
#include "cpu/clusters.h"

#include "cpu/isa.h"

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
      const double away = __builtin_fabs(x[l] - job.eye[0]) + __builtin_fabs(y[l] - job.eye[1]) + __builtin_fabs(z[l] - job.eye[2]);
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

}  // namespace splatree::SPLATREE_ISA
