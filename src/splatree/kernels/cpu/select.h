// Jobs of the selection (select.cpp) and of its block index (blocks.cpp).
#pragma once
#include <cstdint>

#include "shared/select.h"

namespace splatree {

enum Visibility { FOOTPRINT, CENTRE, UNSEEN_TOO };

constexpr int BLOCKS_PER_GROUP = 64;
constexpr int MAX_BLOCK_ROWS = 1024;

// The class of an inner row is the whole part of 8 log2 σ_mid + 128, held in 0 to 254. By interlacing, the larger eigenvalue of
// its splat is at least (σ_mid f / z)²: with M = J W = f/z (I | -u) in camera axes, M Mᵀ is at least (f/z)².
constexpr int LEAF_CLASS = 255, CLASS_OF_UNIT = 128, CLASSES_PER_OCTAVE = 8;

// Bounds of b runs of rows: lower and upper corners of the means, [b 3] each, and largest standard deviation of the leaves.
struct RunBounds {
  const float *lower, *upper, *leaf_scales;
};

struct BlockColumns {
  int rows_per_block;
  RunBounds blocks, groups;
  const float* min_logits;
  const uint8_t* size_classes;  // [n]
  const int32_t *ancestor_start, *ancestors;
};

// The view as planes in the world: the value of each at p is x p.x + y p.y + z p.z + d. The sides are the image's borders and
// the near plane. A splat of standard deviation s is out of view if the value of OUTSIDE + i at its mean is above reach[i] s for
// any side i; a mean whose values of INSIDE + i are all below 0 is in the image, half a pixel at least from its border. The
// value of DEPTH_PLANE is the view depth.
constexpr int NUM_SIDES = 5, OUTSIDE = 0, INSIDE = 5, DEPTH_PLANE = 10, NUM_PLANES = 12;

struct ViewPlanes {
  double x[NUM_PLANES], y[NUM_PLANES], z[NUM_PLANES], d[NUM_PLANES];  // the last one is zero: vectors are full
};

struct SelectJob {
  // n rows
  const float *means, *quats, *log_scales, *logit_opacities, *extents;
  const int32_t* subtree_end;
  int64_t num_rows;
  View view;
  SelectRule rule;
  Visibility visibility;
  bool all_small;  // τ_R is infinite
  bool cull;       // whether blocks are tested against the image
  BlockColumns index;
  ViewPlanes planes;
  double reach[NUM_SIDES];
  double eye[3];
};

struct RunResult {
  int64_t num_selected, num_visited;
};

// Bounds of the blocks and groups of n rows, written to the arrays that RunBounds and BlockColumns describe.
struct BoundsJob {
  const float *means, *log_scales, *logit_opacities;
  const int32_t* subtree_end;
  int64_t num_rows;
  int rows_per_block, threads;
  float *lower, *upper, *leaf_scales, *min_logits, *group_lower, *group_upper, *group_leaf_scales;
  uint8_t* size_classes;
};

void bound_blocks(const BoundsJob& job);

// Ancestors of the first row of each block, root first, handed to visit() block by block.
void each_ancestors(const int32_t* subtree_end, int64_t num_rows, int rows_per_block,
                    void (*visit)(void* context, const int32_t* ancestors, int64_t count), void* context);

}  // namespace splatree
