// A stable sort of keys with values, eight bits at a time from the lowest (radix sort): once for the depths of the splats, once
// for the tiles of the pairs.
//
// order_splats                splats in the order of their rows, with their depths as keys
// count_digits                256 threads a tile of 4096 keys: how many there are of each digit, for all passes at once
// move_digits                 256 threads a tile, a pass: the keys go to their places. Equal digits keep their order, by the
// ranks
//                             below; where a tile's keys of a digit begin is found while others are at work, by looking back at
//                             what the tiles before have published of that digit (Adinets and Merrill 2022, one sweep)
// count_digits_16, move_digits_16   the same for keys of 16 bits: tiles of a picture that has no more than 65,536
// keep_order                  a thread a splat: the order, kept before pairs are sorted; equal depths by id
//
// Equal depths are rare, so ids are not sorted: a splat counts the smaller ids among those of its depth. That costs the square of
// a run of equal depths: 10¹⁰ comparisons for 100,000 splats in one plane that is seen along its normal.
#include "cuda/scan.h"

namespace splatree {
namespace {

constexpr int THREADS = 256, ITEMS = 16, SORT_TILE = THREADS * ITEMS, DIGITS = 256, DIGIT_BITS = 8, MAX_PASSES = 4;

// A sort, or a pass of it; packed by kernels/cuda/plan.py.
struct Pass {
  int shift;       // of the digit
  bool pairs;      // whether pairs are sorted, else splats
  bool from_b;     // which side the keys are on
  int num_passes;  // of the sort
};

SPLATREE_FN Pass pass_of(int packed) { return {packed & 31, (packed >> 5 & 1) != 0, (packed >> 6 & 1) != 0, packed >> 7}; }

// The number of a pass among those of both sorts.
SPLATREE_FN int number_of(const Pass& pass) { return (pass.pairs ? MAX_PASSES : 0) + pass.shift / DIGIT_BITS; }

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

SPLATREE_FN Part part_of_lane(long long count, long long tile) {
  const long long begin = tile * SORT_TILE + warp_of() * (WARP * ITEMS) + lane_of();
  return {begin, count - begin < SORT_TILE ? int(count - begin) : SORT_TILE};
}

template <class Key>
SPLATREE_FN void count_digits(const FrameJob* job, const Pass& sort, Global<Key> keys) {
  SPLATREE_SHARED(unsigned, counts, MAX_PASSES* DIGITS);
  const long long count = count_of(job, sort);
  if (blockIdx.x >= tiles_of(count)) return;
  for (int pass = 0; pass < sort.num_passes; ++pass) counts[pass * DIGITS + threadIdx.x] = 0;
  __syncthreads();
  const Part part = part_of_lane(count, blockIdx.x);
  for (int i = 0; i < ITEMS; ++i) {
    if (i * WARP >= part.left) break;
    const unsigned key = keys[part.begin + i * WARP];
    for (int pass = 0; pass < sort.num_passes; ++pass)
      atomicAdd(&counts[pass * DIGITS + (key >> DIGIT_BITS * pass & (DIGITS - 1))], 1u);
  }
  __syncthreads();
  for (int pass = 0; pass < sort.num_passes; ++pass) {
    const unsigned own = counts[pass * DIGITS + threadIdx.x];
    if (own) atomicAdd(&job->histograms[(number_of(sort) + pass) * DIGITS + threadIdx.x], own);
  }
}

// The place of the first key of a tile whose digit is the number of the thread; the tile has `own` of them.
SPLATREE_FN unsigned place_of_digit(const FrameJob* job, const Pass& pass, long long tile, unsigned own) {
  SPLATREE_SHARED(unsigned, of_warps, THREADS / WARP);
  const long long of_splats = tiles_of(job->row_capacity), of_sort = pass.pairs ? tiles_of(job->pair_capacity) : of_splats;
  const long long first = (pass.pairs ? MAX_PASSES * of_splats : 0) + pass.shift / DIGIT_BITS * of_sort;
  const long long words = first * DIGITS + threadIdx.x;  // of this digit; those of the tiles are DIGITS apart
  publish(&job->sweeps[words + tile * DIGITS], (tile ? OWN_SUM : WHOLE_SUM) | own);

  // Keys of smaller digits, anywhere.
  unsigned of_warp;
  unsigned place = sum_before(job->histograms[number_of(pass) * DIGITS + threadIdx.x], of_warp);
  if (lane_of() == 0) of_warps[warp_of()] = of_warp;
  __syncthreads();
  for (int warp = 0; warp < warp_of(); ++warp) place += of_warps[warp];

  // Keys of this digit in the tiles before, from the nearest back to the first that knows all before it.
  unsigned long long earlier = 0;
  for (long long nearest = tile - 1; __any_sync(ALL_LANES, nearest >= 0);) {
    const unsigned long long word = nearest >= 0 ? read_published(&job->sweeps[words + nearest * DIGITS]) : 0;
    if (word < OWN_SUM) continue;
    earlier += word & SUM_MASK;
    nearest = word >= WHOLE_SUM ? -1 : nearest - 1;
  }
  if (tile) publish(&job->sweeps[words + tile * DIGITS], WHOLE_SUM | (earlier + own));
  return place + (unsigned)earlier;
}

template <class Key>
SPLATREE_FN void move_digits(const FrameJob* job, const Pass& pass, const Sides<Key>& keys) {
  SPLATREE_SHARED(unsigned, places, THREADS / WARP * DIGITS);  // of each warp and digit
  const long long count = count_of(job, pass), tile = take_chunk(job, NUM_SCANS + number_of(pass));
  if (tile >= tiles_of(count)) return;
  const Sides<unsigned> values = sides_of(pass, job->values_a, job->values_b);
  const int own = warp_of() * DIGITS;
  for (int digit = lane_of(); digit < DIGITS; digit += WARP) places[own + digit] = 0;
  __syncwarp();

  // The rank of each key among those of its digit in the warp's part.
  const Part part = part_of_lane(count, tile);
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
  unsigned of_tile = 0;
  for (int warp = 0; warp < THREADS / WARP; ++warp) of_tile += places[warp * DIGITS + threadIdx.x];
  unsigned next = place_of_digit(job, pass, tile, of_tile);
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

SPLATREE_KERNEL(256, 1) count_digits(const FrameJob* job, int packed) { count_digits(job, pass_of(packed), job->keys_a); }

SPLATREE_KERNEL(256, 1) count_digits_16(const FrameJob* job, int packed) { count_digits(job, pass_of(packed), job->tile_keys_a); }

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
