// All points of a leaf look for their neighbours in one walk from the root, the nearer child first, which passes over boxes
// farther than the farthest neighbour that any of them has so far. Cost: about one and a half microseconds a point.
// Not vectorised but for the distances to a leaf: the walk is branchy.
#include "cpu/neighbors.h"

#include <algorithm>
#include <utility>

namespace splatree {
namespace {

float distance2(const float* p, const Box& box) {
  float sum = 0;
  for (int a = 0; a < 3; ++a) {
    const float gap = std::max({box.lower[a] - p[a], p[a] - box.upper[a], 0.0f});
    sum += gap * gap;
  }
  return sum;
}

}  // namespace

void find_nearest(const BoxTree& tree, int64_t leaf, Nearest* nearest) {
  const int64_t begin = first_of(tree, leaf), end = first_of(tree, leaf + 1);
  const Box& own = tree.boxes[tree.num_leaves - 1 + leaf];
  const BoxLeaf& here = tree.leaves[leaf];
  struct Entry {
    int64_t node;
    float distance2;
  } stack[128];
  int size = 0;
  stack[size++] = {0, 0.0f};
  float bound = HUGE_VALF;
  while (size > 0) {
    const Entry entry = stack[--size];
    if (entry.distance2 > bound) continue;
    if (!is_leaf(tree, entry.node)) {
      const int64_t left = 2 * entry.node + 1;
      Entry near{left, least_squared_distance(tree.boxes[left], own)}, far{left + 1, least_squared_distance(tree.boxes[left + 1], own)};
      if (far.distance2 < near.distance2) std::swap(near, far);
      stack[size++] = far;
      stack[size++] = near;
      continue;
    }
    const int64_t other = entry.node - (tree.num_leaves - 1);
    const int64_t first = first_of(tree, other);
    const Box& box = tree.boxes[entry.node];
    const BoxLeaf& there = tree.leaves[other];
    bound = 0;
    for (int64_t i = begin; i < end; ++i) {
      Nearest& found = nearest[i - begin];  // the bound of one that is closed is 0
      const float p[3] = {here.x[i - begin], here.y[i - begin], here.z[i - begin]};
      if (!(distance2(p, box) < found.bound())) {
        bound = std::max(bound, found.bound());
        continue;
      }
      float distances2[LEAF_POINTS];
#pragma omp simd
      for (int l = 0; l < LEAF_POINTS; ++l) {
        const float x = p[0] - there.x[l], y = p[1] - there.y[l], z = p[2] - there.z[l];
        distances2[l] = x * x + y * y + z * z;
      }
      for (int l = 0; l < LEAF_POINTS; ++l)
        if (distances2[l] < found.bound() && first + l != i) found.offer(distances2[l], static_cast<int32_t>(first + l));
      bound = std::max(bound, found.bound());
    }
  }
}

}  // namespace splatree
