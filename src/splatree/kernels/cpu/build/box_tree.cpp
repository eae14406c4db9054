#include "cpu/build/box_tree.h"

#include <algorithm>
#include <cstring>
#include <limits>
#include <utility>

#include "cpu/runtime/pool.h"
#include "cpu/runtime/quad.h"
#include "cpu/runtime/scratch.h"

namespace splatree {
namespace {

constexpr float INFINITELY_FAR = std::numeric_limits<float>::infinity();
constexpr int64_t SUBTREES = 16;  // that threads build on their own

// A point, and its row as bits. Points are moved, not their rows alone: a node then reads its points in one run.
using Point = Quad;

Point point_of(const float* x, int32_t row) {
  Point point = {x[0], x[1], x[2], 0};
  std::memcpy(reinterpret_cast<float*>(&point) + 3, &row, sizeof row);
  return point;
}

int32_t row_of(const Point& point) {
  int32_t row;
  std::memcpy(&row, reinterpret_cast<const float*>(&point) + 3, sizeof row);
  return row;
}

// The order along an axis: the same tree wherever equal coordinates stand.
template <int AXIS>
bool is_before(const Point& p, const Point& q) {
  return p[AXIS] != q[AXIS] ? p[AXIS] < q[AXIS] : row_of(p) < row_of(q);
}

// Moves points so that none before `middle` comes after one from it on.
template <int AXIS>
void halve(Point* first, Point* middle, Point* last) {
  std::nth_element(first, middle, last, is_before<AXIS>);
}

class Builder {
 public:
  Builder(BoxTree& tree, const float* points) : tree_(tree), points_(allocate<Point>(tree.num_points)) {
    for (int64_t i = 0; i < tree.num_points; ++i) points_[i] = point_of(points + 3 * i, static_cast<int32_t>(i));
  }

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
    constexpr decltype(&halve<0>) ALONG[] = {halve<0>, halve<1>, halve<2>};
    ALONG[longest](&points_[begin], &points_[range(2 * node + 2).first], &points_[end]);
  }

  void fill(int64_t node) const {
    tree_.boxes[node] = bounds(node);
    const auto [begin, end] = range(node);
    std::sort(&points_[begin], &points_[end], [](const Point& p, const Point& q) { return row_of(p) < row_of(q); });
    BoxLeaf& leaf = tree_.leaves[node - (tree_.num_leaves - 1)];
    for (int64_t i = 0; i < LEAF_POINTS; ++i) {
      const bool is_used = begin + i < end;
      const Point point = is_used ? points_[begin + i] : point_of(NOWHERE, std::numeric_limits<int32_t>::max());
      leaf.x[i] = point[0], leaf.y[i] = point[1], leaf.z[i] = point[2];
      leaf.row[i] = row_of(point);
      if (is_used) tree_.rows[begin + i] = row_of(point);
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
    Quad lower = Quad{} + INFINITELY_FAR, upper = -lower;
    for (int64_t i = begin; i < end; ++i) {
      const Point point = points_[i];
      lower = point < lower ? point : lower;
      upper = point > upper ? point : upper;
    }
    lower[3] = upper[3] = 0;
    Box box;
    std::memcpy(box.lower, &lower, sizeof lower);
    std::memcpy(box.upper, &upper, sizeof upper);
    return box;
  }

  static constexpr float NOWHERE[3] = {INFINITELY_FAR, INFINITELY_FAR, INFINITELY_FAR};

  BoxTree& tree_;
  Scratch<Point> points_;
};

}  // namespace

BoxTree::BoxTree(int64_t num_points, const float* points, int threads) : num_points(num_points), num_leaves(1) {
  while (num_leaves * LEAF_POINTS < num_points) num_leaves *= 2;
  Scratch<Box> all_boxes = allocate<Box>(2 * num_leaves - 1);
  Scratch<BoxLeaf> all_leaves = allocate<BoxLeaf>(num_leaves);
  rows = allocate<int32_t>(num_points).release();
  boxes = all_boxes.release();
  leaves = all_leaves.release();
  Builder(*this, points).build(threads);
}

BoxTree::~BoxTree() {
  std::free(boxes);
  std::free(leaves);
  std::free(rows);
}

}  // namespace splatree
