// The nearest of many centres for points of few dimensions: what K-means spends its time on.
//
// Centres are kept in blocks of 16 lanes, dimension by dimension, so that a step of the inner loop multiplies one coordinate of
// a point with those of 16 centres. The score |c|²/2 − x·c orders centres as the distance does.
#pragma once
#include <cstdint>

namespace splatree {

constexpr int64_t LANES = 16;
constexpr int64_t POINTS_AT_ONCE = 4;  // share the loads of a block: 8 accumulators fit the registers of x86-64-v3

// Blocks of centres: block × (dims + 1) × 16; the last plane holds |c|²/2, infinity where a lane has no centre.
struct Centres {
  const float* blocks;
  int64_t num_blocks;
  int64_t dims;
};

// For each of four points and each lane, the least score of the lane's centres and the block that has it.
struct LaneMinima {
  alignas(64) float score[POINTS_AT_ONCE][LANES];
  alignas(64) int32_t block[POINTS_AT_ONCE][LANES];
};

// For each of four points the nearest centre and its score.
struct NearestCentres {
  float score[POINTS_AT_ONCE];
  int32_t centre[POINTS_AT_ONCE];
};

// out[i × dims + d] = Σ_j (vectors[i × stride + j] − origin[j]) axes[j × padded + d], j < width; `padded` is the next multiple
// of 16 from `dims` on, and the columns of `axes` beyond `dims` are zero.
struct AxesJob {
  const float* vectors;
  int64_t stride, width;
  const float *origin, *axes;
  int64_t dims;
  float* out;
};

}  // namespace splatree
