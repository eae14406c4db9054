// The division of ascending numbers into intervals with the least squared error: K-means in one dimension, exactly.
#pragma once
#include <cstdint>

namespace splatree {

// `mass`, `moment` and `square` are running sums of w, w x and w x² over ascending x, num_numbers + 1 of each, from 0 on.
// Interval j of the best `count` intervals, count ≤ num_numbers, is cuts[j] … cuts[j + 1] − 1.
void best_intervals(const double* mass, const double* moment, const double* square, int64_t num_numbers, int64_t count,
                    int64_t* cuts);

}  // namespace splatree
