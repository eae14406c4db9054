// Merging pair by pair: the cheapest partner of each Gaussian among its nearest neighbours, and a matching of the cheapest
// (reference/pairs.py).
#pragma once
#include <cstdint>
#include <vector>

#include "cpu/runtime/radix.h"
#include "cpu/runtime/scratch.h"

namespace splatree {

constexpr int PAIR_NEIGHBORS = 8;

// What the cost of a pair needs of a Gaussian: a cache line.
struct PairRecord {
  float mean[3];
  float covariance[6];  // xx xy xz yy yz zz, dilated
  float color[3];       // linear RGB
  float opacity;        // times the visibility
  float visibility, weight;
  float energy;  // α² |(c, 1)|² Σ √det over the three coordinate planes: what it shows, squared
};
static_assert(sizeof(PairRecord) == 64, "one cache line");

struct PairJob {
  int64_t n;
  const float *means, *quats, *log_scales, *logit_opacities, *sh, *weights;
  const float* visibilities;  // null: all 1
  int64_t k;                  // harmonics of a channel
  double dilation;            // variance added to every axis, world units²
  int32_t* partner_from_row;  // out: the neighbour that costs least; -1 if there is none
  float* costs;               // out: infinity if there is none
  float* opacities;           // out: of the merged Gaussian
  int threads;
};

PairRecord record_of(const PairJob& job, int64_t row);

void best_partners(const PairJob& job);

// Costs of merging one Gaussian with each of up to PAIR_NEIGHBORS others; the opacity that costs least for each.
struct PairCandidates {
  const PairRecord* self;
  const PairRecord* others[PAIR_NEIGHBORS];  // none is null: those from `count` on repeat another
  int count;
};
struct PairCost {
  int best;  // index into others
  float cost, opacity;
};

// A row and the partner that it found.
struct FoundPair {
  int32_t finder, partner;
};

// A row that may merge with its partner, as it is sorted.
KeyRow by_cost(float cost, int64_t row);

// Of the listed rows, the pairs (row, its partner) of least cost, ties by place in the list, at most `max_pairs`; rows that are
// taken already take no part, and those of the pairs are marked as taken.
std::vector<FoundPair> cheapest_pairs(Scratch<KeyRow>& listed, int64_t num_listed, const int32_t* partner_from_row,
                                      int64_t max_pairs, uint8_t* is_taken, int threads);

// The same of all rows that have a partner, ties by row: rows point to the row that stands for them, themselves or the finder of
// their pair. Returns how many pairs there are.
int64_t match_pairs(int64_t n, const int32_t* partner_from_row, const float* costs, int64_t max_pairs,
                    int32_t* representative_from_row, int threads);

}  // namespace splatree
