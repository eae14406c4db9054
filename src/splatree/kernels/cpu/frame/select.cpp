// The cut by blocks of consecutive rows in preorder; kernels/reference/select.py is the definition.
//
// Any ancestor of a row in a block that lies before the block is an ancestor of the block's first row. So a block is decided
// alone: the largest subtree_end of those ancestors that stop says which of its rows are shadowed from outside. Walking on
// from a block that was decided, the shadow is known without asking; where it covers whole blocks they are jumped over.
//
// In a block, only what is needed is computed, and in this order:
//   1. nothing, if its clusters were left out, its bound is out of the image or it lies in a shadow;
//   2. from one byte a row, its size class: which rows are leaves, and which inner rows could be small at all;
//   3. for these few, in order and outside of shadows, the radius;
//   4. for rows kept, the view test: nothing if the block is well inside the image, else from bounds, else from the covariance.
// 3 and 4 run in full vectors of 16 gathered rows, so a row's answer does not depend on its place, and bounds never contradict
// the full computation: the result is the same for any size of block.
#include "cpu/frame/select.h"

#include "cpu/runtime/isa.h"

namespace splatree::SPLATREE_ISA {
namespace {

constexpr int LANES = 16;

struct alignas(64) Planes {
  float mean[3][LANES], log_scale[3][LANES], quat[4][LANES], logit[LANES], extent[LANES];
  int32_t answer[LANES];
};

template <int WIDTH>
void gather(const float* column, const int32_t* rows, float (*planes)[LANES]) {
  for (int l = 0; l < LANES; ++l) {
    const float* row = column + int64_t(rows[l]) * WIDTH;
    for (int i = 0; i < WIDTH; ++i) planes[i][l] = row[i];
  }
}

// A list of rows with room to fill its last vector by repetition.
struct Rows {
  int32_t row[MAX_BLOCK_ROWS + LANES];
  int size = 0;

  void pad() {
    for (int l = 0; l < LANES; ++l) row[size + l] = size ? row[size - 1] : 0;
  }
};

void answer_small(const SelectJob& job, const int32_t* rows, Planes& p) {
  gather<3>(job.means, rows, p.mean);
  if (job.rule.sphere) {
    gather<1>(job.extents, rows, &p.extent);
#pragma omp simd
    for (int l = 0; l < LANES; ++l)
      p.answer[l] = is_small_extent(job.rule, point_of(job.view, p.mean[0][l], p.mean[1][l], p.mean[2][l]), p.extent[l]);
    return;
  }
  gather<3>(job.log_scales, rows, p.log_scale);
  gather<4>(job.quats, rows, p.quat);
#pragma omp simd
  for (int l = 0; l < LANES; ++l) {
    const Point point = point_of(job.view, p.mean[0][l], p.mean[1][l], p.mean[2][l]);
    const Factor m = factor_of(job.view, point, p.quat[0][l], p.quat[1][l], p.quat[2][l], p.quat[3][l],
                               {p.log_scale[0][l], p.log_scale[1][l], p.log_scale[2][l]});
    p.answer[l] = is_small(job.view, job.rule, point, m);
  }
}

void answer_visible_bounds(const SelectJob& job, const int32_t* rows, Planes& p) {
  gather<3>(job.means, rows, p.mean);
  if (job.view_test == CENTRE) {
#pragma omp simd
    for (int l = 0; l < LANES; ++l)
      p.answer[l] = is_centred(job.view, job.rule, point_of(job.view, p.mean[0][l], p.mean[1][l], p.mean[2][l]));
    return;
  }
  gather<3>(job.log_scales, rows, p.log_scale);
  gather<1>(job.logit_opacities, rows, &p.logit);
#pragma omp simd
  for (int l = 0; l < LANES; ++l)
    p.answer[l] = is_visible_bound(job.view, job.rule, point_of(job.view, p.mean[0][l], p.mean[1][l], p.mean[2][l]),
                                   {p.log_scale[0][l], p.log_scale[1][l], p.log_scale[2][l]}, p.logit[l]);
}

void answer_visible(const SelectJob& job, const int32_t* rows, Planes& p) {
  gather<3>(job.means, rows, p.mean);
  gather<3>(job.log_scales, rows, p.log_scale);
  gather<4>(job.quats, rows, p.quat);
  gather<1>(job.logit_opacities, rows, &p.logit);
#pragma omp simd
  for (int l = 0; l < LANES; ++l) {
    const Point point = point_of(job.view, p.mean[0][l], p.mean[1][l], p.mean[2][l]);
    const Factor m = factor_of(job.view, point, p.quat[0][l], p.quat[1][l], p.quat[2][l], p.quat[3][l],
                               {p.log_scale[0][l], p.log_scale[1][l], p.log_scale[2][l]});
    p.answer[l] = is_visible(job.view, point, m, p.logit[l]);
  }
}

using Answers = void (*)(const SelectJob&, const int32_t*, Planes&);

// The answers to `ask` for a padded list.
void ask_all(const SelectJob& job, Answers ask, const Rows& rows, uint8_t* answers) {
  Planes planes;
  for (int begin = 0; begin < rows.size; begin += LANES) {
    ask(job, rows.row + begin, planes);
    for (int l = 0; l < LANES; ++l) answers[begin + l] = uint8_t(planes.answer[l]);
  }
}

// Whether each row of a padded list can be seen: 0 or 1.
void ask_visible(const SelectJob& job, const Rows& rows, uint8_t* answers) {
  ask_all(job, answer_visible_bounds, rows, answers);
  Rows open;
  int32_t place[MAX_BLOCK_ROWS + LANES];
  int size = 0;
  for (int i = 0; i < rows.size; ++i) {
    open.row[size] = rows.row[i];
    place[size] = i;
    size += answers[i] == OPEN;
  }
  if (!size) return;
  open.size = size;
  open.pad();
  uint8_t full[MAX_BLOCK_ROWS + LANES];
  ask_all(job, answer_visible, open, full);
  for (int i = 0; i < size; ++i) answers[place[i]] = full[i];
}

// For each byte of eight flags, the places of those that are set.
struct PlacesOfByte {
  uint8_t place[256][8] = {};

  constexpr PlacesOfByte() {
    for (int byte = 0; byte < 256; ++byte)
      for (int bit = 0, size = 0; bit < 8; ++bit)
        if (byte >> bit & 1) place[byte][size++] = uint8_t(bit);
  }
};

constexpr PlacesOfByte PLACES;

// first + i for each i < count with flags[i] = 1; flags end with zeros up to a multiple of 8, out has room for 8 more.
int compact(const uint8_t* flags, int count, int32_t first, int32_t* out) {
  int size = 0;
  for (int i = 0; i < count; i += 8) {
    uint64_t bytes;
    __builtin_memcpy(&bytes, flags + i, 8);
    const unsigned byte = unsigned(bytes * 0x0102040810204080u >> 56);  // gathers the lowest bits of the eight
    for (int l = 0; l < 8; ++l) out[size + l] = first + i + PLACES.place[byte][l];
    size += __builtin_popcount(byte);
  }
  return size;
}

// How a run of rows lies to the image.
struct Placement {
  bool outside, inside;
  double depth_max, distance_max;  // the distance for the radius of balls only
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
  Placement found = {false, true, high[DEPTH_PLANE], 0};
  if (job.rule.sphere) {
    double squared = 0;
    for (int i = 0; i < 3; ++i) {
      const double far = __builtin_fabs(job.eye[i] - center[i]) + half[i];
      squared += far * far;
    }
    found.distance_max = __builtin_sqrt(squared);
  }
  if (!job.cull) {
    found.inside = job.view_test == UNSEEN_TOO;
    return found;
  }
  double scale = bounds.leaf_scales[run];
  if (job.rule.sphere) {
    // An inner row that is drawn has 3σ <= extent <= τ_R (distance - extent) / f.
    const double drawn = job.rule.pixel_error * found.distance_max / (3.0 * job.rule.focal_max);
    scale = drawn > scale ? drawn : scale;
  }
  for (int i = 0; i < NUM_SIDES; ++i) {
    found.outside |= low[OUTSIDE + i] > job.reach[i] * scale;
    found.inside &= high[INSIDE + i] < 0;
  }
  return found;
}

// Asks in order for the rows of a list that are not shadowed, and calls stop(row) for each that is small; `shadow` moves on.
template <class Stop>
void each_stop(const SelectJob& job, const int32_t* rows, int size, int64_t& shadow, const Stop& stop) {
  Planes planes;
  int32_t batch[LANES];
  for (int i = 0; i < size;) {
    int used = 0;
    for (; i < size && used < LANES; ++i) {
      batch[used] = rows[i];
      used += rows[i] >= shadow;
    }
    if (!used) return;
    for (int l = used; l < LANES; ++l) batch[l] = batch[used - 1];
    if (!job.all_small) answer_small(job, batch, planes);
    for (int l = 0; l < used; ++l) {
      if (batch[l] < shadow || !(job.all_small || planes.answer[l])) continue;
      shadow = job.subtree_end[batch[l]];
      stop(batch[l]);
    }
  }
}

// The end of the shadow in which a block begins, 0 if none.
int64_t shadow_before(const SelectJob& job, int64_t block) {
  int64_t shadow = 0;
  const int32_t* start = job.index.ancestor_start + block;
  each_stop(job, job.index.ancestors + start[0], start[1] - start[0], shadow, [](int64_t) {});
  return shadow;
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
void keep_runs(const SelectJob& job, int64_t run, int64_t begin, int64_t end, uint8_t* kept) {
  for (int64_t row = begin; row < end; ++run) {
    const int64_t next = run < job.num_runs && job.runs[2 * run] < end ? job.runs[2 * run] : end;
    for (; row < next; ++row) kept[row - begin] = 0;
    if (next < end && job.runs[2 * run + 1] > row) row = job.runs[2 * run + 1];
  }
}

// The rows drawn of [begin, end), a part of a block that starts outside of any shadow; moves `shadow` on. With runs of rows,
// `run` is the first that ends behind the block's first row.
int select_rows(const SelectJob& job, int64_t block, const Placement& placement, int64_t begin, int64_t end, int64_t run,
                int64_t& shadow, int32_t* out) {
  const int count = int(end - begin);
  const uint8_t* size_class = job.index.size_classes + begin;
  alignas(64) uint8_t kept[MAX_BLOCK_ROWS + LANES];
  for (int i = 0; i < count; ++i) kept[i] = size_class[i] == LEAF_CLASS;
  for (int i = count; i < count + 8; ++i) kept[i] = 0;

  const int largest = largest_small_class(job.rule, job.all_small, placement.depth_max, placement.distance_max);
  if (largest >= 0) {
    alignas(64) uint8_t maybe[MAX_BLOCK_ROWS + LANES];
    for (int i = 0; i < count; ++i) maybe[i] = size_class[i] <= uint8_t(largest);
    for (int i = count; i < count + 8; ++i) maybe[i] = 0;
    int32_t inner[MAX_BLOCK_ROWS + LANES];
    const int size = compact(maybe, count, int32_t(begin), inner);
    each_stop(job, inner, size, shadow, [&](int64_t row) {
      kept[row - begin] = 1;
      const int64_t last = shadow < end ? shadow : end;
      for (int64_t r = row + 1; r < last; ++r) kept[r - begin] = 0;
    });
  }

  if (job.runs) {
    while (run < job.num_runs && job.runs[2 * run + 1] <= begin) ++run;
    if (run == job.num_runs || job.runs[2 * run] > begin || job.runs[2 * run + 1] < end) keep_runs(job, run, begin, end, kept);
  }

  if (placement.inside) {
    if (job.view_test == FOOTPRINT && job.index.min_logits[block] < job.rule.logit_min) {
      const float* logits = job.logit_opacities + begin;
      for (int i = 0; i < count; ++i) kept[i] &= logits[i] >= job.rule.logit_min;
    }
    return compact(kept, count, int32_t(begin), out);
  }
  Rows drawn;
  drawn.size = compact(kept, count, int32_t(begin), drawn.row);
  drawn.pad();
  uint8_t visible[MAX_BLOCK_ROWS + LANES];
  ask_visible(job, drawn, visible);
  int size = 0;
  for (int i = 0; i < drawn.size; ++i) {
    out[size] = drawn.row[i];
    size += visible[i];
  }
  return size;
}

}  // namespace

RunResult select_group(const SelectJob& job, int64_t group, int32_t* out) {
  RunResult result = {0, 0};
  const int64_t rows_per_block = job.index.rows_per_block;
  const int64_t first_row = group * BLOCKS_PER_GROUP * rows_per_block;
  int64_t run = job.runs ? run_behind(job, first_row) : 0;
  const int64_t group_end = first_row + BLOCKS_PER_GROUP * rows_per_block;
  if (job.runs && (run == job.num_runs || job.runs[2 * run] >= group_end)) return result;
  if (place(job, job.index.groups, group).outside) return result;
  const int64_t num_blocks = (job.num_rows + rows_per_block - 1) / rows_per_block;
  int64_t block = group * BLOCKS_PER_GROUP;
  const int64_t last = block + BLOCKS_PER_GROUP < num_blocks ? block + BLOCKS_PER_GROUP : num_blocks;
  int64_t shadow = -1;  // not known
  while (block < last) {
    int64_t begin = block * rows_per_block;
    const int64_t end = begin + rows_per_block < job.num_rows ? begin + rows_per_block : job.num_rows;
    if (job.runs) {
      while (run < job.num_runs && job.runs[2 * run + 1] <= begin) ++run;
      if (run == job.num_runs) break;
      if (job.runs[2 * run] >= end) {
        shadow = -1;
        block = job.runs[2 * run] / rows_per_block;
        continue;
      }
    }
    const Placement placement = place(job, job.index.blocks, block);
    if (placement.outside) {
      shadow = -1;
      ++block;
      continue;
    }
    if (shadow < 0) shadow = shadow_before(job, block);
    if (shadow > begin) begin = shadow < end ? shadow : end;
    if (begin < end) {
      result.num_selected += select_rows(job, block, placement, begin, end, run, shadow, out + result.num_selected);
      result.num_visited += end - begin;
    }
    const int64_t next = shadow / rows_per_block;
    block = next > block ? next : block + 1;
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
