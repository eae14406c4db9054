// The cut by blocks of consecutive rows in preorder; kernels/reference/select.py is the definition.
//
// Any ancestor of a row in a block that lies before the block is an ancestor of the block's first row. So a block is decided
// alone: the largest subtree_end of those ancestors that stop says which of its rows are shadowed from outside. Walking on
// from a block that was decided, the shadow is known without asking; where it covers whole blocks they are jumped over.
//
// In a block, only what is needed is computed, and in this order:
//   1. nothing, if its bound is out of the image or it lies in a shadow;
//   2. which rows have children; if the bound says that all of these are large, they are refined without a look at them;
//   3. for the inner rows, bounds of the radius from the scales; for those left open and not shadowed, the covariance;
//   4. shadows within the block;
//   5. for rows kept, visibility: nothing if the block is well inside the image, else from bounds, else from the covariance.
// 3 and 5 run in full vectors of 16 gathered rows, so a row's answer does not depend on its place; bounds never contradict
// the full computation. The result is the same for any size of block.
#include "cpu/select.h"

#include "cpu/isa.h"

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

void answer_small_bounds(const SelectJob& job, const int32_t* rows, Planes& p) {
  gather<3>(job.means, rows, p.mean);
  if (job.rule.sphere) {
    gather<1>(job.extents, rows, &p.extent);
#pragma omp simd
    for (int l = 0; l < LANES; ++l)
      p.answer[l] = is_small_ball(job.rule, point_of(job.view, p.mean[0][l], p.mean[1][l], p.mean[2][l]), p.extent[l]);
    return;
  }
  gather<3>(job.log_scales, rows, p.log_scale);
#pragma omp simd
  for (int l = 0; l < LANES; ++l)
    p.answer[l] = is_small_bound(job.view, job.rule, point_of(job.view, p.mean[0][l], p.mean[1][l], p.mean[2][l]),
                                 {p.log_scale[0][l], p.log_scale[1][l], p.log_scale[2][l]});
}

void answer_small(const SelectJob& job, const int32_t* rows, Planes& p) {
  gather<3>(job.means, rows, p.mean);
  gather<3>(job.log_scales, rows, p.log_scale);
  gather<4>(job.quats, rows, p.quat);
#pragma omp simd
  for (int l = 0; l < LANES; ++l) {
    const Point point = point_of(job.view, p.mean[0][l], p.mean[1][l], p.mean[2][l]);
    const Covariance c =
        covariance_of(factor_of(job.view, point, p.quat[0][l], p.quat[1][l], p.quat[2][l], p.quat[3][l],
                                {p.log_scale[0][l], p.log_scale[1][l], p.log_scale[2][l]}));
    p.answer[l] = is_small(job.view, job.rule, point, c);
  }
}

void answer_visible_bounds(const SelectJob& job, const int32_t* rows, Planes& p) {
  gather<3>(job.means, rows, p.mean);
  if (job.visibility == CENTRE) {
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
    const Covariance c =
        covariance_of(factor_of(job.view, point, p.quat[0][l], p.quat[1][l], p.quat[2][l], p.quat[3][l],
                                {p.log_scale[0][l], p.log_scale[1][l], p.log_scale[2][l]}));
    p.answer[l] = is_visible(job.view, point, c, p.logit[l]);
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

// Asks `bound`, and where it leaves the answer open, `full`. Rows that were answered YES before an open one may have made the
// question void: settle(answers) is called once between and may turn OPEN into NO.
template <class Settle>
void answer(const SelectJob& job, Answers bound, Answers full, const Rows& rows, uint8_t* answers, const Settle& settle) {
  ask_all(job, bound, rows, answers);
  settle(answers);
  Rows open;
  int32_t place[MAX_BLOCK_ROWS + LANES];
  for (int i = 0; i < rows.size; ++i) {
    open.row[open.size] = rows.row[i];
    place[open.size] = i;
    open.size += answers[i] == OPEN;
  }
  if (!open.size) return;
  open.pad();
  uint8_t full_answers[MAX_BLOCK_ROWS + LANES];
  ask_all(job, full, open, full_answers);
  for (int i = 0; i < open.size; ++i) answers[place[i]] = full_answers[i];
}

void answer_small_rows(const SelectJob& job, const Rows& rows, uint8_t* answers) {
  if (job.all_small) {
    for (int i = 0; i < rows.size; ++i) answers[i] = YES;
    return;
  }
  const int32_t* end = job.subtree_end;
  answer(job, answer_small_bounds, answer_small, rows, answers, [&](uint8_t* found) {
    int64_t shadow = 0;
    for (int i = 0; i < rows.size; ++i) {
      if (rows.row[i] < shadow)
        found[i] = NO;
      else if (found[i] == YES)
        shadow = end[rows.row[i]];
    }
  });
}

// How a run of rows lies to the image.
struct Placement {
  bool outside, inside;
  double depth_max;
};

// Smallest and largest value of a plane over a box.
struct Range {
  double low, high;
};

Range range_over(const Plane& plane, const float* lower, const float* upper) {
  double center = plane.d, half = 0;
  for (int i = 0; i < 3; ++i) {
    center += 0.5 * plane.n[i] * (double(upper[i]) + lower[i]);
    half += 0.5 * __builtin_fabs(plane.n[i]) * (double(upper[i]) - lower[i]);
  }
  return {center - half, center + half};
}

Placement place(const SelectJob& job, const RunBounds& bounds, int64_t run) {
  const float *lower = bounds.lower + 3 * run, *upper = bounds.upper + 3 * run;
  Placement found = {false, true, range_over(job.depth, lower, upper).high};
  if (!job.cull) {
    found.inside = job.visibility == UNSEEN_TOO;
    return found;
  }
  double scale = bounds.leaf_scales[run];
  if (job.rule.sphere) {
    // An inner row that is drawn has 3σ <= extent <= τ_R (distance - extent) / f.
    double squared = 0;
    for (int i = 0; i < 3; ++i) {
      const double below = job.eye[i] - lower[i], above = upper[i] - job.eye[i];
      const double far = below > above ? below : above;
      squared += far * far;
    }
    const double drawn = job.rule.pixel_error / (3.0 * job.rule.focal_max) * __builtin_sqrt(squared);
    scale = drawn > scale ? drawn : scale;
  }
  for (const ViewSide& side : job.sides) {
    if (range_over(side.outside, lower, upper).low > side.reach * scale) found.outside = true;
    if (!(range_over(side.inside, lower, upper).high < 0)) found.inside = false;
  }
  return found;
}

// The end of the shadow in which a block begins, 0 if none.
int64_t shadow_before(const SelectJob& job, int64_t block) {
  int64_t shadow = 0;
  const int32_t begin = job.index.ancestor_start[block], end = job.index.ancestor_start[block + 1];
  Rows rows;
  uint8_t answers[MAX_BLOCK_ROWS + LANES];
  for (int32_t i = begin; i < end; ++i) {
    rows.row[rows.size++] = job.index.ancestors[i];
    if (rows.size < MAX_BLOCK_ROWS && i + 1 < end) continue;
    rows.pad();
    answer_small_rows(job, rows, answers);
    for (int j = 0; j < rows.size; ++j)
      if (answers[j] == YES && job.subtree_end[rows.row[j]] > shadow) shadow = job.subtree_end[rows.row[j]];
    rows.size = 0;
  }
  return shadow;
}

// Whether the inner rows of a block are all larger than τ_R, from the bound of their scales.
bool all_large(const SelectJob& job, int64_t block, double depth_max) {
  if (job.rule.sphere || job.all_small) return false;
  const double below = job.index.inner_scales[block] * job.rule.focal_min / depth_max;
  return depth_max > 0 && below * below + job.rule.add > job.rule.limit * (2 * MARGIN - 1);
}

int append(const uint8_t* kept, int64_t begin, int count, int32_t* out) {
  int size = 0;
  for (int i = 0; i < count; ++i) {
    out[size] = int32_t(begin + i);
    size += kept[i];
  }
  return size;
}

// The rows drawn of [begin, end), a part of a block that starts outside of any shadow; moves `shadow` on.
int select_rows(const SelectJob& job, int64_t block, const Placement& placement, int64_t begin, int64_t end, int64_t& shadow,
                int32_t* out) {
  const int count = int(end - begin);
  const int32_t* subtree_end = job.subtree_end + begin;
  alignas(64) uint8_t kept[MAX_BLOCK_ROWS + LANES];
  for (int i = 0; i < count; ++i) kept[i] = subtree_end[i] == int32_t(begin) + i + 1;

  if (!all_large(job, block, placement.depth_max)) {
    Rows inner;
    for (int i = 0; i < count; ++i) {
      inner.row[inner.size] = int32_t(begin) + i;
      inner.size += !kept[i];
    }
    inner.pad();
    uint8_t small[MAX_BLOCK_ROWS + LANES];
    answer_small_rows(job, inner, small);
    for (int j = 0; j < inner.size; ++j) {
      const int64_t row = inner.row[j];
      if (row < shadow || small[j] != YES) continue;
      shadow = job.subtree_end[row];
      kept[row - begin] = 1;
      const int64_t last = shadow < end ? shadow : end;
      for (int64_t r = row + 1; r < last; ++r) kept[r - begin] = 0;
    }
  }

  const bool opaque = job.visibility != FOOTPRINT || job.index.min_logits[block] >= job.rule.logit_min;
  if (placement.inside && opaque) return append(kept, begin, count, out);
  Rows drawn;
  drawn.size = append(kept, begin, count, drawn.row);
  drawn.pad();
  uint8_t visible[MAX_BLOCK_ROWS + LANES];
  answer(job, answer_visible_bounds, answer_visible, drawn, visible, [](uint8_t*) {});
  int size = 0;
  for (int i = 0; i < drawn.size; ++i) {
    out[size] = drawn.row[i];
    size += visible[i] == YES;
  }
  return size;
}

}  // namespace

RunResult select_group(const SelectJob& job, int64_t group, int32_t* out) {
  RunResult result = {0, 0};
  if (place(job, job.index.groups, group).outside) return result;
  const int64_t rows_per_block = job.index.rows_per_block;
  const int64_t num_blocks = (job.num_rows + rows_per_block - 1) / rows_per_block;
  int64_t block = group * BLOCKS_PER_GROUP;
  const int64_t last = block + BLOCKS_PER_GROUP < num_blocks ? block + BLOCKS_PER_GROUP : num_blocks;
  int64_t shadow = -1;  // not known
  while (block < last) {
    int64_t begin = block * rows_per_block;
    const int64_t end = begin + rows_per_block < job.num_rows ? begin + rows_per_block : job.num_rows;
    const Placement placement = place(job, job.index.blocks, block);
    if (placement.outside) {
      shadow = -1;
      ++block;
      continue;
    }
    if (shadow < 0) shadow = shadow_before(job, block);
    if (shadow > begin) begin = shadow < end ? shadow : end;
    if (begin < end) {
      result.num_selected += select_rows(job, block, placement, begin, end, shadow, out + result.num_selected);
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
    if (job.all_small)
      for (int i = 0; i < list.size; ++i) answers[i] = YES;
    else
      answer(job, answer_small_bounds, answer_small, list, answers, [](uint8_t*) {});
    for (int i = 0; i < list.size; ++i) small[begin + i] = answers[i] == YES;
  }
}

void visible_rows(const SelectJob& job, const int32_t* rows, int64_t count, uint8_t* visible) {
  Rows list;
  uint8_t answers[MAX_BLOCK_ROWS + LANES];
  for (int64_t begin = 0; begin < count; begin += MAX_BLOCK_ROWS) {
    list.size = count - begin < MAX_BLOCK_ROWS ? int(count - begin) : MAX_BLOCK_ROWS;
    for (int i = 0; i < list.size; ++i) list.row[i] = rows[begin + i];
    list.pad();
    answer(job, answer_visible_bounds, answer_visible, list, answers, [](uint8_t*) {});
    for (int i = 0; i < list.size; ++i) visible[begin + i] = answers[i] == YES;
  }
}

}  // namespace splatree::SPLATREE_ISA
