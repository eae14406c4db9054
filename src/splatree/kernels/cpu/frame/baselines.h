// Rules of published methods (baselines.cpp).
#pragma once
#include <cstdint>

namespace splatree {

// Where a row lies to the depth that its distance asks for.
enum DepthFlag : uint8_t { ABOVE, AT, BELOW };

// From squared_edges[b - 1] to squared_edges[b] of squared distance the depth wanted is depths[b]; the last band has no end.
struct DistanceBands {
  const float* squared_edges;  // [count - 1], ascending
  const int32_t* depths;       // [count]
  int count;
};

// Widens the box of each row to hold those of all rows below it.
void nest_boxes(const uint8_t* depth, int64_t num_rows, float* lower, float* upper);

// small[i]: the longest side of the box is less than limit × its distance from the eye; never for an eye inside (H3DGS).
void flag_small_boxes(const float* lower, const float* upper, int64_t num_rows, const float* eye, float limit, int threads,
                      uint8_t* small);

// flags[i]: the depth of row i beside that of the band in which its mean lies (Octree-GS, FLoD, LODGE).
void flag_depths(const float* means, const uint8_t* depth, int64_t num_rows, const float* eye, const DistanceBands& bands,
                 int threads, uint8_t* flags);

// The first row on each path from a root that is a leaf or has a flag of at least `least`; returns how many. `rows` has room
// for num_rows.
int64_t first_stops(const uint8_t* flags, const int32_t* subtree_end, int64_t num_rows, uint8_t least, int32_t* rows);

}  // namespace splatree
