// Jobs of the clusters' spheres and boxes (spheres.cpp).
#pragma once
#include <cstdint>

namespace splatree {

struct SpheresJob {
  const float *means, *quats, *log_scales, *logit_opacities;  // n rows
  const int32_t* start;                                       // c + 1
  const float* centers;                                       // c 3
  float *radii, *mean_radii, *footprint_radii;                // c
  float *box_low, *box_high;                                  // c 3
};

}  // namespace splatree
