// Exclusive sums over an array in one pass (Merrill 2016, decoupled look-back).
//
// A thread block takes the next chunk by a ticket, sums it, publishes its sum, and adds up what the chunks before have published,
// from the nearest back to the first that knows the sum of everything before it. As chunks are taken in order, those before are
// done or at work: nobody waits for a thread block that has not started.
#pragma once
#include "cuda/device.h"

namespace splatree {
namespace {

constexpr int SCAN_THREADS = 256, SCAN_ITEMS = 16, SCAN_CHUNK = SCAN_THREADS * SCAN_ITEMS;
constexpr int NUM_SCANS = 2;  // of a frame: rows of the selection, pairs (kernels/cuda/plan.py)

// Words of a chain: what is known of a chunk, in the upper two bits, and a sum.
constexpr unsigned long long OWN_SUM = 1ull << 62, WHOLE_SUM = 2ull << 62, SUM_MASK = OWN_SUM - 1;

// The sum of all chunks before one; asked by the 32 lanes of a warp.
SPLATREE_FN unsigned long long sum_of_chunks_before(const FrameJob* job, long long chain, long long chunk) {
  unsigned long long sum = 0;
  for (long long nearest = chunk - 1; nearest >= 0; nearest -= WARP) {
    const long long mine = nearest - lane_of();
    unsigned long long word = WHOLE_SUM;
    do {
      if (mine >= 0) word = read_published(&job->chains[chain + mine]);
    } while (__any_sync(ALL_LANES, word < OWN_SUM));
    const unsigned whole = __ballot_sync(ALL_LANES, word >= WHOLE_SUM);
    const int last = whole ? __ffs(whole) - 1 : WARP - 1;
    unsigned long long part = lane_of() <= last ? word & SUM_MASK : 0;
    for (int step = WARP / 2; step; step /= 2) part += __shfl_xor_sync(ALL_LANES, part, step);
    sum += part;
    if (whole) break;
  }
  return sum;
}

// The chunk that a thread block takes next.
SPLATREE_FN long long take_chunk(const FrameJob* job, int which) {
  SPLATREE_SHARED(long long, chunk_of_thread_block, 1);
  if (threadIdx.x == 0) chunk_of_thread_block[0] = atomicAdd(&job->tickets[which], 1u);
  __syncthreads();
  return chunk_of_thread_block[0];
}

// The sum of everything before a warp, which brings its own sum; asked by all warps of a thread block of SCAN_THREADS. The last
// chunk leaves the sum of all in a counter, if one is named.
SPLATREE_FN unsigned sum_before_warp(const FrameJob* job, int which, long long chunk, unsigned of_warp, bool is_last,
                                     int counter) {
  SPLATREE_SHARED(unsigned, warp_sums, SCAN_THREADS / WARP);
  SPLATREE_SHARED(unsigned long long, sum_before_chunk, 1);
  const long long chain = which * job->chain_stride;
  if (lane_of() == 0) warp_sums[warp_of()] = of_warp;
  __syncthreads();
  if (warp_of() == 0) {
    unsigned total;
    const int warp = lane_of();
    sum_before(warp < SCAN_THREADS / WARP ? warp_sums[warp] : 0u, total);
    if (warp == 0) publish(&job->chains[chain + chunk], (chunk ? OWN_SUM : WHOLE_SUM) | total);
    const unsigned long long earlier = sum_of_chunks_before(job, chain, chunk);
    if (warp == 0) {
      if (chunk) publish(&job->chains[chain + chunk], WHOLE_SUM | (earlier + total));
      sum_before_chunk[0] = earlier;
      if (counter >= 0 && is_last) job->counters[counter] = earlier + total;
    }
  }
  __syncthreads();
  unsigned sum = (unsigned)sum_before_chunk[0];
  for (int warp = 0; warp < warp_of(); ++warp) sum += warp_sums[warp];
  return sum;
}

// Calls store(i, sum of load(j) over j < i) for each i < count, and leaves the sum of all in a counter, if one is named. Run by
// thread blocks of SCAN_THREADS, at least one for each SCAN_CHUNK of count.
template <class Load, class Store>
SPLATREE_FN void scan(const FrameJob* job, int which, long long count, int counter, const Load& load, const Store& store) {
  const long long chunk = take_chunk(job, which);
  if (chunk * SCAN_CHUNK >= count) return;
  // Warp by warp, so that neighbours read neighbours: lane l takes items l, l + 32, ... of its warp's part.
  const long long begin = chunk * SCAN_CHUNK + warp_of() * (WARP * SCAN_ITEMS) + lane_of();
  unsigned before[SCAN_ITEMS], sum = 0;
#pragma unroll
  for (int i = 0; i < SCAN_ITEMS; ++i) {
    const long long at = begin + i * WARP;
    unsigned total;
    before[i] = sum + sum_before(at < count ? load(at) : 0u, total);
    sum += total;
  }
  const unsigned first = sum_before_warp(job, which, chunk, sum, (chunk + 1) * SCAN_CHUNK >= count, counter);
#pragma unroll
  for (int i = 0; i < SCAN_ITEMS; ++i)
    if (begin + i * WARP < count) store(begin + i * WARP, first + before[i]);
}

}  // namespace
}  // namespace splatree
