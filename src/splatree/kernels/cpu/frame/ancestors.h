// The ancestor table of FilterGS and the selection by it (ancestors.cpp).
#pragma once
#include <cstdint>
#include <vector>

#include "cpu/frame/select.h"

namespace splatree {

// Ancestors of each row, parent first, filled up with −1: 4 bytes times the width a row.
struct AncestorTable {
  const int32_t* ancestors;  // [n width]
  int width;

  const int32_t* of(int64_t row) const { return ancestors + row * width; }
};

struct AncestorRule {
  bool unseen_shadow;    // whether ancestors out of view shadow too: the exact cut; the paper leaves it open, its code has no
  bool only_leaves_ask;  // whether small inner rows are kept whatever is above them: the code
};

// Rows drawn, ascending.
std::vector<int32_t> select_by_ancestors(const SelectJob& job, const AncestorTable& table, const AncestorRule& rule, int threads);

void list_ancestors(const uint8_t* depth, int64_t num_rows, int width, int32_t* table);

}  // namespace splatree
