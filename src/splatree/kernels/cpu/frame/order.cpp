// Depth order: a stable radix sort of (depth, index) over only the bits in which the depths differ.
//
// Depths are positive, so their bits order like integers. One pass over memory puts entries into buckets of about a thousand by
// their highest bits; then each bucket is sorted where it lies, in the first-level cache, least digit first. In the first pass
// chunks count and scatter on their own; as a chunk's entries go where the counts of the digits and chunks before it end, the
// result is the stable order for any number of threads.
#include <algorithm>
#include <vector>

#include "cpu/frame/project.h"
#include "cpu/runtime/pool.h"
#include "cpu/runtime/scratch.h"

namespace splatree {
namespace {

struct Entry {
  uint32_t key;
  int32_t index;
};

constexpr int64_t BUCKET = 1024;     // entries: 8 KB, and as much to sort them
constexpr int MAX_BUCKET_BITS = 11;  // 2048 places to write to fit the second-level cache
constexpr int64_t TOGETHER = 16;     // buckets
constexpr int MAX_DIGIT_BITS = 9;    // 2 KB of counts fit the first
constexpr int64_t FEW = 24;          // entries that are sorted by insertion

// Least and greatest bits of the depths.
struct Bounds {
  uint32_t low = ~0u, high = 0;
};

Bounds bounds_of(const float* depths, int64_t n, int64_t grain, int threads) {
  std::vector<Bounds> bounds((n + grain - 1) / grain);
  parallel_ranges(n, grain, threads, [&](int64_t begin, int64_t end) {
    Bounds b;
    for (int64_t i = begin; i < end; ++i) {
      const uint32_t key = uint32_t(bits_of(depths[i]));
      b.low = std::min(b.low, key), b.high = std::max(b.high, key);
    }
    bounds[begin / grain] = b;
  });
  for (const Bounds& b : bounds)
    bounds[0].low = std::min(bounds[0].low, b.low), bounds[0].high = std::max(bounds[0].high, b.high);
  return bounds[0];
}

// Entries of the depths in the order of their keys' bits from `shift` on; returns where each bucket begins, and the end.
std::vector<uint32_t> scatter(const float* depths, uint32_t low, int64_t n, int shift, int64_t num_buckets, int64_t grain,
                              int threads, Entry* entries) {
  const int64_t num_chunks = (n + grain - 1) / grain;
  std::vector<uint32_t> place(num_chunks * num_buckets, 0), start(num_buckets + 1);
  parallel_ranges(n, grain, threads, [&](int64_t begin, int64_t end) {
    uint32_t* counts = &place[begin / grain * num_buckets];
    for (int64_t i = begin; i < end; ++i) ++counts[(uint32_t(bits_of(depths[i])) - low) >> shift];
  });
  uint32_t total = 0;
  for (int64_t bucket = 0; bucket < num_buckets; ++bucket) {
    start[bucket] = total;
    for (int64_t c = 0; c < num_chunks; ++c) {
      const uint32_t count = place[c * num_buckets + bucket];
      place[c * num_buckets + bucket] = total;
      total += count;
    }
  }
  start[num_buckets] = total;
  parallel_ranges(n, grain, threads, [&](int64_t begin, int64_t end) {
    uint32_t* next = &place[begin / grain * num_buckets];
    for (int64_t i = begin; i < end; ++i) {
      const uint32_t key = uint32_t(bits_of(depths[i])) - low;
      entries[next[key >> shift]++] = {key, int32_t(i)};
    }
  });
  return start;
}

// Sorts n entries by their lowest bits; the result is in `entries` or in `scratch`, which is returned.
Entry* sort_bucket(Entry* entries, Entry* scratch, int64_t n, int num_bits) {
  if (n <= FEW) {
    for (int64_t i = 1; i < n; ++i) {
      const Entry entry = entries[i];
      int64_t j = i;
      for (; j > 0 && entries[j - 1].key > entry.key; --j) entries[j] = entries[j - 1];
      entries[j] = entry;
    }
    return entries;
  }
  const int num_passes = (num_bits + MAX_DIGIT_BITS - 1) / MAX_DIGIT_BITS;
  for (int pass = 0; pass < num_passes; ++pass) {
    const int shift = num_bits * pass / num_passes, digit_bits = num_bits * (pass + 1) / num_passes - shift;
    const uint32_t num_digits = 1u << digit_bits, mask = num_digits - 1;
    uint32_t place[1 << MAX_DIGIT_BITS] = {};
    for (int64_t i = 0; i < n; ++i) ++place[(entries[i].key >> shift) & mask];
    uint32_t total = 0;
    for (uint32_t d = 0; d < num_digits; ++d) {
      const uint32_t count = place[d];
      place[d] = total;
      total += count;
    }
    for (int64_t i = 0; i < n; ++i) scratch[place[(entries[i].key >> shift) & mask]++] = entries[i];
    std::swap(entries, scratch);
  }
  return entries;
}

// Puts runs of one depth in the order of their ids.
void order_ties(Entry* entries, const int32_t* rows, const uint32_t* ids, int64_t n) {
  auto id = [&](const Entry& e) { return ids ? ids[rows[e.index]] : uint32_t(rows[e.index]); };
  for (int64_t begin = 0, end; begin < n; begin = end) {
    for (end = begin + 1; end < n && entries[end].key == entries[begin].key;) ++end;
    if (end - begin > 1) std::sort(entries + begin, entries + end, [&](const Entry& e, const Entry& f) { return id(e) < id(f); });
  }
}

}  // namespace

void order_by_depth(const float* depths, const int32_t* rows, const uint32_t* ids, int64_t n, int threads, int32_t* order) {
  if (n == 0) return;
  const int64_t grain = std::max<int64_t>(16384, (n + 15) / 16);
  const Bounds bounds = bounds_of(depths, n, grain, threads);
  const uint32_t range = bounds.high - bounds.low;
  const int num_bits = range ? 32 - __builtin_clz(range) : 0;
  int bucket_bits = 0;
  while (bucket_bits < std::min(num_bits, MAX_BUCKET_BITS) && n >> bucket_bits > BUCKET) ++bucket_bits;
  const int shift = num_bits - bucket_bits;
  // Runs of one depth are in the order of their indices, which may be that of their ids.
  const bool has_ids = ids || !std::is_sorted(rows, rows + n);

  const Scratch<Entry> entries = allocate<Entry>(n);
  const int64_t num_buckets = int64_t(1) << bucket_bits;
  const std::vector<uint32_t> start = scatter(depths, bounds.low, n, shift, num_buckets, grain, threads, entries.get());
  parallel_ranges(num_buckets, TOGETHER, threads, [&](int64_t begin, int64_t end) {
    std::vector<Entry> scratch;
    for (int64_t bucket = begin; bucket < end; ++bucket) {
      const int64_t first = start[bucket], size = start[bucket + 1] - first;
      if (size > int64_t(scratch.size())) scratch.resize(size);
      Entry* sorted = sort_bucket(entries.get() + first, scratch.data(), size, shift);
      if (has_ids) order_ties(sorted, rows, ids, size);
      for (int64_t i = 0; i < size; ++i) order[first + i] = sorted[i].index;
    }
  });
}

}  // namespace splatree
