// A balanced tree of boxes over points: what the searches for near points walk (neighbors.cpp, nearest.cpp).
//
// Each node halves its points at the median of the longest side of their box; node i has the children 2 i + 1 and 2 i + 2, and
// all leaves are at one depth. Cost: O(n log n), half a microsecond a point.
#pragma once
#include <cstdint>

#include "shared/portable.h"

namespace splatree {

constexpr int LEAF_POINTS = 8;

// Two vectors of four: the last of each is 0.
struct alignas(32) Box {
  float lower[4], upper[4];
};

// Points as planes, in the order of their rows; where there are fewer, the rest is infinitely far away, with the largest row.
struct BoxLeaf {
  float x[LEAF_POINTS], y[LEAF_POINTS], z[LEAF_POINTS];
  int32_t row[LEAF_POINTS];
};

// The same tree for any number of threads. It owns its arrays.
struct BoxTree {
  int64_t num_points;
  int64_t num_leaves;  // a power of two
  Box* boxes;          // 2 num_leaves − 1 nodes, the leaves last
  BoxLeaf* leaves;
  int32_t* rows;  // of the points of leaf 0, leaf 1 …

  // `points` "n 3", at least one, without NaN.
  BoxTree(int64_t num_points, const float* points, int threads);
  ~BoxTree();
  BoxTree(const BoxTree&) = delete;
  BoxTree& operator=(const BoxTree&) = delete;
};

// Leaf l holds rows[first_of(l) : first_of(l + 1)], at least one.
SPLATREE_FN int64_t first_of(const BoxTree& tree, int64_t leaf) { return leaf * tree.num_points / tree.num_leaves; }

SPLATREE_FN bool is_leaf(const BoxTree& tree, int64_t node) { return node >= tree.num_leaves - 1; }

SPLATREE_FN float least_squared_distance(const Box& a, const Box& b) {
  float sum = 0;
#pragma omp simd reduction(+ : sum)
  for (int axis = 0; axis < 4; ++axis) {
    const float gap = greatest(greatest(a.lower[axis] - b.upper[axis], b.lower[axis] - a.upper[axis]), 0.f);
    sum += gap * gap;
  }
  return sum;
}

// Calls visit(leaf) for the leaves whose boxes are at most `limit` from the given box, squared; the nearer child of a node first.
// Each visit returns the limit from then on; one below zero ends the walk.
template <class Visit>
SPLATREE_FN void each_leaf(const BoxTree& tree, const Box& box, float limit, const Visit& visit) {
  constexpr int STACK = 64;  // twice the depth of a tree of 2^31 points
  struct Entry {
    int64_t node;
    float distance2;
  } stack[STACK];
  int size = 0;
  stack[size++] = {0, 0.f};
  while (size > 0) {
    const Entry entry = stack[--size];
    if (entry.distance2 > limit) continue;
    if (is_leaf(tree, entry.node)) {
      limit = visit(entry.node - (tree.num_leaves - 1));
      continue;
    }
    const int64_t left = 2 * entry.node + 1, right = left + 1;
    const float to_left = least_squared_distance(tree.boxes[left], box);
    const float to_right = least_squared_distance(tree.boxes[right], box);
    const bool left_first = to_left <= to_right;
    stack[size++] = left_first ? Entry{right, to_right} : Entry{left, to_left};
    stack[size++] = left_first ? Entry{left, to_left} : Entry{right, to_right};
  }
}

}  // namespace splatree
