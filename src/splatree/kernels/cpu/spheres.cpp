// Radii of clusters; kernels/reference/spheres.py is the definition. One pass over the rows, 16 at a time; what float32 may lose is
// added at the end.
#include "cpu/clusters.h"

#include "cpu/isa.h"
#include "shared/elementary.h"

namespace splatree::SPLATREE_ISA {
namespace {

constexpr int LANES = 16;
constexpr float LOG2_THRESHOLD = -7.99435344f;  // log2(1/255)
constexpr float LOGIT_MIN = -5.5383342f;        // of 1/255, less 1e-3 for the rounding of any sigmoid
constexpr float UPWARDS = 1.00002f;             // the exponential loses 5e-6 at the ends of its range
constexpr float SLACK = 1e-5f;                  // of k², for the rounding of any logarithm

struct alignas(64) Planes {
  float mean[3][LANES], log_scale[LANES], logit[LANES];
  float radius[LANES], distance[LANES], footprint[LANES];
};

}  // namespace

void bound_spheres(const SpheresJob& job, int64_t begin, int64_t end) {
  Planes p;
  for (int64_t j = begin; j < end; ++j) {
    const float* center = job.centers + 3 * j;
    const float x = center[0], y = center[1], z = center[2];
    for (int l = 0; l < LANES; ++l) p.radius[l] = p.distance[l] = p.footprint[l] = 0;
    for (int32_t first = job.start[j]; first < job.start[j + 1]; first += LANES) {
      for (int l = 0; l < LANES; ++l) {
        const int64_t row = first + l < job.start[j + 1] ? first + l : job.start[j + 1] - 1;  // the last is repeated
        const float* s = job.log_scales + 3 * row;
        for (int i = 0; i < 3; ++i) p.mean[i][l] = job.means[3 * row + i];
        p.log_scale[l] = greatest(greatest(s[0], s[1]), s[2]);
        p.logit[l] = job.logit_opacities[row];
      }
#pragma omp simd
      for (int l = 0; l < LANES; ++l) {
        const float dx = p.mean[0][l] - x, dy = p.mean[1][l] - y, dz = p.mean[2][l] - z;
        const float distance = __builtin_sqrtf(dx * dx + dy * dy + dz * dz);
        const float sigma = exp_of(p.log_scale[l]);
        const float log2_opacity = -log2_of(1.f + exp_of(-p.logit[l]));
        const float reach = __builtin_sqrtf(1.38629436f * greatest(log2_opacity - LOG2_THRESHOLD, 0.f) + SLACK);
        const float footprint = p.logit[l] >= LOGIT_MIN ? distance + reach * sigma : 0.f;
        p.radius[l] = greatest(distance + 3.f * sigma, p.radius[l]);  // NaN is never drawn and passed over
        p.distance[l] = greatest(distance, p.distance[l]);
        p.footprint[l] = greatest(footprint, p.footprint[l]);
      }
    }
    float radius = 0, distance = 0, footprint = 0;
    for (int l = 0; l < LANES; ++l) {
      radius = greatest(p.radius[l], radius);
      distance = greatest(p.distance[l], distance);
      footprint = greatest(p.footprint[l], footprint);
    }
    job.radii[j] = radius * UPWARDS, job.mean_radii[j] = distance * UPWARDS, job.footprint_radii[j] = footprint * UPWARDS;
  }
}

}  // namespace splatree::SPLATREE_ISA
