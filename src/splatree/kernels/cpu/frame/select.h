// Jobs of the selection (select.cpp) and of its block index (blocks.cpp).
#pragma once
#include <cstdint>

#include "shared/constants.h"
#include "shared/select.h"

namespace splatree {

constexpr int BLOCKS_PER_GROUP = constants::BLOCKS_PER_GROUP;
constexpr int BLOCK_STEPS = constants::BLOCK_STEPS;
constexpr int MAX_BLOCK_ROWS = 1024;

// Bounds of b runs of rows: lower and upper corners of the means, [b 3] each, and largest standard deviation of the leaves and
// of the rows that may be drawn beyond their extent. The steps, [b BLOCK_STEPS], say it of those that a view draws: from which
// extent on, and how large. Null where they are not known.
struct RunBounds {
  const float *lower, *upper, *leaf_scales, *step_extents, *step_scales;
};

struct BlockColumns {
  int rows_per_block;
  RunBounds blocks, groups;
  const float* min_logits;
  const uint8_t* size_classes;  // [n]
  const int32_t *ancestor_start, *ancestors;
};

struct SelectJob {
  // n rows
  const float *means, *quats, *log_scales, *logit_opacities, *extents;
  const int32_t* subtree_end;
  int64_t num_rows;
  View view;
  SelectRule rule;
  ViewTest view_test;
  bool all_small;  // τ_R is infinite
  bool cull;       // whether blocks are tested against the image
  BlockColumns index;
  // Runs of rows that may be drawn, begin and end, ascending; null: all rows.
  const int32_t* runs;
  int64_t num_runs;
  // Of a range of limits, from this one to that of the rule; a single cut has no other. Of so many blocks one is looked at.
  float fine_limit;
  int64_t every;
  ViewPlanes planes;
  double reach[NUM_SIDES];
  double eye[3];
};

// Rows that are drawn, and of a range of limits from which one on and up to which: null for a single cut.
struct CutRows {
  int32_t* rows;
  float *enters, *leaves;

  CutRows behind(int64_t count) const {
    return {rows + count, enters ? enters + count : nullptr, leaves ? leaves + count : nullptr};
  }
};

struct RunResult {
  int64_t num_selected, num_visited;
};

// Bounds of the blocks and groups of n rows, written to the arrays that RunBounds and BlockColumns describe.
struct BoundsJob {
  const float *means, *log_scales, *logit_opacities;
  const int32_t* subtree_end;
  const float* extents;
  int64_t num_rows;
  int rows_per_block, threads;
  float *lower, *upper, *leaf_scales, *step_extents, *step_scales, *min_logits, *group_lower, *group_upper, *group_leaf_scales;
  uint8_t* size_classes;
};

void bound_blocks(const BoundsJob& job);

// Ancestors of the first row of each block, root first, handed to visit() block by block.
void each_ancestors(const int32_t* subtree_end, int64_t num_rows, int rows_per_block,
                    void (*visit)(void* context, const int32_t* ancestors, int64_t count), void* context);

}  // namespace splatree
