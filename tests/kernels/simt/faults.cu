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

// Waits for a thread block that may not have started.
SPLATREE_KERNEL(64, 1) wait_for_the_next_block(const FrameJob* job, int) {
  if (threadIdx.x == 0) publish(&job->chains[blockIdx.x], 1);
  if (blockIdx.x + 1 == gridDim.x) return;
  while (__any_sync(ALL_LANES, !read_published(&job->chains[blockIdx.x + 1]))) {
  }
}

// Takes what the thread block before has published without waiting for it.
SPLATREE_KERNEL(64, 1) chain_without_waiting(const FrameJob* job, int waits) {
  SPLATREE_SHARED(int, own, 1);
  if (threadIdx.x == 0) own[0] = (int)atomicAdd(&job->tickets[0], 1u);
  __syncthreads();
  const int chunk = own[0];
  unsigned long long before = 0;
  if (chunk) do
      before = read_published(&job->chains[chunk - 1]);
    while (__any_sync(ALL_LANES, waits && !before));
  if (threadIdx.x == 0) publish(&job->chains[chunk], before + 1);
}

// How many thread blocks are at work at once.
SPLATREE_KERNEL(64, 1) count_resident_blocks(const FrameJob* job, int) {
  if (threadIdx.x == 0) {
    const unsigned started = atomicAdd(&job->tickets[0], 1u) + 1;
    atomicMax(&job->tickets[2], started - atomicAdd(&job->tickets[1], 0u));
  }
  for (int i = 0; i < 50; ++i) __syncthreads();
  if (threadIdx.x == 0) atomicAdd(&job->tickets[1], 1u);
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
