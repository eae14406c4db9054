// Job of the backward pass of the projection.
#pragma once
#include <cstdint>

#include "shared/project.h"

namespace splatree {

struct ProjectBackwardJob {
  // n rows of Gaussians, as stored
  const float *means, *quats, *log_scales, *logit_opacities, *sh;
  int num_coefficients;  // of sh, a channel
  int degree;            // evaluated
  View view;
  const int32_t* rows;   // v rows
  const float* records;  // v splats
  int64_t num_splats;
  const float *moments, *colors, *depths;  // v 6, v 3, v: sums over the pixels; depths null: 0
  int threads;
  // capacity v each
  float *by_means, *by_quats, *by_log_scales, *by_logit_opacities, *by_sh;
};

}  // namespace splatree
