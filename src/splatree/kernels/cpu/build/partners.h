// Partners that are kept from round to round while levels grow by pairs (lod/grow_pairs.py).
#pragma once
#include <cstdint>

#include "cpu/build/pairs.h"

namespace splatree {

// What is kept of each row.
struct PartnerColumns {
  int32_t* neighbors;  // n PAIR_NEIGHBORS: candidates, −1 where there are fewer
  int32_t* rows;       // the cheapest of them, −1 if there is none
  float *costs, *opacities;
  float* sigmas;      // longest axis of the two merged, without dilation
  uint8_t* is_stale;  // whether the partner has to be found
};

// Looks for the nearest rows of all that have lost more than a quarter of their candidates; those are stale, too.
void find_neighbors(int64_t n, const float* means, const PartnerColumns& columns, int threads);

// Finds the partners of all rows that are stale. The outputs of the job are not used.
void find_partners(const PairJob& job, const PartnerColumns& columns);

// Groups of one or two of n rows that became one: rows[start[g] : start[g + 1]].
struct PairGroups {
  int64_t num_groups;
  const int64_t* start;
  const int32_t *rows, *representatives, *group_from_row;
};

// What is kept of the groups, with their `means`: neighbours go where they went; two that became one have the nearest of both; a
// partner is stale once one of the two was merged.
void carry_partners(const PairGroups& groups, const float* means, const PartnerColumns& from, const PartnerColumns& to,
                    int threads);

}  // namespace splatree
