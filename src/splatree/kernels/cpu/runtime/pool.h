// A small thread pool. A job is a number of chunks, handed out by an atomic counter; several jobs may run at once.
//
// Which thread runs a chunk is not determined, so a job must write only what its chunk owns; then the result does not depend
// on the number of threads. The caller works on its own job too, so a job ends even if no other thread is free. No thread ever
// waits actively: a busy machine gets every processor that has nothing to do.
#pragma once
#include <cstdint>

namespace splatree {

using ChunkFunction = void (*)(void* context, int64_t chunk);

// Calls function(context, c) for each c in [0, num_chunks) on at most `threads` threads (0: as many as the process may use).
void run_chunks(int64_t num_chunks, int threads, ChunkFunction function, void* context);

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
