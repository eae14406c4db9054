// Radius thinning: the parallel form of the sequential greedy (reference/thin.py), with exactly its result.
#pragma once
#include <cstdint>

#include "cpu/build/pairs.h"

namespace splatree {

struct ThinJob {
  int64_t n;
  const float* means;                // n × 3
  const float* colors;               // n × 3
  const float* importance;           // n
  double radius;                     // r, world units
  double color_radius;               // ρ; infinity leaves colour out
  const uint8_t* is_open;            // n: rows of which nothing is known; null: none, the scene is whole
  int32_t* representative_from_row;  // n, out; -1 for members unless `assign`, and where it is not certain
  bool assign;                       // whether members look for their nearest representative
  const PairRecord* records;         // n: what merging a row with its representative would change; null: that does not count
  float most;                        // the largest such change, E of pairs.h, world units²
  int32_t rounds;                    // out
  int64_t num_visited;               // out: candidates looked at
  int threads;
};

void thin(ThinJob& job);

// Distance from each query row to its nearest other point if that is at most `edge`, else infinity.
void nearest_distances(int64_t n, const float* means, int64_t num_queries, const int32_t* queries, double edge, double* distances,
                       int threads);

}  // namespace splatree
