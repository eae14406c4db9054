// The order of a tree's nodes for viewers that load pages.
#pragma once
#include <cstdint>

namespace splatree {

// A forest in preorder. Fills `order` with its rows as reference/paging.py defines it; the first of them has the number
// `first_number`, and pages have `page_rows` rows.
void page_order(int64_t num_rows, const float* means, const float* sizes, const int32_t* subtree_end, int64_t first_number,
                int64_t page_rows, int32_t* order);

}  // namespace splatree
