// Job of the backward pass over the pixels.
#pragma once
#include <cstdint>

#include "shared/sums.h"

namespace splatree {

struct BlendBackwardJob {
  const float* records;            // v splats
  const int64_t* tile_start;       // t + 1
  const int32_t* splat_from_pair;  // m
  int64_t num_splats;
  int num_tiles_x, num_tiles_y;
  int width, height;     // px
  float log2_threshold;  // smallest opacity drawn at a pixel
  float background[3];
  const float *image, *alpha, *depth;           // h w 3, h w, h w: the picture
  const float *by_image, *by_alpha, *by_depth;  // the same: derivatives; null: 0
  const float* errors;                          // h w; null: not asked for
  int threads;
  float *moments, *colors, *depths, *weights, *error_sums;  // v 6, v 3, v, v, v; the last three null if not asked for
};

// Sums of pairs, one after the other; pairs that touched no pixel that takes light have none.
struct PairSums {
  float* sums;       // m NUM_SUMS
  uint8_t* touched;  // m
};

// Adds up the pairs of each splat, tile by tile (splat_sums.cpp).
void sum_pairs(const BlendBackwardJob& job, const PairSums& pairs);

}  // namespace splatree
