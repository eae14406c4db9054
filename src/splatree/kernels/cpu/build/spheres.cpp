// Spheres and boxes of clusters; kernels/reference/spheres.py is the definition. One pass over the rows, 16 at a time; what
// float32 may lose is added at the end.
#include "cpu/build/clusters.h"
#include "cpu/runtime/isa.h"
#include "shared/constants.h"
#include "shared/project.h"

namespace splatree::SPLATREE_ISA {
namespace {

constexpr int LANES = 16;
constexpr float LOG2_THRESHOLD = float(constants::LOG2_ALPHA_THRESHOLD);
constexpr float LOGIT_MIN = -5.5383342f;  // of 1/255, less 1e-3 for the rounding of any sigmoid
constexpr float UPWARDS = 1.00002f;       // the exponential loses 5e-6 at the ends of its range
constexpr float SLACK = 1e-5f;            // of k², for the rounding of any logarithm
constexpr float OUTWARDS = 2.4e-7f;       // of a coordinate: two roundings of it, each 6e-8, and as much again

struct alignas(64) Planes {
  float mean[3][LANES], quat[4][LANES], log_scale[3][LANES], logit[LANES];
  float radius[LANES], distance[LANES], footprint[LANES], low[3][LANES], high[3][LANES];
  float reach[LANES], scale[3][LANES], spread[3][LANES];  // reach: k, below 0 for rows that are never drawn
};

// Standard deviations along the world's axes: lengths of the rows of R S.
SPLATREE_FN Vector sigmas_of(float qw, float qx, float qy, float qz, Vector scale) {
  const Factor xy = factor_of(Vector{1, 0, 0}, Vector{0, 1, 0}, qw, qx, qy, qz, scale);
  const Factor zz = factor_of(Vector{0, 0, 1}, Vector{0, 0, 1}, qw, qx, qy, qz, scale);
  return {__builtin_sqrtf(dot(xy.x, xy.x)), __builtin_sqrtf(dot(xy.y, xy.y)), __builtin_sqrtf(dot(zz.x, zz.x))};
}

}  // namespace

void bound_spheres(const SpheresJob& job, int64_t begin, int64_t end) {
  Planes p;
  for (int64_t j = begin; j < end; ++j) {
    const float* center = job.centers + 3 * j;
    const float x = center[0], y = center[1], z = center[2];
    for (int l = 0; l < LANES; ++l) {
      p.radius[l] = p.distance[l] = p.footprint[l] = 0;
      for (int i = 0; i < 3; ++i) p.low[i][l] = p.high[i][l] = center[i];
    }
    for (int32_t first = job.start[j]; first < job.start[j + 1]; first += LANES) {
      for (int l = 0; l < LANES; ++l) {
        const int64_t row = first + l < job.start[j + 1] ? first + l : job.start[j + 1] - 1;  // the last is repeated
        for (int i = 0; i < 3; ++i) p.mean[i][l] = job.means[3 * row + i], p.log_scale[i][l] = job.log_scales[3 * row + i];
        for (int i = 0; i < 4; ++i) p.quat[i][l] = job.quats[4 * row + i];
        p.logit[l] = job.logit_opacities[row];
      }
#pragma omp simd
      for (int l = 0; l < LANES; ++l) {
        const float dx = p.mean[0][l] - x, dy = p.mean[1][l] - y, dz = p.mean[2][l] - z;
        const float distance = __builtin_sqrtf(dx * dx + dy * dy + dz * dz);
        const float sx = exp_of(p.log_scale[0][l]), sy = exp_of(p.log_scale[1][l]), sz = exp_of(p.log_scale[2][l]);
        const float sigma = greatest(greatest(sx, sy), sz);
        const float log2_opacity = -log2_of(1.f + exp_of(-p.logit[l]));
        const float reach = __builtin_sqrtf(1.38629436f * greatest(log2_opacity - LOG2_THRESHOLD, 0.f) + SLACK);
        const bool drawn = p.logit[l] >= LOGIT_MIN;
        const float footprint = drawn ? distance + reach * sigma : 0.f;
        p.radius[l] = greatest(distance + 3.f * sigma, p.radius[l]);  // NaN is never drawn and passed over
        p.distance[l] = greatest(distance, p.distance[l]);
        p.footprint[l] = greatest(footprint, p.footprint[l]);
        p.reach[l] = drawn ? UPWARDS * reach : -1.f;
        p.scale[0][l] = sx, p.scale[1][l] = sy, p.scale[2][l] = sz;
      }
#pragma omp simd
      for (int l = 0; l < LANES; ++l) {
        const Vector sigma =
            sigmas_of(p.quat[0][l], p.quat[1][l], p.quat[2][l], p.quat[3][l], {p.scale[0][l], p.scale[1][l], p.scale[2][l]});
        p.spread[0][l] = p.reach[l] * sigma.x, p.spread[1][l] = p.reach[l] * sigma.y, p.spread[2][l] = p.reach[l] * sigma.z;
      }
      for (int i = 0; i < 3; ++i) {
#pragma omp simd
        for (int l = 0; l < LANES; ++l) {
          const float low = p.mean[i][l] - p.spread[i][l], high = p.mean[i][l] + p.spread[i][l];
          p.low[i][l] = p.reach[l] >= 0 ? least(low, p.low[i][l]) : p.low[i][l];
          p.high[i][l] = p.reach[l] >= 0 ? greatest(high, p.high[i][l]) : p.high[i][l];
        }
      }
    }
    float radius = 0, distance = 0, footprint = 0;
    for (int l = 0; l < LANES; ++l) {
      radius = greatest(p.radius[l], radius);
      distance = greatest(p.distance[l], distance);
      footprint = greatest(p.footprint[l], footprint);
    }
    job.radii[j] = radius * UPWARDS, job.mean_radii[j] = distance * UPWARDS, job.footprint_radii[j] = footprint * UPWARDS;
    for (int i = 0; i < 3; ++i) {
      float low = center[i], high = center[i];
      for (int l = 0; l < LANES; ++l) low = least(p.low[i][l], low), high = greatest(p.high[i][l], high);
      job.box_low[3 * j + i] = low - OUTWARDS * __builtin_fabsf(low);
      job.box_high[3 * j + i] = high + OUTWARDS * __builtin_fabsf(high);
    }
  }
}

}  // namespace splatree::SPLATREE_ISA
