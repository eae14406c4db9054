// Depth order: a stable radix sort of (depth, index), least digit first, over only the bits in which the depths differ.
//
// Depths are positive, so their bits order like integers. Chunks count and scatter on their own; as a chunk's entries go where
// the counts of the digits and chunks before it end, the result is the stable order for any number of threads.
#include <algorithm>
#include <memory>
#include <vector>

#include "cpu/pool.h"
#include "cpu/project.h"

namespace splatree {
namespace {

struct Entry {
  uint32_t key;
  int32_t index;
};

constexpr int DIGIT_BITS = 11;
constexpr int NUM_DIGITS = 1 << DIGIT_BITS;

void radix_pass(const Entry* from, Entry* to, int64_t n, int shift, int64_t grain, int threads) {
  const int64_t num_chunks = (n + grain - 1) / grain;
  std::vector<int64_t> place(num_chunks * NUM_DIGITS, 0);
  auto digit = [shift](const Entry& e) { return (e.key >> shift) & (NUM_DIGITS - 1); };
  parallel_ranges(n, grain, threads, [&](int64_t begin, int64_t end) {
    int64_t* counts = &place[begin / grain * NUM_DIGITS];
    for (int64_t i = begin; i < end; ++i) ++counts[digit(from[i])];
  });
  int64_t total = 0;
  for (int d = 0; d < NUM_DIGITS; ++d)
    for (int64_t c = 0; c < num_chunks; ++c) {
      const int64_t count = place[c * NUM_DIGITS + d];
      place[c * NUM_DIGITS + d] = total;
      total += count;
    }
  parallel_ranges(n, grain, threads, [&](int64_t begin, int64_t end) {
    int64_t* next = &place[begin / grain * NUM_DIGITS];
    for (int64_t i = begin; i < end; ++i) to[next[digit(from[i])]++] = from[i];
  });
}

}  // namespace

void order_by_depth(const float* depths, const int32_t* rows, const uint32_t* ids, int64_t n, int threads,
                    int32_t* order) {
  if (n == 0) return;
  std::unique_ptr<Entry[]> entries(new Entry[n]), scratch(new Entry[n]);
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
  for (int shift = 0; shift < 32 && (range >> shift) != 0; shift += DIGIT_BITS) {
    radix_pass(entries.get(), scratch.get(), n, shift, grain, threads);
    entries.swap(scratch);
  }
  // Runs of one depth are in the order of their indices; now of their ids.
  auto id = [&](const Entry& e) { return ids ? ids[rows[e.index]] : uint32_t(rows[e.index]); };
  for (int64_t begin = 0, end; begin < n; begin = end) {
    for (end = begin + 1; end < n && entries[end].key == entries[begin].key;) ++end;
    if (end - begin > 1)
      std::sort(&entries[begin], &entries[begin] + (end - begin),
                [&](const Entry& e, const Entry& f) { return id(e) < id(f); });
  }
  parallel_ranges(n, grain, threads, [&](int64_t begin, int64_t end) {
    for (int64_t i = begin; i < end; ++i) order[i] = entries[i].index;
  });
}

}  // namespace splatree
