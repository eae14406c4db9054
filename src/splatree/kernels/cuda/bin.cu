// The tiles that each splat touches, and the lists of the tiles; kernels/reference/bin.py is the definition.
//
// list_pairs    a thread a splat in depth order: how many tiles it touches, by two square roots a row of tiles; where its pairs
// go, by
//               looking back at the thread blocks before (scan.h); its pairs. A splat over many tiles is listed by its warp, 32
//               tiles at a time.
// start_tiles   a thread a tile, after the pairs were sorted by tile: where its list begins
// order_tiles   one thread block: the tiles by the length of their lists, the longest first, to half an octave. Which of two
//               such tiles comes first is left open; no picture depends on it
#include "cuda/scan.h"
#include "shared/ellipse.h"
#include "shared/square.h"

namespace splatree {
namespace {

constexpr int FEW_TILES = 16;  // that a thread lists alone
constexpr int ORDER_THREADS = 1024, NUM_LENGTHS = 64;

struct Cover {
  Ellipse ellipse;
  Tiles rows, columns;  // the columns of all rows, if they are the same in each: of a box or a square
};

SPLATREE_FN Cover load_cover(const FrameJob* job, long long splat) {
  const FrameNumbers& n = job->numbers;
  const float4 p = job->records[4 * splat], q = job->records[4 * splat + 1];
  const float4 r = job->records[4 * splat + 2], s = job->records[4 * splat + 3];
  Cover cover = {};
  if (n.tile_rule == int(TileRule::SQUARE)) {
    const float half_side = half_side_of_factor(n.square, p.z, p.w, q.x, q.z);
    const Side across = side_of(p.x, half_side, (float)n.num_tiles_x), down = side_of(p.y, half_side, (float)n.num_tiles_y);
    cover.rows = {int(down.first), int(down.end)};
    cover.columns = {int(across.first), int(across.end)};
    return cover;
  }
  const Ellipse e =
      ellipse_of(p.x, p.y, p.z, p.w, q.x, q.z, r.w, s.x, log2_threshold_of(n.log2_threshold, n.area_power, p.z, q.x));
  cover.ellipse = e;
  cover.rows = tiles_in({e.y - e.height - e.margin, e.y + e.height + e.margin}, (float)n.height);
  const float box = r.w + e.margin;
  cover.columns = tiles_in({e.x - box, e.x + box}, (float)n.width);
  return cover;
}

// The tiles of a splat in a row of tiles.
SPLATREE_FN Tiles columns_of(const FrameJob* job, const Cover& cover, int row) {
  if (job->numbers.tile_rule != int(TileRule::ELLIPSE)) return cover.columns;
  const Interval strip = strip_of(row, (float)job->numbers.height);
  return tiles_in(reach_of(cover.ellipse, strip.low, strip.high), (float)job->numbers.width);
}

SPLATREE_FN void store_pair(const FrameJob* job, long long at, int tile, unsigned splat, bool in_16_bits) {
  if (at >= job->pair_capacity) return;
  if (in_16_bits)
    job->tile_keys_a[at] = (unsigned short)tile;
  else
    job->keys_a[at] = (unsigned)tile;
  job->values_a[at] = splat;
}

// The class of a list's length, 0 for the longest: half an octave each.
SPLATREE_FN int length_class(unsigned length) {
  int octave = 0;
  for (unsigned left = length; left > 1; left >>= 1) ++octave;
  return NUM_LENGTHS - 1 - (length > 1 ? 2 * octave + int(length >> (octave - 1) & 1) : int(length));
}

SPLATREE_FN unsigned length_of(const FrameJob* job, int tile) { return job->tile_start[tile + 1] - job->tile_start[tile]; }

}  // namespace
}  // namespace splatree

using namespace splatree;

// Packed: whether also the opacity is asked for at which each splat is tapered off; whether tiles are numbers of 16 bits; the
// scan.
SPLATREE_KERNEL(256, 4) list_pairs(const FrameJob* job, int packed) {
  const int which = packed >> 2;
  const bool tapers = packed & 1, in_16_bits = packed >> 1 & 1;
  const long long num_splats = held(job->counters[NUM_SELECTED], job->row_capacity);
  const long long chunk = take_chunk(job, which), i = chunk * SCAN_THREADS + threadIdx.x;
  if (chunk * SCAN_THREADS >= num_splats) return;
  const FrameNumbers& n = job->numbers;
  const unsigned splat = i < num_splats ? job->order[i] : 0;
  Cover cover = {};
  Tiles last = {0, 0};  // of the last row: for most splats there is no other
  unsigned count = 0;
  if (i < num_splats && job->depth_keys[splat] != NOT_VISIBLE) {
    cover = load_cover(job, splat);
    float nearest = tapers ? nearest_above_or_below(cover.ellipse, cover.rows, n.num_tiles_y) : FAR;
    for (int row = cover.rows.first; row < cover.rows.end; ++row) {
      const Tiles columns = columns_of(job, cover, row);
      count += columns.end - columns.first;
      last = columns;
      if (tapers) {
        const float beside = nearest_beside(cover.ellipse, columns, strip_of(row, (float)n.height), n.num_tiles_x);
        nearest = least(beside, nearest);
      }
    }
    if (tapers) {
      const float4 p = job->records[4 * splat], q = job->records[4 * splat + 1];
      job->floors[splat] = floor_of(q.z, nearest, log2_threshold_of(n.log2_threshold, n.area_power, p.z, q.x));
    }
  }
  unsigned of_warp;
  const unsigned before = sum_before(count, of_warp);
  const bool is_last = (chunk + 1) * SCAN_THREADS >= num_splats;
  const long long first = sum_before_warp(job, which, chunk, of_warp, is_last, NUM_PAIRS) + (long long)before;

  if (count && count <= FEW_TILES) {
    long long at = first;
    for (int row = cover.rows.first; row < cover.rows.end; ++row) {
      const Tiles columns = row + 1 == cover.rows.end ? last : columns_of(job, cover, row);
      for (int column = columns.first; column < columns.end; ++column)
        store_pair(job, at++, row * n.num_tiles_x + column, splat, in_16_bits);
    }
  }
  // The others one after the other: all lanes go along its rows together.
  for (unsigned many = __ballot_sync(ALL_LANES, count > FEW_TILES); many; many &= many - 1) {
    const int lane = __ffs(many) - 1;
    const unsigned theirs = __shfl_sync(ALL_LANES, splat, lane);
    long long at = __shfl_sync(ALL_LANES, first, lane);
    const Cover wide = load_cover(job, theirs);
    for (int row = wide.rows.first; row < wide.rows.end; ++row) {
      const Tiles columns = columns_of(job, wide, row);
      for (int column = columns.first + lane_of(); column < columns.end; column += WARP)
        store_pair(job, at + column - columns.first, row * n.num_tiles_x + column, theirs, in_16_bits);
      at += columns.end - columns.first;
    }
  }
}

// Packed: the side on which the sort of the pairs ended; whether tiles are numbers of 16 bits.
SPLATREE_KERNEL(256, 1) start_tiles(const FrameJob* job, int packed) {
  const long long tile = index_of_thread(), count = held(job->counters[NUM_PAIRS], job->pair_capacity);
  if (tile > (long long)job->numbers.num_tiles_x * job->numbers.num_tiles_y) return;
  const bool from_b = packed & 1, in_16_bits = packed >> 1;
  const long long place = in_16_bits ? place_of_key(from_b ? job->tile_keys_b : job->tile_keys_a, count, tile)
                                     : place_of_key(from_b ? job->keys_b : job->keys_a, count, tile);
  job->tile_start[tile] = (unsigned)place;
}

SPLATREE_KERNEL(1024, 1) order_tiles(const FrameJob* job, int) {
  SPLATREE_SHARED(unsigned, places, NUM_LENGTHS);
  const int num_tiles = job->numbers.num_tiles_x * job->numbers.num_tiles_y;
  if (threadIdx.x < NUM_LENGTHS) places[threadIdx.x] = 0;
  __syncthreads();
  for (int tile = threadIdx.x; tile < num_tiles; tile += ORDER_THREADS)
    atomicAdd(&places[length_class(length_of(job, tile))], 1u);
  __syncthreads();
  if (warp_of() == 0) {
    unsigned total;
    const unsigned first = places[2 * lane_of()], both = first + places[2 * lane_of() + 1], before = sum_before(both, total);
    places[2 * lane_of()] = before;
    places[2 * lane_of() + 1] = before + first;
  }
  __syncthreads();
  for (int tile = threadIdx.x; tile < num_tiles; tile += ORDER_THREADS)
    job->tile_order[atomicAdd(&places[length_class(length_of(job, tile))], 1u)] = (unsigned)tile;
}
