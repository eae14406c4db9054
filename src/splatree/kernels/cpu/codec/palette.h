// Vector quantisation on two levels: coarse groups of points, K-means inside each group, and the search of a point's nearest
// entry among those of a few near groups. kernels/reference/palette.py says what each function gives.
#pragma once
#include <cstdint>

namespace splatree {

// Row-major points.
struct Points {
  const float* values;
  int64_t count, dims;
};

// near[i × num_near + j]: the centres nearest to point i, nearest first, at most one of each class c mod 16.
void nearest_few(const Points& points, const float* centres, int64_t num_centres, int64_t num_near, int32_t* near, int threads);

// centres[c], first_centre[g] ≤ c < first_centre[g + 1]: K-means of the points rows[start[g]] … rows[start[g + 1] − 1].
void split_groups(const Points& points, const float* weights, const int64_t* start, const int32_t* rows,
                  const int64_t* first_centre, int64_t num_groups, int iterations, float* centres, int threads);

// label[i]: the centre nearest to point i among those of its num_near groups.
void nearest_in_groups(const Points& points, const float* centres, const int64_t* first_centre, int64_t num_groups,
                       const int32_t* near, int64_t num_near, int32_t* label, int threads);

// means[l × width + j]: weighted mean of vectors[i × stride + j] over the rows i with label l; zero where no row has it.
void label_means(const float* vectors, int64_t stride, int64_t width, const float* weights, const int64_t* start,
                 const int32_t* rows, int64_t num_labels, float* means, int threads);

// Adds each row i, weighted, to the `width` sums of its label, and its weight to the one behind them.
void add_to_sums(const float* vectors, int64_t stride, int64_t width, const float* weights, const int32_t* labels,
                 int64_t num_rows, double* sums);

// The different rows found so far: entries by their first appearance, and an open table of their numbers, at most half full.
struct DistinctRows {
  int64_t limit;
  float* entries;            // limit × width
  int64_t num_slots;         // a power of two
  int32_t* label_from_slot;  // -1: free
};

// Numbers rows that have the same bits alike, going on from `count` known ones. Returns how many there are now, or -1 as soon
// as there are more than the limit.
int64_t distinct_rows(const float* vectors, int64_t stride, int64_t width, int64_t num_rows, const DistinctRows& known,
                      int64_t count, int32_t* label);

}  // namespace splatree
