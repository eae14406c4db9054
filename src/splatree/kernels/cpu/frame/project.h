// Jobs of the projection (project.cpp) and of the depth order (order.cpp).
#pragma once
#include <cstdint>

#include "shared/project.h"

namespace splatree {

struct ProjectJob {
  // n rows of Gaussians, as stored
  const float *means, *quats, *log_scales, *logit_opacities, *sh;
  const float* curves;   // n 4, how rows follow the pixel; null: all are drawn as stored
  int num_coefficients;  // of sh, a channel
  int degree;            // evaluated
  View view;
  bool is_square;  // whether a splat is seen if its square is, instead of its box
  Square square;
  const int32_t* rows;  // v rows to project
  int64_t num_rows;
  int threads;
  // capacity v each
  int32_t* out_rows;
  float* out_records;
  float* out_depths;  // the column of the records once more, dense for the sort
};

constexpr int PROJECT_CHUNK = 512;  // rows

// order[i] is the index of the i-th nearest of v splats; equal depths by ids[rows[.]], or by rows[.] without ids.
void order_by_depth(const float* depths, const int32_t* rows, const uint32_t* ids, int64_t num_splats, int threads,
                    int32_t* order);

}  // namespace splatree
