// The cut by blocks of consecutive rows in preorder; kernels/reference/select.py is the definition.
//
// Any ancestor of a row in a block that lies before the block is an ancestor of the block's first row. So a block is decided
// alone: the largest subtree_end of those ancestors that stop says which of its rows are shadowed from outside. Walking on
// from a block that was decided, the shadow is known without asking; where it covers whole blocks they are jumped over.
//
// In a block, only what is needed is computed, and in this order:
//   1. nothing, if its clusters were left out, its bound is out of the image or it lies in a shadow;
//   2. from one byte a row, its size class: which rows are leaves, and which inner rows could be small at all;
//   3. for these few, in order and outside of shadows, the radius; where it is that of the extent, the nearest and the farthest
//      point of the block tell for most rows, and of these nothing but the extent is read;
//   4. for rows kept, the view test: nothing if the block is well inside the image, else from bounds, else from the covariance.
// 3 and 4 run in full vectors of 16 gathered rows, so a row's answer does not depend on its place, and bounds never contradict
// the full computation: the result is the same for any size of block.
#include "cpu/frame/select.h"

#include "cpu/frame/asked.h"
#include "cpu/frame/flags.h"
#include "cpu/runtime/isa.h"

namespace splatree::SPLATREE_ISA {
namespace {

// How a run of rows lies to the image.
struct Placement {
  bool outside, inside;
  double depth_max, distance_min, distance_max;  // the distances for the radius of extents only
};

Placement place(const SelectJob& job, const RunBounds& bounds, int64_t run) {
  const float *lower = bounds.lower + 3 * run, *upper = bounds.upper + 3 * run;
  double center[3], half[3];
  for (int i = 0; i < 3; ++i) {
    center[i] = 0.5 * (double(upper[i]) + lower[i]);
    half[i] = 0.5 * (double(upper[i]) - lower[i]);
  }
  double low[NUM_PLANES], high[NUM_PLANES];
  const ViewPlanes& p = job.planes;
#pragma omp simd
  for (int i = 0; i < NUM_PLANES; ++i) {
    const double middle = p.x[i] * center[0] + p.y[i] * center[1] + p.z[i] * center[2] + p.d[i];
    const double width = __builtin_fabs(p.x[i]) * half[0] + __builtin_fabs(p.y[i]) * half[1] + __builtin_fabs(p.z[i]) * half[2];
    low[i] = middle - width;
    high[i] = middle + width;
  }
  Placement found = {false, true, high[DEPTH_PLANE], 0, 0};
  if (job.rule.sphere) {
    double nearest = 0, farthest = 0;
    for (int i = 0; i < 3; ++i) {
      const double middle = __builtin_fabs(job.eye[i] - center[i]), far = middle + half[i], near = middle - half[i];
      nearest += near > 0 ? near * near : 0;
      farthest += far * far;
    }
    found.distance_min = __builtin_sqrt(nearest);
    found.distance_max = __builtin_sqrt(farthest);
  }
  if (!job.cull) {
    found.inside = job.view_test == UNSEEN_TOO;
    return found;
  }
  bool has_all_beyond = false;  // the means, over one side at least
  for (int i = 0; i < NUM_SIDES; ++i) {
    has_all_beyond |= low[OUTSIDE + i] > 0;
    found.inside &= high[INSIDE + i] < 0;
  }
  if (!has_all_beyond) return found;
  double scale = bounds.leaf_scales[run];
  if (job.rule.sphere) {
    // An inner row that is drawn has an extent of at most τ_R (distance - extent) / f; 3σ is at most this, or in the steps.
    const double most = job.rule.pixel_error * found.distance_max / job.rule.focal_max * MARGIN;
    if (bounds.step_extents && found.distance_max < DISTANCE_MOST) {
      const float* extents = bounds.step_extents + BLOCK_STEPS * run;
      int step = 0;
      for (int i = 1; i < BLOCK_STEPS; ++i) step += extents[i] <= most;
      scale = bounds.step_scales[BLOCK_STEPS * run + step];
    }
    scale = most > 3.0 * scale ? most / 3.0 : scale;
  }
  for (int i = 0; i < NUM_SIDES; ++i) found.outside |= low[OUTSIDE + i] > job.reach[i] * scale;
  return found;
}

// What lies over the row that a walk is at. Of a range of limits, a node that is small for all of them casts a shadow: nothing of
// its subtree is drawn. One that is small for some casts a shade: what is below it is drawn by smaller limits only.
struct Walk {
  struct Shade {
    int64_t end;
    float limit;
  };

  int64_t shadow = -1;  // rows before it are shadowed; −1: not known
  Shade shades[256];    // outer first; a tree has at most as many levels
  int num_shades = 0;

  void restart() { shadow = num_shades = 0; }

  // The limit from which a row is not drawn, as an ancestor stops.
  float leave(int64_t row) {
    while (num_shades && shades[num_shades - 1].end <= row) --num_shades;
    return num_shades ? shades[num_shades - 1].limit : LARGEST_SIZE;
  }
};

// Asks in order for rows that are not shadowed. next(row) is the first of those to ask for at or behind a row, −1 if there is
// none. Calls stop(row) for each that is small for all limits, and fade(row, size) for each that is small from a limit on at
// which no ancestor stops; the walk moves on. Rows whose extent is at most `surely_small` are small for all limits.
template <class Next, class Stop, class Fade>
void each_stop(const SelectJob& job, const Next& next, float surely_small, Walk& walk, const Stop& stop, const Fade& fade) {
  Planes planes;
  int32_t batch[LANES];
  int64_t row = next(walk.shadow);
  const auto ends = [&](int64_t at) {
    walk.shadow = job.subtree_end[at];
    stop(at);
  };
  while (row >= 0) {
    if (job.extents[row] <= surely_small && job.index.size_classes[row] < UNBOUNDED_CLASS) {
      ends(row);
      row = next(walk.shadow);
      continue;
    }
    int used = 0;
    for (; row >= 0 && used < LANES; row = next(row + 1)) batch[used++] = int32_t(row);
    for (int l = used; l < LANES; ++l) batch[l] = batch[used - 1];
    if (!job.all_small) measure(job, batch, planes);
    for (int l = 0; l < used; ++l) {
      if (batch[l] < walk.shadow) continue;
      if (job.all_small || planes.size[l] <= job.fine_limit) {
        ends(batch[l]);
      } else if (planes.size[l] <= job.rule.limit && planes.size[l] < walk.leave(batch[l])) {
        walk.shades[walk.num_shades++] = {job.subtree_end[batch[l]], planes.size[l]};
        fade(batch[l], planes.size[l]);
      }
    }
    if (row >= 0 && row < walk.shadow) row = next(walk.shadow);
  }
}

// Begins a walk at the first row of a block.
void begin_walk(const SelectJob& job, int64_t block, Walk& walk) {
  walk.restart();
  const int32_t* row = job.index.ancestors + job.index.ancestor_start[block];
  const int32_t* const end = job.index.ancestors + job.index.ancestor_start[block + 1];
  const auto next = [&](int64_t from) {
    while (row < end && *row < from) ++row;
    return row < end ? int64_t(*row) : -1;
  };
  each_stop(job, next, NEVER_SMALL, walk, [](int64_t) {}, [](int64_t, float) {});
}

// The first run that ends behind a row, num_runs if there is none.
int64_t run_behind(const SelectJob& job, int64_t row) {
  int64_t low = 0, high = job.num_runs;
  while (low < high) {
    const int64_t middle = (low + high) / 2;
    if (job.runs[2 * middle + 1] > row)
      high = middle;
    else
      low = middle + 1;
  }
  return low;
}

// Clears the flags of the rows of [begin, end) that are in no run; `run` is the first that ends behind begin.
void keep_runs(const SelectJob& job, int64_t run, int64_t begin, int64_t end, Flags& kept) {
  for (int64_t row = begin; row < end; ++run) {
    const int64_t next = run < job.num_runs && job.runs[2 * run] < end ? job.runs[2 * run] : end;
    kept.clear(row - begin, next - begin);
    row = next;
    if (next < end && job.runs[2 * run + 1] > row) row = job.runs[2 * run + 1];
  }
}

// Of a range of limits, those between which each row of a part of a block is drawn.
struct Limits {
  alignas(64) float enter[MAX_BLOCK_ROWS], leave[MAX_BLOCK_ROWS];

  // Before the part at [begin, end) is walked: the shades that reach into it.
  void start(Walk& walk, int64_t begin, int64_t end) {
    const float innermost = walk.leave(begin);
    for (int64_t row = begin; row < end; ++row) enter[row - begin] = 0, leave[row - begin] = LARGEST_SIZE;
    if (innermost == LARGEST_SIZE) return;
    for (int i = 0; i < walk.num_shades; ++i)
      shade(begin, begin, walk.shades[i].end < end ? walk.shades[i].end : end, walk.shades[i].limit);
  }

  void shade(int64_t begin, int64_t first, int64_t last, float limit) {
    for (int64_t row = first; row < last; ++row) leave[row - begin] = limit;
  }
};

// Fetches what a walk by extents reads of the next block. It goes from a row to the end of its subtree, so the processor cannot
// foresee what it reads next.
void prefetch(const SelectJob& job, int64_t begin) {
  for (int64_t row = begin; row < begin + job.index.rows_per_block; row += 16) {
    __builtin_prefetch(job.extents + row);
    __builtin_prefetch(job.subtree_end + row);
  }
}

// The rows drawn of [begin, end), a part of a block that starts outside of any shadow; moves the walk on. With runs of rows,
// `run` is the first that ends behind the block's first row.
int select_rows(const SelectJob& job, int64_t block, const Placement& placement, int64_t begin, int64_t end, int64_t run,
                Walk& walk, const CutRows& out) {
  const int count = int(end - begin);
  const uint8_t* size_class = job.index.size_classes + begin;
  Flags kept(count, [&](int i) { return size_class[i] == LEAF_CLASS; });
  Limits limits;
  if (out.enters) limits.start(walk, begin, end);

  const int largest = largest_small_class(job.rule, job.all_small, placement.depth_max, placement.distance_max);
  if (largest >= 0) {
    const Flags inner(count, [&](int i) { return size_class[i] <= uint8_t(largest); });
    const auto next = [&](int64_t from) {
      const int place = inner.next(from > begin ? from - begin : 0);
      return place < count ? begin + place : -1;
    };
    const auto end_of = [&](int64_t row) { return job.subtree_end[row] < end ? job.subtree_end[row] : end; };
    each_stop(
        job, next, surely_small_extent(job.rule, job.fine_limit, placement.distance_min, placement.distance_max), walk,
        [&](int64_t row) {
          kept.set(row - begin);
          kept.clear(row + 1 - begin, end_of(row) - begin);
        },
        [&](int64_t row, float limit) {
          kept.set(row - begin);
          limits.enter[row - begin] = limit;
          limits.shade(begin, row + 1, end_of(row), limit);
        });
  }

  if (job.runs) {
    while (run < job.num_runs && job.runs[2 * run + 1] <= begin) ++run;
    if (run == job.num_runs || job.runs[2 * run] > begin || job.runs[2 * run + 1] < end) keep_runs(job, run, begin, end, kept);
  }

  int size = 0;
  if (placement.inside) {
    if (job.view_test == FOOTPRINT && job.index.min_logits[block] < job.rule.logit_min) {
      const float* logits = job.logit_opacities + begin;
      kept.keep(Flags(count, [&](int i) { return logits[i] >= job.rule.logit_min; }));
    }
    size = kept.list(int32_t(begin), out.rows);
  } else {
    Rows drawn;
    drawn.size = kept.list(int32_t(begin), drawn.row);
    drawn.pad();
    uint8_t visible[MAX_BLOCK_ROWS + LANES];
    ask_visible(job, drawn, visible);
    for (int i = 0; i < drawn.size; ++i) {
      out.rows[size] = drawn.row[i];
      size += visible[i];
    }
  }
  if (out.enters) {
    for (int i = 0; i < size; ++i) {
      out.enters[i] = limits.enter[out.rows[i] - begin];
      out.leaves[i] = limits.leave[out.rows[i] - begin];
    }
  }
  return size;
}

}  // namespace

RunResult select_group(const SelectJob& job, int64_t group, const CutRows& out) {
  RunResult result = {0, 0};
  const int64_t rows_per_block = job.index.rows_per_block;
  const int64_t first_row = group * BLOCKS_PER_GROUP * rows_per_block;
  int64_t run = job.runs ? run_behind(job, first_row) : 0;
  const int64_t group_end = first_row + BLOCKS_PER_GROUP * rows_per_block;
  if (job.runs && (run == job.num_runs || job.runs[2 * run] >= group_end)) return result;
  if (place(job, job.index.groups, group).outside) return result;
  const int64_t num_blocks = (job.num_rows + rows_per_block - 1) / rows_per_block;
  const int64_t first = group * BLOCKS_PER_GROUP;
  const int64_t last = first + BLOCKS_PER_GROUP < num_blocks ? first + BLOCKS_PER_GROUP : num_blocks;
  Walk walk;
  bool walks = job.rule.sphere;  // whether rows of the block before stopped, so that those of the next probably do
  // The next block of those that are looked at. Behind one that is not, the shadow is not known.
  const auto behind = [&](int64_t next) {
    const int64_t looked = (next + job.every - 1) / job.every * job.every;
    if (looked != next) walk.shadow = -1;
    return looked;
  };
  int64_t block = behind(first);
  while (block < last) {
    int64_t begin = block * rows_per_block;
    const int64_t end = begin + rows_per_block < job.num_rows ? begin + rows_per_block : job.num_rows;
    if (job.runs) {
      while (run < job.num_runs && job.runs[2 * run + 1] <= begin) ++run;
      if (run == job.num_runs) break;
      if (job.runs[2 * run] >= end) {
        walk.shadow = -1;
        block = behind(job.runs[2 * run] / rows_per_block);
        continue;
      }
    }
    const Placement placement = place(job, job.index.blocks, block);
    if (placement.outside) {
      walk.shadow = -1;
      block = behind(block + 1);
      continue;
    }
    if (walk.shadow < 0) begin_walk(job, block, walk);
    if (walk.shadow > begin) begin = walk.shadow < end ? walk.shadow : end;
    if (begin < end) {
      if (walks && block + 1 < last) prefetch(job, end);
      result.num_selected += select_rows(job, block, placement, begin, end, run, walk, out.behind(result.num_selected));
      result.num_visited += end - begin;
      walks = job.rule.sphere && walk.shadow > begin;
    }
    const int64_t next = walk.shadow / rows_per_block;
    block = behind(next > block ? next : block + 1);
  }
  return result;
}

void small_rows(const SelectJob& job, const int32_t* rows, int64_t count, uint8_t* small) {
  Rows list;
  uint8_t answers[MAX_BLOCK_ROWS + LANES];
  for (int64_t begin = 0; begin < count; begin += MAX_BLOCK_ROWS) {
    list.size = count - begin < MAX_BLOCK_ROWS ? int(count - begin) : MAX_BLOCK_ROWS;
    for (int i = 0; i < list.size; ++i) list.row[i] = rows[begin + i];
    list.pad();
    if (!job.all_small) ask_all(job, answer_small, list, answers);
    for (int i = 0; i < list.size; ++i) small[begin + i] = job.all_small || answers[i];
  }
}

void visible_rows(const SelectJob& job, const int32_t* rows, int64_t count, uint8_t* visible) {
  Rows list;
  uint8_t answers[MAX_BLOCK_ROWS + LANES];
  for (int64_t begin = 0; begin < count; begin += MAX_BLOCK_ROWS) {
    list.size = count - begin < MAX_BLOCK_ROWS ? int(count - begin) : MAX_BLOCK_ROWS;
    for (int i = 0; i < list.size; ++i) list.row[i] = rows[begin + i];
    list.pad();
    ask_visible(job, list, answers);
    for (int i = 0; i < list.size; ++i) visible[begin + i] = answers[i];
  }
}

}  // namespace splatree::SPLATREE_ISA
