// What all kernels use: their arrays, their threads, and sums over a warp or a thread block.
//
// Device code is compiled by NVRTC, which has no C++ library, and for tests by a C++ compiler with an emulation of the thread
// model (tests/kernels/simt/simt.h), which checks every access to the arrays and to shared memory.
#pragma once

#define SPLATREE_DEVICE

#ifdef SPLATREE_EMULATOR
#include "simt.h"
#else
namespace splatree {

// An array in device memory.
template <class T>
using Global = T*;

}  // namespace splatree

// An array that the threads of a thread block share.
#define SPLATREE_SHARED(type, name, size) __shared__ type name[size]
// A kernel of so many threads a thread block, of which a multiprocessor is to hold so many at least: that bounds the registers.
// With 1 the assembler takes what it likes; more is asked for where it can be had without a spill.
#define SPLATREE_KERNEL(threads, thread_blocks) extern "C" __global__ void __launch_bounds__(threads, thread_blocks)

// A word that other thread blocks wait for: written and read past the first-level cache.
static __device__ __forceinline__ void publish(unsigned long long* word, unsigned long long value) {
  __threadfence();
  atomicExch(word, value);
}

static __device__ __forceinline__ unsigned long long read_published(const unsigned long long* word) {
  return *(const volatile unsigned long long*)word;
}

// Four numbers at once; their place is a multiple of four.
static __device__ __forceinline__ float4 load_four(const float* column, long long at) { return *(const float4*)(column + at); }
#endif

#include "cuda/job.h"

namespace splatree {
namespace {

constexpr unsigned ALL_LANES = 0xffffffffu;
constexpr unsigned NOT_VISIBLE = 0xffffffffu;  // in the place of a depth, behind all others
constexpr int WARP = 32;

SPLATREE_FN int lane_of() { return threadIdx.x % WARP; }
SPLATREE_FN int warp_of() { return threadIdx.x / WARP; }
SPLATREE_FN unsigned lanes_before() { return (1u << lane_of()) - 1; }

SPLATREE_FN int smaller(int a, int b) { return a < b ? a : b; }
SPLATREE_FN int larger(int a, int b) { return a > b ? a : b; }
SPLATREE_FN long long held(unsigned long long count, long long capacity) {
  return count < (unsigned long long)capacity ? (long long)count : capacity;
}

// The row, or the pair, of each thread of a grid that covers a capacity.
SPLATREE_FN long long index_of_thread() { return (long long)blockIdx.x * blockDim.x + threadIdx.x; }

// Exclusive sums of a value over the lanes; `total` is that of the warp.
SPLATREE_FN unsigned sum_before(unsigned value, unsigned& total) {
  unsigned sum = value;
  for (int step = 1; step < WARP; step *= 2) {
    const unsigned below = __shfl_up_sync(ALL_LANES, sum, step);
    if (lane_of() >= step) sum += below;
  }
  total = __shfl_sync(ALL_LANES, sum, WARP - 1);
  return sum - value;
}

// The largest value of the lanes before each, at least `first`; `largest` is that of the warp.
SPLATREE_FN int max_before(int value, int first, int& largest) {
  int most = value;
  for (int step = 1; step < WARP; step *= 2) {
    const int below = __shfl_up_sync(ALL_LANES, most, step);
    if (lane_of() >= step) most = larger(most, below);
  }
  largest = larger(__shfl_sync(ALL_LANES, most, WARP - 1), first);
  const int below = __shfl_up_sync(ALL_LANES, most, 1);
  return lane_of() ? larger(below, first) : first;
}

SPLATREE_FN int largest_of_warp(int value) {
  for (int step = WARP / 2; step; step /= 2) value = larger(value, __shfl_xor_sync(ALL_LANES, value, step));
  return value;
}

template <class T>
SPLATREE_FN T sum_of_warp(T value) {
  for (int step = WARP / 2; step; step /= 2) value += __shfl_xor_sync(ALL_LANES, value, step);
  return value;
}

// Hands half of 2 HALF values to another lane, and adds what it hands over of the half that is kept.
template <int HALF>
SPLATREE_FN void halve(float (&values)[16]) {
  const bool upper = lane_of() & 2 * HALF;
#pragma unroll
  for (int k = 0; k < HALF; ++k) {
    const float sent = upper ? values[k] : values[k + HALF], kept = upper ? values[k + HALF] : values[k];
    values[k] = kept + __shfl_xor_sync(ALL_LANES, sent, 2 * HALF);
  }
}

// Sums of 16 values over the lanes of a warp: lane l gets the sum of value l / 2. 16 shuffles instead of 80, always in the same
// order.
SPLATREE_FN float sums_of_warp(float (&values)[16]) {
  halve<8>(values), halve<4>(values), halve<2>(values), halve<1>(values);
  return values[0] + __shfl_xor_sync(ALL_LANES, values[0], 1);
}

// The place of the first key that is not below `key`, among sorted ones.
template <class Key>
SPLATREE_FN long long place_of_key(Global<Key> keys, long long count, long long key) {
  long long low = 0, high = count;
  while (low < high) {
    const long long middle = (low + high) / 2;
    if (keys[middle] < key)
      low = middle + 1;
    else
      high = middle;
  }
  return low;
}

// Adds a count of the lanes to a counter, with one access a warp.
SPLATREE_FN void count_lanes(const FrameJob* job, int counter, bool counted) {
  const unsigned lanes = __ballot_sync(ALL_LANES, counted);
  if (lane_of() == 0 && lanes) atomicAdd(&job->counters[counter], (unsigned long long)__popc(lanes));
}

}  // namespace
}  // namespace splatree
