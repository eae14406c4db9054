// Partners that are kept from round to round while levels grow by pairs (lod/present.py).
#pragma once
#include <cstdint>

#include "cpu/build/pairs.h"

namespace splatree {

// How much of what is known of a row's partner still holds: it is the cheapest of the candidates; it was until others of them
// were merged; it is to be found.
constexpr uint8_t FOUND = 0, OUTDATED = 1, STALE = 2;

// What is kept of each row.
struct PartnerColumns {
  int32_t* neighbors;  // n PAIR_NEIGHBORS: candidates, −1 where there are fewer
  int32_t* rows;       // the cheapest of them, −1 if there is none
  float *costs, *opacities;
  float* least_sigmas;  // the longest axis of the two merged, without dilation, is no shorter
  uint8_t* states;      // FOUND, OUTDATED or STALE
};

// Looks for the nearest rows of all that have lost more than a quarter of their candidates; those are stale, too.
void find_neighbors(int64_t n, const float* means, const PartnerColumns& columns, int threads);

// What is known of some of n rows, without the others among their candidates.
void keep_partners(int64_t n, const uint8_t* is_kept, const PartnerColumns& from, const PartnerColumns& to, int threads);

// Finds the partner of a row among its candidates.
void find_partner(const PairRecord* records, int64_t row, double dilation, const PartnerColumns& columns);

// The longest axis of two merged, less what records add: standard deviation, world units.
float merged_sigma(const PairRecord& p, const PairRecord& q, double dilation);

// What a round merged: to[r] is r where it still stands for itself, and is_new[r] says whether r is of one of the pairs.
struct Moves {
  const int32_t* to;
  const uint8_t* is_new;
};

// Candidates of a row go where they went. That of two has the nearest of both one's candidates, by the new `means`; `other` is
// the second of the two, −1 for a row that was not merged.
void follow_moves(const Moves& moves, const float* means, int64_t row, int64_t other, const PartnerColumns& columns);

}  // namespace splatree
