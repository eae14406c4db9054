// Depth order: a stable radix sort of (depth, index), least digit first, over only the bits in which the depths differ.
//
// Depths are positive, so their bits order like integers. Chunks count and scatter on their own; as a chunk's entries go where
// the counts of the digits and chunks before it end, the result is the stable order for any number of threads.
#include <algorithm>
#include <vector>

#include "cpu/pool.h"
#include "cpu/project.h"
#include "cpu/scratch.h"

namespace splatree {
namespace {

struct Entry {
  uint32_t key;
  int32_t index;
};

constexpr int MAX_DIGIT_BITS = 11;  // 2048 places to write to fit the second-level cache

void radix_pass(const Entry* from, Entry* to, int64_t n, int shift, int digit_bits, int64_t grain, int threads) {
  const int64_t num_chunks = (n + grain - 1) / grain;
  const int64_t num_digits = int64_t(1) << digit_bits;
  std::vector<uint32_t> place(num_chunks * num_digits, 0);
  const uint32_t mask = uint32_t(num_digits - 1);
  parallel_ranges(n, grain, threads, [&](int64_t begin, int64_t end) {
    uint32_t* counts = &place[begin / grain * num_digits];
    for (int64_t i = begin; i < end; ++i) ++counts[(from[i].key >> shift) & mask];
  });
  uint32_t total = 0;
  for (int64_t d = 0; d < num_digits; ++d)
    for (int64_t c = 0; c < num_chunks; ++c) {
      const uint32_t count = place[c * num_digits + d];
      place[c * num_digits + d] = total;
      total += count;
    }
  parallel_ranges(n, grain, threads, [&](int64_t begin, int64_t end) {
    uint32_t* next = &place[begin / grain * num_digits];
    for (int64_t i = begin; i < end; ++i) {
      const Entry entry = from[i];
      to[next[(entry.key >> shift) & mask]++] = entry;
    }
  });
}

// Puts runs of one depth in the order of their ids.
void order_ties(Entry* entries, const int32_t* rows, const uint32_t* ids, int64_t n) {
  auto id = [&](const Entry& e) { return ids ? ids[rows[e.index]] : uint32_t(rows[e.index]); };
  for (int64_t begin = 0, end; begin < n; begin = end) {
    for (end = begin + 1; end < n && entries[end].key == entries[begin].key;) ++end;
    if (end - begin > 1)
      std::sort(entries + begin, entries + end, [&](const Entry& e, const Entry& f) { return id(e) < id(f); });
  }
}

}  // namespace

void order_by_depth(const float* depths, const int32_t* rows, const uint32_t* ids, int64_t n, int threads,
                    int32_t* order) {
  if (n == 0) return;
  Scratch<Entry> entries = allocate<Entry>(n), scratch = allocate<Entry>(n);
  const int64_t grain = std::max<int64_t>(16384, (n + 15) / 16);
  const int64_t num_chunks = (n + grain - 1) / grain;
  std::vector<uint32_t> lows(num_chunks), highs(num_chunks);
  parallel_ranges(n, grain, threads, [&](int64_t begin, int64_t end) {
    uint32_t low = ~0u, high = 0;
    for (int64_t i = begin; i < end; ++i) {
      const uint32_t key = uint32_t(bits_of(depths[i]));
      entries[i] = {key, int32_t(i)};
      low = std::min(low, key), high = std::max(high, key);
    }
    lows[begin / grain] = low, highs[begin / grain] = high;
  });
  const uint32_t low = *std::min_element(lows.begin(), lows.end());
  const uint32_t range = *std::max_element(highs.begin(), highs.end()) - low;
  parallel_ranges(n, grain, threads, [&](int64_t begin, int64_t end) {
    for (int64_t i = begin; i < end; ++i) entries[i].key -= low;
  });
  const int num_bits = range ? 32 - __builtin_clz(range) : 0;
  const int num_passes = (num_bits + MAX_DIGIT_BITS - 1) / MAX_DIGIT_BITS;
  const int digit_bits = num_passes ? (num_bits + num_passes - 1) / num_passes : 0;
  for (int pass = 0; pass < num_passes; ++pass) {
    radix_pass(entries.get(), scratch.get(), n, pass * digit_bits, digit_bits, grain, threads);
    entries.swap(scratch);
  }
  // Runs of one depth are in the order of their indices, which may be that of their ids.
  if (ids || !std::is_sorted(rows, rows + n)) order_ties(entries.get(), rows, ids, n);
  parallel_ranges(n, grain, threads, [&](int64_t begin, int64_t end) {
    for (int64_t i = begin; i < end; ++i) order[i] = entries[i].index;
  });
}

}  // namespace splatree
