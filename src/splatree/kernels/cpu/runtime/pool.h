// A small thread pool: one job at a time, chunks handed out by an atomic counter.
//
// Which thread runs a chunk is not determined, so a job must write only what its chunk owns; then the result
// does not depend on the number of threads. A second caller that finds the pool busy runs its job alone.
#pragma once
#include <cstdint>

namespace splatree {

using ChunkFunction = void (*)(void* context, int64_t chunk);

// Calls function(context, c) for each c in [0, num_chunks) on at most `threads` threads (0: all there are).
void run_chunks(int64_t num_chunks, int threads, ChunkFunction function, void* context);

// Processors this process may use.
int hardware_threads();

namespace {  // internal linkage: instantiated separately in each instruction-set variant

// Calls body(chunk) for each chunk in [0, num_chunks).
template <class Body>
void parallel_chunks(int64_t num_chunks, int threads, const Body& body) {
  run_chunks(
      num_chunks, threads, [](void* context, int64_t chunk) { (*static_cast<const Body*>(context))(chunk); },
      const_cast<void*>(static_cast<const void*>(&body)));
}

// Calls body(begin, end) for consecutive ranges of at most `grain` items covering [0, num_items).
template <class Body>
void parallel_ranges(int64_t num_items, int64_t grain, int threads, const Body& body) {
  const int64_t num_chunks = (num_items + grain - 1) / grain;
  parallel_chunks(num_chunks, threads, [&](int64_t chunk) {
    const int64_t begin = chunk * grain;
    const int64_t end = begin + grain < num_items ? begin + grain : num_items;
    body(begin, end);
  });
}

}  // namespace
}  // namespace splatree
