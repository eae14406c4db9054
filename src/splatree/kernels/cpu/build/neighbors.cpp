// The nearest neighbours of the points of a leaf: one walk from the root for all of them, the nearer child first, which passes
// over boxes farther than the farthest neighbour that any of them has so far.
//
// The points of the leaf are the lanes of a vector. A candidate is put into the sorted lists of all lanes at once, without a
// branch: D[k] ← max(D[k − 1], min(d, D[k])), and its place likewise. Cost: about 12 instructions a candidate, and 60 where a
// lane takes it.
#include "cpu/build/neighbors.h"

#include "cpu/runtime/isa.h"

namespace splatree::SPLATREE_ISA {
namespace {

constexpr int LAST = PAIR_NEIGHBORS - 1;

SPLATREE_FN float squared(float x) { return x * x; }

float farthest(const LeafNeighbors& found) {
  float most = found.distances2[LAST][0];
  for (int l = 1; l < LEAF_POINTS; ++l) most = greatest(found.distances2[LAST][l], most);
  return most;
}

// Whether some point of the leaf is nearer to the box than to its farthest neighbour.
bool is_near(const BoxLeaf& own, const Box& box, const LeafNeighbors& found) {
  int near = 0;
#pragma omp simd reduction(| : near)
  for (int l = 0; l < LEAF_POINTS; ++l) {
    const float gap_x = greatest(greatest(box.lower[0] - own.x[l], own.x[l] - box.upper[0]), 0.f);
    const float gap_y = greatest(greatest(box.lower[1] - own.y[l], own.y[l] - box.upper[1]), 0.f);
    const float gap_z = greatest(greatest(box.lower[2] - own.z[l], own.z[l] - box.upper[2]), 0.f);
    near |= squared(gap_x) + squared(gap_y) + squared(gap_z) < found.distances2[LAST][l];
  }
  return near != 0;
}

// Puts a point into the lists of those lanes that have a farther one, after those as far; never into its own.
void offer(float x, float y, float z, int32_t place, int self, const BoxLeaf& own, LeafNeighbors& found) {
  alignas(32) float d[LEAF_POINTS];
  int near = 0;
#pragma omp simd reduction(| : near)
  for (int l = 0; l < LEAF_POINTS; ++l) {
    const float distance2 = squared(own.x[l] - x) + squared(own.y[l] - y) + squared(own.z[l] - z);
    d[l] = l == self ? float_of(0x7f800000) : distance2;
    near |= d[l] < found.distances2[LAST][l];
  }
  if (!near) return;
  for (int k = LAST; k > 0; --k) {
    float *here = found.distances2[k], *before = found.distances2[k - 1];
    int32_t *places = found.places[k], *places_before = found.places[k - 1];
#pragma omp simd
    for (int l = 0; l < LEAF_POINTS; ++l) {
      const int32_t kept = d[l] < here[l] ? place : places[l];
      places[l] = d[l] < before[l] ? places_before[l] : kept;
      const float nearer = d[l] < here[l] ? d[l] : here[l];
      here[l] = d[l] < before[l] ? before[l] : nearer;
    }
  }
#pragma omp simd
  for (int l = 0; l < LEAF_POINTS; ++l) {
    found.places[0][l] = d[l] < found.distances2[0][l] ? place : found.places[0][l];
    found.distances2[0][l] = d[l] < found.distances2[0][l] ? d[l] : found.distances2[0][l];
  }
}

}  // namespace

void nearest_of_leaf(const BoxTree& tree, int64_t leaf, LeafNeighbors& found) {
  const BoxLeaf& own = tree.leaves[leaf];
  const Box* leaf_boxes = tree.boxes + (tree.num_leaves - 1);
  float bound = farthest(found);
  each_leaf(tree, leaf_boxes[leaf], bound, [&](int64_t other) {
    if (!is_near(own, leaf_boxes[other], found)) return bound;
    const BoxLeaf& there = tree.leaves[other];
    const int64_t first = first_of(tree, other);
    const int count = static_cast<int>(first_of(tree, other + 1) - first);
    for (int i = 0; i < count; ++i)
      offer(there.x[i], there.y[i], there.z[i], static_cast<int32_t>(first + i), other == leaf ? i : -1, own, found);
    return bound = farthest(found);
  });
}

}  // namespace splatree::SPLATREE_ISA
