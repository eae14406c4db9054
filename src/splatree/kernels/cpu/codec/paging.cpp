// Batches of nodes, each a heap by size (reference/paging.py). The children of a row are found by hopping over their subtrees.
// Cost: a push and a pop for each inner node, and a split for each that waits for a later batch: a quarter of a microsecond.
#include "cpu/codec/paging.h"

#include <algorithm>
#include <array>
#include <utility>
#include <vector>

namespace splatree {
namespace {

constexpr double LONG = 3;
constexpr int OCTANTS[8] = {0, 1, 3, 2, 6, 7, 5, 4};

struct Node {
  float size;
  int32_t row;
};

// Whether a comes after b: the heap's top is the largest, of equals the smaller row.
bool after(const Node& a, const Node& b) { return a.size < b.size || (a.size == b.size && a.row > b.row); }

using Batch = std::vector<Node>;

// Splits a batch by the places of its centres and appends the parts that are not empty.
void split(const Batch& batch, const float* means, std::vector<Batch>& batches) {
  if (batch.empty()) return;
  std::array<float, 3> low, high, middle, extent;
  for (int axis = 0; axis < 3; ++axis) {
    low[axis] = high[axis] = means[3 * int64_t(batch[0].row) + axis];
    for (const Node& node : batch) {
      const float x = means[3 * int64_t(node.row) + axis];
      low[axis] = std::min(low[axis], x), high[axis] = std::max(high[axis], x);
    }
    middle[axis] = (low[axis] + high[axis]) * 0.5f;
    extent[axis] = high[axis] - low[axis];
  }
  const auto longest = std::max_element(extent.begin(), extent.end()) - extent.begin();
  const bool is_long = double(extent[longest]) >= LONG * double(*std::min_element(extent.begin(), extent.end()));
  std::array<Batch, 8> parts;
  for (const Node& node : batch) {
    const float* m = means + 3 * int64_t(node.row);
    int part = 0;
    if (is_long)
      part = m[longest] >= middle[longest];
    else
      for (int axis = 0; axis < 3; ++axis) part |= int(m[axis] >= middle[axis]) << axis;
    parts[part].push_back(node);
  }
  if (is_long) {
    const int first = parts[1].size() > parts[0].size();
    for (int part : {first, 1 - first})
      if (!parts[part].empty()) batches.push_back(std::move(parts[part]));
    return;
  }
  for (int part : OCTANTS)
    if (!parts[part].empty()) batches.push_back(std::move(parts[part]));
}

}  // namespace

void page_order(int64_t num_rows, const float* means, const float* sizes, const int32_t* subtree_end, int64_t first_number,
                int64_t page_rows, int32_t* order) {
  const auto is_inner = [&](int32_t row) { return subtree_end[row] > row + 1; };
  int64_t count = 0;
  std::vector<Batch> batches(1);
  for (int32_t row = 0; row < num_rows; row = subtree_end[row]) {
    order[count++] = row;
    if (is_inner(row)) batches[0].push_back({sizes[row], row});
  }
  for (size_t b = 0; b < batches.size(); ++b) {
    Batch heap = std::move(batches[b]);
    batches[b] = Batch();
    std::make_heap(heap.begin(), heap.end(), after);
    const int64_t start = first_number + count;
    const int64_t end = (start + page_rows / 8 + page_rows - 1) / page_rows * page_rows;
    bool is_first = true;
    while (!heap.empty()) {
      const int32_t parent = heap.front().row;
      const int64_t before = count;
      for (int32_t row = parent + 1; row < subtree_end[parent]; row = subtree_end[row]) order[count++] = row;
      if (!is_first && first_number + count > end) {
        count = before;  // the family belongs to a later batch
        break;
      }
      is_first = false;
      std::pop_heap(heap.begin(), heap.end(), after);
      heap.pop_back();
      for (int64_t i = before; i < count; ++i) {
        if (!is_inner(order[i])) continue;
        heap.push_back({sizes[order[i]], order[i]});
        std::push_heap(heap.begin(), heap.end(), after);
      }
    }
    split(heap, means, batches);
  }
}

}  // namespace splatree
