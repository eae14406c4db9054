// The visible cut by blocks of consecutive rows (a block of threads is always called a thread block); kernels/reference/select.py
// is the definition, kernels/cpu/frame/select.cpp the same on the processor.
//
// select_blocks   a warp a block: is it in the image, and does the shadow of an ancestor of its first row cover it?
//
// select_rows     256 threads a block that is left, a thread a row: radius, prefix maximum of subtree_end, the view test;
//                 one bit a row
//
// scan_kept       where the rows of each block go
//
// list_rows       a warp a block: bits to rows
//
// Which blocks are left is listed in no order, but each writes its bits to its own place: the rows come out ascending, whatever
// the schedule. No list of ancestors a row, no host in between.
#include "cuda/rows.h"
#include "cuda/scan.h"

namespace splatree {
namespace {

// How a block lies to the image; asked by the lanes of a warp, each of which takes a plane.
struct Placement {
  bool outside, inside;
  double depth_max, distance_max;  // the distance for the radius of balls only
};

SPLATREE_FN Placement place(const FrameJob* job, long long block) {
  const FrameNumbers& n = job->numbers;
  const int plane = smaller(lane_of(), NUM_PLANES - 1);
  const double normal[3] = {n.planes.x[plane], n.planes.y[plane], n.planes.z[plane]};
  double middle = n.planes.d[plane], width = 0, squared = 0;
  for (int i = 0; i < 3; ++i) {
    const double lower = job->block_lower[3 * block + i], upper = job->block_upper[3 * block + i];
    const double center = 0.5 * (upper + lower), half = 0.5 * (upper - lower);
    middle += normal[i] * center;
    width += __builtin_fabs(normal[i]) * half;
    const double far = __builtin_fabs(n.eye[i] - center) + half;
    squared += far * far;
  }
  Placement found = {false, n.view_test == UNSEEN_TOO, __shfl_sync(ALL_LANES, middle + width, DEPTH_PLANE), 0};
  if (n.rule.sphere) found.distance_max = __builtin_sqrt(squared);
  if (!n.cull) return found;
  double scale = job->leaf_scales[block];
  if (n.rule.sphere) {
    // An inner row that is drawn has 3σ <= extent <= τ_R (distance - extent) / f.
    const double drawn = n.rule.pixel_error * found.distance_max / (3.0 * n.rule.focal_max);
    scale = drawn > scale ? drawn : scale;
  }
  const bool is_side = plane < NUM_SIDES;
  found.outside = __any_sync(ALL_LANES, is_side && middle - width > n.reach[is_side ? plane : 0] * scale);
  const bool asks_inside = plane >= INSIDE && plane < INSIDE + NUM_SIDES;
  found.inside = __all_sync(ALL_LANES, !asks_inside || middle + width < 0);
  return found;
}

// The end of the shadow in which a block begins, 0 if none; asked by a warp. Any ancestor of a row that lies before the block
// is an ancestor of its first row.
SPLATREE_FN int shadow_before(const FrameJob* job, long long block) {
  const int first = job->ancestor_start[block], last = job->ancestor_start[block + 1];
  int shadow = 0;
  for (int begin = first; begin < last; begin += WARP) {
    const int at = begin + lane_of();
    if (at >= last) continue;
    const int row = job->ancestors[at];
    if (load_small(job, row)) shadow = larger(shadow, job->subtree_end[row]);
  }
  __syncwarp();
  return largest_of_warp(shadow);
}

}  // namespace
}  // namespace splatree

using namespace splatree;

SPLATREE_KERNEL(256, 1) select_blocks(const FrameJob* job) {
  const long long block = index_of_thread() / WARP;
  if (block >= job->num_blocks) return;
  const Placement placement = place(job, block);
  const long long begin = block * job->rows_per_block;
  const long long end = begin + job->rows_per_block < job->num_rows ? begin + job->rows_per_block : job->num_rows;
  const int shadow = placement.outside ? (int)end : shadow_before(job, block);
  if (lane_of()) return;
  if (shadow >= end) {
    job->num_kept[block] = 0;
    return;
  }
  const int largest = largest_small_class(job->numbers.rule, job->numbers.all_small, placement.depth_max, placement.distance_max);
  const long long place = (long long)atomicAdd(&job->counters[NUM_OPEN], 1ull);
  job->open_blocks[place] = make_int4((int)block, shadow, largest, placement.inside);
  atomicAdd(&job->counters[NUM_VISITED], (unsigned long long)(end - (shadow > begin ? shadow : begin)));
}

SPLATREE_KERNEL(256, 1) select_rows(const FrameJob* job) {
  SPLATREE_SHARED(int, warp_ends, 8);
  const FrameNumbers& n = job->numbers;
  const long long num_open = (long long)job->counters[NUM_OPEN];
  for (long long entry = blockIdx.x; entry < num_open; entry += gridDim.x) {
    const int4 open = job->open_blocks[entry];
    const long long begin = open.x * job->rows_per_block;
    const long long end = begin + job->rows_per_block < job->num_rows ? begin + job->rows_per_block : job->num_rows;
    const bool inside = open.w;
    const bool all_bright = inside && !(n.view_test == FOOTPRINT && job->min_logits[open.x] < n.rule.logit_min);
    int shadow = open.y;  // of the rows before
    unsigned num_kept = 0;
    for (long long first = begin; first < end; first += blockDim.x) {
      const long long row = first + threadIdx.x;
      const bool lit = row < end && row >= shadow;
      const int size_class = lit ? job->size_classes[row] : LEAF_CLASS;
      // A small node under another one's shadow adds nothing: its subtree ends in that of the other.
      const bool stops = lit && size_class <= open.z && load_small(job, row);
      const int subtree_end = stops ? job->subtree_end[row] : 0;

      int largest;
      const int before_in_warp = max_before(subtree_end, 0, largest);
      if (lane_of() == WARP - 1) warp_ends[warp_of()] = largest;
      __syncthreads();
      int before = larger(before_in_warp, shadow);
      for (int warp = 0; warp < (int)blockDim.x / WARP; ++warp) {
        const int of_warp = warp_ends[warp];
        if (warp < warp_of()) before = larger(before, of_warp);
        shadow = larger(shadow, of_warp);
      }

      bool kept = lit && (stops || size_class == LEAF_CLASS) && before <= row;
      if (kept && !inside) kept = load_visible(job, row);
      if (kept && inside && !all_bright) kept = job->logit_opacities[row] >= n.rule.logit_min;
      const unsigned mask = __ballot_sync(ALL_LANES, kept);
      const long long word = (first - begin) / WARP + warp_of();
      if (lane_of() == 0 && word < job->words_per_block) job->kept_masks[open.x * job->words_per_block + word] = mask;
      num_kept += __syncthreads_count(kept);
    }
    if (threadIdx.x == 0) job->num_kept[open.x] = num_kept;
  }
}

SPLATREE_KERNEL(256, 4) scan_kept(const FrameJob* job) {
  scan(
      job, 0, job->num_blocks, NUM_SELECTED, [&](long long block) { return job->num_kept[block]; },
      [&](long long block, unsigned first) { job->first_kept[block] = first; });
}

SPLATREE_KERNEL(256, 1) list_rows(const FrameJob* job) {
  const long long block = index_of_thread() / WARP;
  if (block >= job->num_blocks || !job->num_kept[block]) return;
  long long place = job->first_kept[block];
  const long long begin = block * job->rows_per_block;
  const long long end = begin + job->rows_per_block < job->num_rows ? begin + job->rows_per_block : job->num_rows;
  for (long long first = begin; first < end; first += WARP) {
    const unsigned mask = job->kept_masks[block * job->words_per_block + (first - begin) / WARP];
    const long long at = place + __popc(mask & lanes_before());
    if ((mask >> lane_of() & 1) && at < job->row_capacity) job->rows[at] = (int)(first + lane_of());
    place += __popc(mask);
  }
}
