// A stable sort of keys with values, eight bits at a time from the lowest (radix sort): once for the depths of the splats, once
// for the tiles of the pairs.
//
// order_splats                splats in the order of their rows, with their depths as keys
// count_digits                256 threads a tile of 4096 keys: how many there are of each digit
// scan_digits                 where each tile's keys of each digit go: digit by digit, and tile by tile in a digit
// move_digits                 256 threads a tile: the keys go there; equal digits keep their order, by the ranks below
// count_digits_16, move_digits_16   the same for keys of 16 bits: tiles of a picture that has no more than 65,536
// keep_order                  a thread a splat: the order, kept before pairs are sorted; equal depths by id
//
// Equal depths are rare, so ids are not sorted: a splat counts the smaller ids among those of its depth. That costs the square of
// a run of equal depths: 10¹⁰ comparisons for 100,000 splats in one plane that is seen along its normal.
#include "cuda/scan.h"

namespace splatree {
namespace {

constexpr int THREADS = 256, ITEMS = 16, SORT_TILE = THREADS * ITEMS, DIGITS = 256;

// A pass of a sort; packed by kernels/cuda/plan.py.
struct Pass {
  int shift;    // of the digit
  int scan;     // number of the scan in the frame
  bool pairs;   // whether pairs are sorted, else splats
  bool from_b;  // which side the keys are on
};

SPLATREE_FN Pass pass_of(int packed) { return {packed & 31, packed >> 7 & 63, (packed >> 5 & 1) != 0, (packed >> 6 & 1) != 0}; }

SPLATREE_FN long long count_of(const FrameJob* job, const Pass& pass) {
  return pass.pairs ? held(job->counters[NUM_PAIRS], job->pair_capacity) : held(job->counters[NUM_SELECTED], job->row_capacity);
}

SPLATREE_FN long long tiles_of(long long count) { return (count + SORT_TILE - 1) / SORT_TILE; }

// The two sides of the keys.
template <class Key>
struct Sides {
  Global<Key> from, to;
};

template <class Key>
SPLATREE_FN Sides<Key> sides_of(const Pass& pass, Global<Key> a, Global<Key> b) {
  return pass.from_b ? Sides<Key>{b, a} : Sides<Key>{a, b};
}

// The keys of a lane, every 32nd from a place on: a warp takes 512 keys in a row, so that its rounds are in their order.
struct Part {
  long long begin;
  int left;  // places from there to the last key
};

SPLATREE_FN Part part_of_lane(long long count) {
  const long long begin = (long long)blockIdx.x * SORT_TILE + warp_of() * (WARP * ITEMS) + lane_of();
  return {begin, count - begin < SORT_TILE ? int(count - begin) : SORT_TILE};
}

template <class Key>
SPLATREE_FN void count_digits(const FrameJob* job, const Pass& pass, const Sides<Key>& keys) {
  SPLATREE_SHARED(unsigned, counts, DIGITS);
  const long long count = count_of(job, pass), num_tiles = tiles_of(count);
  if (blockIdx.x >= num_tiles) return;
  counts[threadIdx.x] = 0;
  __syncthreads();
  const Part part = part_of_lane(count);
  for (int i = 0; i < ITEMS; ++i)
    if (i * WARP < part.left) atomicAdd(&counts[keys.from[part.begin + i * WARP] >> pass.shift & (DIGITS - 1)], 1u);
  __syncthreads();
  job->digits[threadIdx.x * num_tiles + blockIdx.x] = counts[threadIdx.x];
}

template <class Key>
SPLATREE_FN void move_digits(const FrameJob* job, const Pass& pass, const Sides<Key>& keys) {
  SPLATREE_SHARED(unsigned, places, THREADS / WARP * DIGITS);  // of each warp and digit
  const long long count = count_of(job, pass), num_tiles = tiles_of(count);
  if (blockIdx.x >= num_tiles) return;
  const Sides<unsigned> values = sides_of(pass, job->values_a, job->values_b);
  const int own = warp_of() * DIGITS;
  for (int digit = lane_of(); digit < DIGITS; digit += WARP) places[own + digit] = 0;
  __syncwarp();

  // The rank of each key among those of its digit in the warp's part.
  const Part part = part_of_lane(count);
  unsigned short rank[ITEMS];
#pragma unroll
  for (int i = 0; i < ITEMS; ++i) {
    const bool there = i * WARP < part.left;
    const unsigned key = there ? keys.from[part.begin + i * WARP] : 0;
    const unsigned digit = key >> pass.shift & (DIGITS - 1);
    const unsigned peers = __match_any_sync(ALL_LANES, there ? digit : DIGITS);
    const unsigned earlier = there ? places[own + digit] : 0;
    __syncwarp();
    rank[i] = (unsigned short)(earlier + __popc(peers & lanes_before()));
    if (there && !(peers & lanes_before())) places[own + digit] = earlier + __popc(peers);
    __syncwarp();
  }
  __syncthreads();

  // Counts of the warps become places: thread d takes the digit d.
  unsigned next = job->digits[threadIdx.x * num_tiles + blockIdx.x];
  for (int warp = 0; warp < THREADS / WARP; ++warp) {
    const unsigned of_warp = places[warp * DIGITS + threadIdx.x];
    places[warp * DIGITS + threadIdx.x] = next;
    next += of_warp;
  }
  __syncthreads();
#pragma unroll
  for (int i = 0; i < ITEMS; ++i) {
    if (i * WARP >= part.left) continue;
    // Read again, from the cache: 16 keys and values would take 32 registers meanwhile.
    const unsigned key = keys.from[part.begin + i * WARP];
    const unsigned to = places[own + (key >> pass.shift & (DIGITS - 1))] + rank[i];
    keys.to[to] = Key(key);
    values.to[to] = values.from[part.begin + i * WARP];
  }
}

}  // namespace
}  // namespace splatree

using namespace splatree;

SPLATREE_KERNEL(256, 1) order_splats(const FrameJob* job) {
  const long long i = index_of_thread();
  if (i >= held(job->counters[NUM_SELECTED], job->row_capacity)) return;
  job->keys_a[i] = job->depth_keys[i];
  job->values_a[i] = (unsigned)i;
}

SPLATREE_KERNEL(256, 1) count_digits(const FrameJob* job, int packed) {
  const Pass pass = pass_of(packed);
  count_digits(job, pass, sides_of(pass, job->keys_a, job->keys_b));
}

SPLATREE_KERNEL(256, 1) count_digits_16(const FrameJob* job, int packed) {
  const Pass pass = pass_of(packed);
  count_digits(job, pass, sides_of(pass, job->tile_keys_a, job->tile_keys_b));
}

SPLATREE_KERNEL(256, 4) scan_digits(const FrameJob* job, int packed) {
  const Pass pass = pass_of(packed);
  scan(
      job, pass.scan, DIGITS * tiles_of(count_of(job, pass)), -1, [&](long long i) { return job->digits[i]; },
      [&](long long i, unsigned first) { job->digits[i] = first; });
}

SPLATREE_KERNEL(256, 4) move_digits(const FrameJob* job, int packed) {
  const Pass pass = pass_of(packed);
  move_digits(job, pass, sides_of(pass, job->keys_a, job->keys_b));
}

SPLATREE_KERNEL(256, 4) move_digits_16(const FrameJob* job, int packed) {
  const Pass pass = pass_of(packed);
  move_digits(job, pass, sides_of(pass, job->tile_keys_a, job->tile_keys_b));
}

// `by_id`: rows have ids; else the sort has left equal depths in the order of their rows.
SPLATREE_KERNEL(256, 1) keep_order(const FrameJob* job, int by_id) {
  const long long i = index_of_thread(), count = held(job->counters[NUM_SELECTED], job->row_capacity);
  if (i >= count) return;
  const unsigned splat = job->values_a[i], key = job->keys_a[i];
  long long place = i;
  if (by_id && key != NOT_VISIBLE) {
    const unsigned id = job->ids[job->rows[splat]];
    for (long long j = i - 1; j >= 0 && job->keys_a[j] == key; --j) place -= job->ids[job->rows[job->values_a[j]]] > id;
    for (long long j = i + 1; j < count && job->keys_a[j] == key; ++j) place += job->ids[job->rows[job->values_a[j]]] < id;
  }
  job->order[place] = splat;
}
