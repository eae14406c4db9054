// Stable radix sort of (key, row) by key: least significant digit first, 11 bits a pass, chunks counted in parallel.
//
// A pass counts the digits of each chunk, scans the counts digit by digit over all chunks, and scatters: the place of an
// item depends on the items alone, so any number of threads gives the same order. Passes in which all items share one digit
// are skipped. Memory: a second array of items, and 16 KB a chunk.
#pragma once
#include <cstdint>
#include <utility>
#include <vector>

#include "cpu/runtime/pool.h"
#include "cpu/runtime/scratch.h"

namespace splatree {

struct KeyRow {
  uint64_t key;
  uint32_t row;
};

inline void radix_sort(Scratch<KeyRow>& items, int64_t n, int threads) {
  constexpr int DIGIT_BITS = 11, DIGITS = 1 << DIGIT_BITS;
  constexpr int64_t GRAIN = 1 << 17;
  const int64_t num_chunks = (n + GRAIN - 1) / GRAIN;
  if (n < 2) return;
  Scratch<KeyRow> other = allocate<KeyRow>(n);
  std::vector<uint32_t> counts(static_cast<size_t>(num_chunks) * DIGITS);

  uint64_t differing = 0;
  for (int64_t i = 1; i < n; ++i) differing |= items[i].key ^ items[0].key;
  for (int shift = 0; shift < 64 && (differing >> shift) != 0; shift += DIGIT_BITS) {
    if (((differing >> shift) & (DIGITS - 1)) == 0) continue;
    parallel_chunks(num_chunks, threads, [&](int64_t chunk) {
      uint32_t* count = &counts[chunk * DIGITS];
      for (int d = 0; d < DIGITS; ++d) count[d] = 0;
      const int64_t end = n < (chunk + 1) * GRAIN ? n : (chunk + 1) * GRAIN;
      for (int64_t i = chunk * GRAIN; i < end; ++i) ++count[(items[i].key >> shift) & (DIGITS - 1)];
    });
    uint32_t place = 0;
    for (int d = 0; d < DIGITS; ++d)
      for (int64_t chunk = 0; chunk < num_chunks; ++chunk) {
        uint32_t& count = counts[chunk * DIGITS + d];
        const uint32_t size = count;
        count = place;
        place += size;
      }
    parallel_chunks(num_chunks, threads, [&](int64_t chunk) {
      uint32_t* next = &counts[chunk * DIGITS];
      const int64_t end = n < (chunk + 1) * GRAIN ? n : (chunk + 1) * GRAIN;
      for (int64_t i = chunk * GRAIN; i < end; ++i) other[next[(items[i].key >> shift) & (DIGITS - 1)]++] = items[i];
    });
    std::swap(items, other);
  }
}

}  // namespace splatree
