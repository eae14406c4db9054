// Inner products, 16 lanes at a time: the scores of four points against all blocks of centres, and coordinates along axes.
//
// A block of d dimensions costs 4 · 16 · d multiply-adds for 16 · d loads; the comparison comes once a block.
#include "cpu/scores.h"

#include "cpu/isa.h"

namespace splatree::SPLATREE_ISA {

// Of equal scores in a lane the first block's counts.
void nearest_lanes(const Centres& centres, const float* const* points, LaneMinima* minima) {
  const int64_t dims = centres.dims;
  for (int64_t p = 0; p < kPointsAtOnce; ++p)
    for (int64_t l = 0; l < kLanes; ++l) {
      minima->score[p][l] = __builtin_inff();
      minima->block[p][l] = 0;
    }
  const float *p0 = points[0], *p1 = points[1], *p2 = points[2], *p3 = points[3];
  for (int64_t b = 0; b < centres.num_blocks; ++b) {
    const float* block = centres.blocks + b * (dims + 1) * kLanes;
    const float* half_norms = block + dims * kLanes;
    float s0[kLanes], s1[kLanes], s2[kLanes], s3[kLanes];
#pragma omp simd
    for (int64_t l = 0; l < kLanes; ++l) s0[l] = s1[l] = s2[l] = s3[l] = half_norms[l];
    for (int64_t d = 0; d < dims; ++d) {
      const float* c = block + d * kLanes;
      const float x0 = p0[d], x1 = p1[d], x2 = p2[d], x3 = p3[d];
#pragma omp simd
      for (int64_t l = 0; l < kLanes; ++l) {
        s0[l] -= x0 * c[l];
        s1[l] -= x1 * c[l];
        s2[l] -= x2 * c[l];
        s3[l] -= x3 * c[l];
      }
    }
    const float* scores[kPointsAtOnce] = {s0, s1, s2, s3};
    for (int64_t p = 0; p < kPointsAtOnce; ++p) {
      const float* s = scores[p];
      float* best = minima->score[p];
      int32_t* best_block = minima->block[p];
#pragma omp simd
      for (int64_t l = 0; l < kLanes; ++l) {
        const bool nearer = s[l] < best[l];
        best[l] = nearer ? s[l] : best[l];
        best_block[l] = nearer ? int32_t(b) : best_block[l];
      }
    }
  }
}

void onto_axes(const AxesJob& job, int64_t begin, int64_t end) {
  const int64_t padded = (job.dims + kLanes - 1) / kLanes * kLanes;
  for (int64_t i = begin; i < end; ++i) {
    const float* vector = job.vectors + i * job.stride;
    for (int64_t first = 0; first < job.dims; first += kLanes) {
      float sums[kLanes] = {};
      for (int64_t j = 0; j < job.width; ++j) {
        const float x = vector[j] - job.origin[j];
        const float* axis = job.axes + j * padded + first;
#pragma omp simd
        for (int64_t l = 0; l < kLanes; ++l) sums[l] += x * axis[l];
      }
      float* out = job.out + i * job.dims + first;
      const int64_t count = job.dims - first < kLanes ? job.dims - first : kLanes;
      for (int64_t l = 0; l < count; ++l) out[l] = sums[l];
    }
  }
}

}  // namespace splatree::SPLATREE_ISA
