// Merged Gaussians that follow the pixel they are drawn at (reference/curves.py).
#pragma once
#include <cstdint>

namespace splatree {

struct CurvesJob {
  int64_t n;
  const int32_t* subtree_end;
  const float* seen;                  // n: visibilities; those of leaves are read
  const float* extents;               // n
  double kept_extent, kept_dilation;  // nodes of at most this extent keep their Gaussian, whose opacity is that at this h
  double dilation_share;              // h_l is this share of extent²,
  double least_dilation;              // and at least this
  float *means, *quats, *log_scales, *logit_opacities;  // n: leaves are read, inner nodes written
  float* curves;                                        // n 4, out
  // Rows whose leaves stand for leaves elsewhere, such as the roots of parts:
  const double* below;  // leaves MOMENTS: the moments of what each leaf stands for; null: leaves are Gaussians
  const double* sums;   // inner nodes 2: what the leaves below show at h_l, by `add_shown`
  int threads;
};

void fit_curves(const CurvesJob& job);

constexpr int MOMENTS = 13;  // mean 3, covariance 6, Σ α, Σ α v, 3 Σ α A(0), 3 Σ α v A(0)

// The moments of each root, in the order of the rows: roots MOMENTS.
void root_moments(const CurvesJob& job, double* moments);

struct ShownJob {
  int64_t first, n, num_nodes;                       // leaves first … first + n of a list
  const float *log_scales, *logit_opacities, *seen;  // of these leaves
  const int64_t *begin, *end;                        // the leaves below each node, a range of the list
  const double* dilations;                           // of each node
  double* sums;                                      // nodes 2: Σ α 3A(h), Σ α v 3A(h), to which these leaves are added
  int threads;
};

void add_shown(const ShownJob& job);

}  // namespace splatree
