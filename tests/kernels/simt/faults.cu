// What the emulator has to find: each kernel has one fault.
#include "cuda/device.h"

using namespace splatree;

SPLATREE_KERNEL(64, 1) index_behind_the_end(const FrameJob* job, int) { job->alpha[job->num_rows + threadIdx.x] = 0; }

SPLATREE_KERNEL(64, 1) read_of_nothing(const FrameJob* job, int) {
  const float value = job->depth[threadIdx.x];
  job->alpha[threadIdx.x] = value;
}

SPLATREE_KERNEL(64, 1) read_of_another_threads_word(const FrameJob* job, int) {
  SPLATREE_SHARED(float, cells, 64);
  cells[threadIdx.x] = float(threadIdx.x);
  job->alpha[threadIdx.x] = cells[threadIdx.x ^ 1];  // wants a barrier before
}

SPLATREE_KERNEL(64, 1) warp_barrier_for_a_block(const FrameJob* job, int) {
  SPLATREE_SHARED(float, cells, 64);
  cells[threadIdx.x] = float(threadIdx.x);
  __syncwarp();
  job->alpha[threadIdx.x] = cells[threadIdx.x ^ 32];  // of the other warp
}

SPLATREE_KERNEL(64, 1) two_writers(const FrameJob* job, int) { job->alpha[threadIdx.x / 2] = float(threadIdx.x); }

SPLATREE_KERNEL(64, 1) blocks_that_share_a_word(const FrameJob* job, int) {
  if (threadIdx.x == 0) job->alpha[0] = float(blockIdx.x);
}

SPLATREE_KERNEL(64, 1) barrier_of_a_few(const FrameJob*, int) {
  if (threadIdx.x < 10) __syncthreads();
}

SPLATREE_KERNEL(64, 1) vote_of_a_few(const FrameJob*, int) {
  if (threadIdx.x % 32 < 10) __ballot_sync(ALL_LANES, 1);
}

SPLATREE_KERNEL(64, 1) no_fault(const FrameJob* job, int) {
  SPLATREE_SHARED(float, cells, 64);
  cells[threadIdx.x] = float(threadIdx.x);
  __syncthreads();
  const float value = cells[threadIdx.x ^ 32];
  __syncthreads();
  cells[threadIdx.x] = value;
  if (blockIdx.x == 0) job->alpha[threadIdx.x] = cells[threadIdx.x];
  atomicAdd(&job->counters[0], 1ull);
}
