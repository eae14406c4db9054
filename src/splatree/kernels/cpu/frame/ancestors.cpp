// The filter of FilterGS (Wang 2026, §3.2) on a processor: every row with a row of ancestors of its own, no traversal.
//
//   1. each row, in chunks: can it be seen? and if it is seen and has children: is it small?
//   2. each row that is left, a leaf or small: which of its ancestors were not asked in 1, being out of view?
//   3. these: are they small?                                             (2 and 3 only where they count: `unseen_shadow`)
//   4. each row that is left: does an ancestor stop? parent first, as in the paper
//
// Every pass goes over all n rows, whatever can be seen. Answers are those of select.cpp, so the rows are the same bit for bit.
#include "cpu/frame/ancestors.h"

#include <cstring>
#include <vector>

#include "cpu/runtime/isa.h"
#include "cpu/runtime/pool.h"
#include "cpu/runtime/scratch.h"

namespace splatree {
namespace {

constexpr int64_t CHUNK = 16 * MAX_BLOCK_ROWS;

enum State : uint8_t { NOT_ASKED, SMALL, LARGE, TO_ASK };

struct Rows {
  std::vector<int32_t> row;
  std::vector<uint8_t> answer;

  template <class Take>
  void fill(int64_t begin, int64_t end, const Take& take) {
    row.resize(size_t(end - begin));
    int64_t size = 0;
    for (int64_t i = begin; i < end; ++i) {
      row[size_t(size)] = int32_t(i);
      size += take(i) ? 1 : 0;
    }
    row.resize(size_t(size));
    answer.resize(row.size());
  }
};

}  // namespace

std::vector<int32_t> select_by_ancestors(const SelectJob& job, const AncestorTable& table, const AncestorRule& rule,
                                         int threads) {
  const int64_t n = job.num_rows;
  const Scratch<uint8_t> seen = allocate<uint8_t>(n), state = allocate<uint8_t>(n);
  const auto is_leaf = [&](int64_t i) { return job.subtree_end[i] == i + 1; };
  const auto is_left = [&](int64_t i) { return seen[i] && (is_leaf(i) || state[i] == SMALL); };
  const auto ask_small = [&](Rows& rows) {
    kernels().small_rows(job, rows.row.data(), int64_t(rows.row.size()), rows.answer.data());
    for (size_t i = 0; i < rows.row.size(); ++i) state[rows.row[i]] = rows.answer[i] ? SMALL : LARGE;
  };

  parallel_ranges(n, CHUNK, threads, [&](int64_t begin, int64_t end) {
    Rows rows;
    rows.fill(begin, end, [](int64_t) { return true; });
    std::memset(&state[begin], NOT_ASKED, size_t(end - begin));
    if (job.view_test == UNSEEN_TOO)
      std::memset(&seen[begin], 1, size_t(end - begin));
    else
      kernels().visible_rows(job, rows.row.data(), end - begin, &seen[begin]);
    rows.fill(begin, end, [&](int64_t i) { return seen[i] && !is_leaf(i); });
    ask_small(rows);
  });

  if (rule.unseen_shadow) {
    parallel_ranges(n, CHUNK, threads, [&](int64_t begin, int64_t end) {
      for (int64_t i = begin; i < end; ++i) {
        if (!is_left(i)) continue;
        // Several chunks may mark one row: all write the same byte.
        for (const int32_t* a = table.of(i); a != table.of(i + 1) && *a >= 0; ++a)
          if (__atomic_load_n(&state[*a], __ATOMIC_RELAXED) == NOT_ASKED)
            __atomic_store_n(&state[*a], uint8_t(TO_ASK), __ATOMIC_RELAXED);
      }
    });
    parallel_ranges(n, CHUNK, threads, [&](int64_t begin, int64_t end) {
      Rows rows;
      rows.fill(begin, end, [&](int64_t i) { return state[i] == TO_ASK; });
      ask_small(rows);
    });
  }

  const int64_t num_chunks = (n + CHUNK - 1) / CHUNK;
  std::vector<std::vector<int32_t>> parts(static_cast<size_t>(num_chunks));
  parallel_ranges(n, CHUNK, threads, [&](int64_t begin, int64_t end) {
    std::vector<int32_t>& part = parts[size_t(begin / CHUNK)];
    for (int64_t i = begin; i < end; ++i) {
      if (!is_left(i)) continue;
      bool shadowed = false;
      if (is_leaf(i) || !rule.only_leaves_ask)
        for (const int32_t* a = table.of(i); a != table.of(i + 1) && *a >= 0 && !shadowed; ++a) shadowed = state[*a] == SMALL;
      if (!shadowed) part.push_back(int32_t(i));
    }
  });
  std::vector<int32_t> rows;
  for (const std::vector<int32_t>& part : parts) rows.insert(rows.end(), part.begin(), part.end());
  return rows;
}

void list_ancestors(const uint8_t* depth, int64_t num_rows, int width, int32_t* table) {
  int32_t path[256];
  for (int64_t i = 0; i < num_rows; ++i) {
    path[depth[i]] = int32_t(i);
    int32_t* row = table + i * width;
    for (int l = 0; l < width; ++l) row[l] = l < depth[i] ? path[depth[i] - 1 - l] : -1;
  }
}

}  // namespace splatree
