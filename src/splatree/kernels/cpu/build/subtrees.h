// The nodes of a tree in preorder, children before their parents, by several threads.
#pragma once
#include <cstdint>
#include <vector>

#include "cpu/runtime/pool.h"

namespace splatree {

// Calls body(row) for each row of a tree, in an order in which its children are done before it. Which rows run beside each other
// does not depend on the number of threads.
template <class Body>
void from_children_to_parents(int64_t n, const int32_t* subtree_end, int threads, const Body& body) {
  // Subtrees of at most GRAIN rows are independent of each other; what lies above them follows.
  constexpr int64_t GRAIN = 1 << 14;
  std::vector<int64_t> small, large;
  for (int64_t i = 0; i < n;) {
    if (subtree_end[i] - i <= GRAIN) {
      small.push_back(i);
      i = subtree_end[i];
    } else {
      large.push_back(i++);
    }
  }
  parallel_ranges(static_cast<int64_t>(small.size()), 64, threads, [&](int64_t begin, int64_t end) {
    for (int64_t s = begin; s < end; ++s)
      for (int64_t i = subtree_end[small[s]] - 1; i >= small[s]; --i) body(i);
  });
  for (size_t s = large.size(); s-- > 0;) body(large[s]);
}

}  // namespace splatree
