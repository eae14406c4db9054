// A level of growth by pairs: the rounds that merge the Gaussians that are left (lod/present.py has the rules).
#pragma once
#include <cstdint>

#include "cpu/build/merge.h"
#include "cpu/build/partners.h"

namespace splatree {

struct LevelLimits {
  double cost;         // of a pair at most, world units²
  float sigma;         // of what it becomes at most, world units
  float small_sigma;   // a pair that becomes no longer than this is merged at any cost and of any size
  float saturated;     // a fitted opacity from here on gives way to the rule's; 0: none is fitted
  double dilation;     // variance added to every axis where costs are taken, world units²
  double round_share;  // pairs that a round merges at most, as a share of those present
  double last_share;   // a round that merges a smaller share is the last
  int64_t num_enough;  // so few need no further round
};

struct LevelJob {
  int64_t n;
  float *means, *quats, *log_scales, *logit_opacities, *sh;  // in place: the first of a pair becomes what both become
  float *weights, *visibilities;
  PartnerColumns partners;
  MergeJob rules;  // of merging: rule to `added`, and k
  LevelLimits limits;
  const uint8_t* is_frozen;  // n: rows that stay as they are, and hold up whose cheapest partner they are
  int32_t* row_from_row;     // out: the row that each has become part of
  int threads;
};

// Finds the partner of each row for which it is to be found. Limits and what is merged by are not looked at, but for the
// dilation.
void find_partners(const LevelJob& job);

// Returns how many rows are left, those that have become part of themselves.
int64_t merge_level(const LevelJob& job);

}  // namespace splatree
