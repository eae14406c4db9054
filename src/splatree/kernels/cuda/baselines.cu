// Other ways to the same cut, to be measured beside select.cu; lod/serial.py has the one, FilterGS (2026, §3.2) describes the
// other.
//
// serial_roots, serial_level     a thread a node of one level: the small ones and the leaves are kept, the others replaced by
// their
//                                children; the host asks after each level how many there are (as LoG does, Shuai 2024)
// paper_small                    a thread a node: its radius, if it can be seen
// paper_filter                   a thread a node: small or a leaf, in view, and no ancestor in its row of the table stops
//
// Rows come out in no order.
#include "cuda/rows.h"

namespace splatree {
namespace {

enum State : unsigned char { LARGE, SMALL, UNSEEN };

SPLATREE_FN bool is_leaf(const FrameJob* job, long long row) { return job->subtree_end[row] == row + 1; }

SPLATREE_FN void append(const FrameJob* job, int counter, Global<int> list, long long capacity, int row) {
  const long long at = (long long)atomicAdd(&job->counters[counter], 1ull);
  if (at < capacity) list[at] = row;
}

}  // namespace
}  // namespace splatree

using namespace splatree;

// Level 0 goes from the table of levels to side a.
SPLATREE_KERNEL(256, 1) serial_roots(const FrameJob* job) {
  const long long i = index_of_thread();
  if (i < job->num_roots) job->frontier_a[i] = job->children[i];
}

// `packed`: how many nodes of the level there are, and whether they are on side b.
SPLATREE_KERNEL(256, 1) serial_level(const FrameJob* job, int packed) {
  const long long i = index_of_thread();
  if (i >= packed >> 1) return;
  const bool from_b = packed & 1;
  const int row = from_b ? job->frontier_b[i] : job->frontier_a[i];
  if (is_leaf(job, row) || load_small(job, row)) {
    if (load_visible(job, row)) append(job, NUM_SELECTED, job->rows, job->row_capacity, row);
    return;
  }
  const Global<int> next = from_b ? job->frontier_a : job->frontier_b;
  const int first = job->first_child[row], count = job->num_children[row];
  const long long at = (long long)atomicAdd(&job->counters[NUM_FRONTIER], (unsigned long long)count);
  for (int child = 0; child < count; ++child) next[at + child] = job->children[first + child];
}

SPLATREE_KERNEL(256, 1) paper_small(const FrameJob* job) {
  const long long row = index_of_thread();
  if (row >= job->num_rows) return;
  job->states[row] = !load_visible(job, row) ? UNSEEN : is_leaf(job, row) ? LARGE : load_small(job, row) ? SMALL : LARGE;
}

SPLATREE_KERNEL(256, 1) paper_filter(const FrameJob* job) {
  const long long row = index_of_thread();
  if (row >= job->num_rows) return;
  const int state = job->states[row];
  if (state == UNSEEN || (state == LARGE && !is_leaf(job, row))) return;
  for (long long level = 0; level < job->num_levels; ++level) {
    const int ancestor = job->ancestor_table[row * job->num_levels + level];
    if (ancestor < 0) break;
    // The radius of an ancestor out of view was not asked for; the exact cut needs it all the same.
    const int above = job->states[ancestor];
    if (above == SMALL || (above == UNSEEN && load_small(job, ancestor))) return;
  }
  append(job, NUM_SELECTED, job->rows, job->row_capacity, (int)row);
}
