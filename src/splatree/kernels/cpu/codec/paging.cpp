// Batches of nodes, each a heap by size (reference/paging.py). The children of a row are found by hopping over their subtrees.
// Cost: a push and a pop for each inner node, once more for each that is passed over at the end of a page, and halving for each
// that waits for a later batch: a quarter of a microsecond.
#include "cpu/codec/paging.h"

#include <algorithm>
#include <cstddef>
#include <utility>
#include <vector>

namespace splatree {
namespace {

constexpr size_t FAR_OUT = 20;

struct Node {
  float size;
  int32_t row;
};

// Whether a comes after b: the heap's top is the largest, of equals the smaller row.
bool after(const Node& a, const Node& b) { return a.size < b.size || (a.size == b.size && a.row > b.row); }

using Batch = std::vector<Node>;

// How far the middle nine tenths of a batch reach along an axis.
float reach(const Batch& batch, const float* means, int axis) {
  std::vector<float> places;
  places.reserve(batch.size());
  for (const Node& node : batch) places.push_back(means[3 * int64_t(node.row) + axis]);
  const auto edge = std::ptrdiff_t(batch.size() / FAR_OUT);
  std::nth_element(places.begin(), places.begin() + edge, places.end());
  const float low = places[size_t(edge)];
  std::nth_element(places.begin(), places.end() - 1 - edge, places.end());
  return places[places.size() - 1 - size_t(edge)] - low;
}

// Halves a batch by the places of its centres and appends the parts that are not empty.
void halve(Batch batch, const float* means, std::vector<Batch>& batches) {
  if (batch.size() < 2) {
    if (!batch.empty()) batches.push_back(std::move(batch));
    return;
  }
  int axis = 0;
  float farthest = reach(batch, means, 0);
  for (int other : {1, 2}) {
    const float far = reach(batch, means, other);
    if (far > farthest) axis = other, farthest = far;
  }
  const auto place = [&](const Node& node) { return means[3 * int64_t(node.row) + axis]; };
  const auto middle = batch.begin() + std::ptrdiff_t(batch.size() / 2);
  std::nth_element(batch.begin(), middle, batch.end(),
                   [&](const Node& a, const Node& b) { return place(a) < place(b) || (place(a) == place(b) && a.row < b.row); });
  batches.emplace_back(batch.begin(), middle);
  batches.emplace_back(middle, batch.end());
}

}  // namespace

void page_order(int64_t num_rows, const float* means, const float* sizes, const int32_t* subtree_end, int64_t first_number,
                int64_t page_rows, int32_t* order) {
  const auto is_inner = [&](int32_t row) { return subtree_end[row] > row + 1; };
  int64_t count = 0;
  std::vector<Batch> batches(1);
  Batch waiting;  // whose children do not fit into the page
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
    waiting.clear();
    while (!heap.empty() && (is_first || first_number + count < end)) {
      const Node parent = heap.front();
      std::pop_heap(heap.begin(), heap.end(), after);
      heap.pop_back();
      const int64_t before = count;
      for (int32_t row = parent.row + 1; row < subtree_end[parent.row]; row = subtree_end[row]) order[count++] = row;
      const int64_t room = end - first_number - count;
      if (!is_first && (room < 0 || room == 1)) {
        count = before;  // the family belongs to a later batch
        waiting.push_back(parent);
        continue;
      }
      is_first = false;
      for (int64_t i = before; i < count; ++i) {
        if (!is_inner(order[i])) continue;
        heap.push_back({sizes[order[i]], order[i]});
        std::push_heap(heap.begin(), heap.end(), after);
      }
    }
    heap.insert(heap.end(), waiting.begin(), waiting.end());
    halve(std::move(heap), means, batches);
  }
}

}  // namespace splatree
