// The sums of each splat from those of its pairs: a list of pairs for each splat, in the order of the tiles, then one splat at a
// time. The order of the additions is that of the tiles, whatever the threads.
#include <vector>

#include "cpu/frame/blend_backward.h"
#include "cpu/runtime/pool.h"
#include "cpu/runtime/scratch.h"

namespace splatree {

void sum_pairs(const BlendBackwardJob& job, const PairSums& pairs) {
  const int64_t num_pairs = job.tile_start[int64_t(job.num_tiles_x) * job.num_tiles_y];
  std::vector<uint32_t> start(job.num_splats + 1, 0);
  for (int64_t i = 0; i < num_pairs; ++i) start[job.splat_from_pair[i] + 1] += pairs.touched[i];
  for (int64_t s = 0; s < job.num_splats; ++s) start[s + 1] += start[s];
  const Scratch<uint32_t> pair_of = allocate<uint32_t>(start[job.num_splats]);
  {
    std::vector<uint32_t> next(start.begin(), start.end() - 1);
    for (int64_t i = 0; i < num_pairs; ++i)
      if (pairs.touched[i]) pair_of[next[job.splat_from_pair[i]]++] = uint32_t(i);
  }
  parallel_ranges(job.num_splats, 4096, job.threads, [&](int64_t begin, int64_t end) {
    for (int64_t s = begin; s < end; ++s) {
      float sum[NUM_SUMS] = {};
      for (uint32_t j = start[s]; j < start[s + 1]; ++j) {
        const float* of_pair = pairs.sums + int64_t(pair_of[j]) * NUM_SUMS;
        for (int k = 0; k < NUM_SUMS; ++k) sum[k] += of_pair[k];
      }
      for (int k = 0; k < 6; ++k) job.moments[6 * s + k] = sum[k];
      for (int k = 0; k < 3; ++k) job.colors[3 * s + k] = sum[SUM_RED + k];
      if (job.depths) job.depths[s] = sum[SUM_DEPTH];
      if (job.weights) job.weights[s] = sum[SUM_WEIGHT];
      if (job.error_sums) job.error_sums[s] = sum[SUM_ERROR];
    }
  });
}

}  // namespace splatree
