// Merging the Gaussians of each group into one (reference/merge.py).
#pragma once
#include <cstdint>

namespace splatree {

enum class MergeRule { MEAN, MOMENTS };
enum class OpacityRule { UNION, MASS, STANDARD, OPTICAL };

struct GaussianColumns {
  const float *means, *quats, *log_scales, *logit_opacities, *sh;
};

struct MergeJob {
  int64_t num_groups;
  int64_t k;  // harmonics of a channel
  GaussianColumns in;
  const float* weights;            // n
  const int64_t* start;            // num_groups + 1
  const int32_t* rows;             // members of group g: rows[start[g] : start[g + 1]]
  const int32_t* representatives;  // num_groups
  MergeRule rule;
  OpacityRule opacity;
  bool keep_position;           // the representative's position instead of the centroid
  double scale_bound;           // κ; infinity: none
  double widening, mass_limit;  // of OpacityRule::STANDARD
  double dilation;              // variance added to areas, in units of the merged σ_max²
  double added;                 // and in world units²
  const float* opacities;       // num_groups, may be null: where above 0, what a group of two or more gets in place of the rule's
  float *means, *quats, *log_scales, *logit_opacities, *sh;  // out, one row a group
  int threads;
};

void merge(const MergeJob& job);

// Rows by group: start (num_groups + 1) and rows (n), rows rising inside each group.
void group_rows(int64_t n, const int32_t* group_from_row, int64_t num_groups, int64_t* start, int32_t* rows);

// Harmonics of inner nodes from their children's, in place, for a tree in preorder: sh[i] = Σ w_c sh_c / Σ w_c.
void average_children(int64_t n, int64_t width, const int32_t* subtree_end, const float* weights, float* values, int threads);

}  // namespace splatree
