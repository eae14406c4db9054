// Merged Gaussians that follow the pixel they are drawn at (reference/curves.py).
#pragma once
#include <cstdint>

namespace splatree {

struct CurvesJob {
  int64_t n;
  const int32_t* subtree_end;
  const float* seen;                  // n: visibilities; those of leaves are read
  const float* extents;               // n; null: the level of a node follows from its longest axis
  double kept_extent, kept_dilation;  // nodes of at most this extent keep their Gaussian, whose opacity is that at this h
  double dilation_share;              // h_l is this share of extent², or of the variance along the longest axis,
  double least_dilation;              // and at least this
  float *means, *quats, *log_scales, *logit_opacities;  // n: leaves are read, inner nodes written
  float* curves;                                        // n 4, out
  int threads;
};

void fit_curves(const CurvesJob& job);

}  // namespace splatree
