#include "cpu/build/box_tree.h"

#include <algorithm>
#include <limits>
#include <numeric>

#include "cpu/runtime/pool.h"
#include "cpu/runtime/scratch.h"

namespace splatree {
namespace {

constexpr float INFINITELY_FAR = std::numeric_limits<float>::infinity();
constexpr int64_t SUBTREES = 16;  // that threads build on their own

class Builder {
 public:
  Builder(BoxTree& tree, const float* points) : tree_(tree), points_(points) {}

  void build(int threads) const {
    const int64_t subtrees = std::min(tree_.num_leaves, SUBTREES);
    for (int64_t node = 0; node < subtrees - 1; ++node) split(node);
    parallel_chunks(subtrees, threads, [&](int64_t i) { build_below(subtrees - 1 + i); });
  }

 private:
  void build_below(int64_t node) const {
    if (is_leaf(tree_, node)) return fill(node);
    split(node);
    build_below(2 * node + 1);
    build_below(2 * node + 2);
  }

  void split(int64_t node) const {
    const Box& box = tree_.boxes[node] = bounds(node);
    int longest = 0;
    for (int axis = 1; axis < 3; ++axis)
      if (box.upper[axis] - box.lower[axis] > box.upper[longest] - box.lower[longest]) longest = axis;
    const auto [begin, end] = range(node);
    const int64_t middle = range(2 * node + 2).first;
    const float* x = points_ + longest;
    std::nth_element(tree_.rows + begin, tree_.rows + middle, tree_.rows + end, [x](int32_t p, int32_t q) {
      const float a = x[3 * int64_t{p}], b = x[3 * int64_t{q}];
      return a != b ? a < b : p < q;  // the same tree wherever equal coordinates stand
    });
  }

  void fill(int64_t node) const {
    tree_.boxes[node] = bounds(node);
    const auto [begin, end] = range(node);
    std::sort(tree_.rows + begin, tree_.rows + end);
    BoxLeaf& leaf = tree_.leaves[node - (tree_.num_leaves - 1)];
    for (int64_t i = 0; i < LEAF_POINTS; ++i) {
      const bool used = begin + i < end;
      const int32_t row = used ? tree_.rows[begin + i] : std::numeric_limits<int32_t>::max();
      const float* point = points_ + 3 * int64_t{used ? row : 0};
      leaf.x[i] = used ? point[0] : INFINITELY_FAR;
      leaf.y[i] = used ? point[1] : INFINITELY_FAR;
      leaf.z[i] = used ? point[2] : INFINITELY_FAR;
      leaf.row[i] = row;
    }
  }

  // Points of the leaves below a node: first to last in the row of leaves.
  std::pair<int64_t, int64_t> range(int64_t node) const {
    int64_t first = node, last = node;
    while (!is_leaf(tree_, first)) first = 2 * first + 1, last = 2 * last + 2;
    return {first_of(tree_, first - (tree_.num_leaves - 1)), first_of(tree_, last - (tree_.num_leaves - 1) + 1)};
  }

  Box bounds(int64_t node) const {
    const auto [begin, end] = range(node);
    Box box = {};
    for (int axis = 0; axis < 3; ++axis) box.lower[axis] = INFINITELY_FAR, box.upper[axis] = -INFINITELY_FAR;
    for (int64_t i = begin; i < end; ++i)
      for (int axis = 0; axis < 3; ++axis) {
        const float value = points_[3 * int64_t{tree_.rows[i]} + axis];
        box.lower[axis] = std::min(box.lower[axis], value);
        box.upper[axis] = std::max(box.upper[axis], value);
      }
    return box;
  }

  BoxTree& tree_;
  const float* points_;
};

}  // namespace

BoxTree::BoxTree(int64_t num_points, const float* points, int threads) : num_points(num_points), num_leaves(1) {
  while (num_leaves * LEAF_POINTS < num_points) num_leaves *= 2;
  Scratch<Box> all_boxes = allocate<Box>(2 * num_leaves - 1);
  Scratch<BoxLeaf> all_leaves = allocate<BoxLeaf>(num_leaves);
  rows = allocate<int32_t>(num_points).release();
  boxes = all_boxes.release();
  leaves = all_leaves.release();
  std::iota(rows, rows + num_points, 0);
  Builder(*this, points).build(threads);
}

BoxTree::~BoxTree() {
  std::free(boxes);
  std::free(leaves);
  std::free(rows);
}

}  // namespace splatree
