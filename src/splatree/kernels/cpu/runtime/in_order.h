// Results of chunks in the order of the chunks, where the size of a result is known only once it is computed.
//
// Each chunk is computed into a buffer. The place of its result is the sum of the sizes before it. A thread that finishes a
// chunk before the chunks in front of it are finished leaves the buffer here and goes on; the thread that finishes the last one
// missing takes all buffers whose places follow from that, and copies them. So no thread ever waits for another.
//
//   ChunkBuffer* buffer = results.take();
//   buffer->count = ...;                                           // computed into the buffer
//   for (ChunkBuffer* b = results.finish(chunk, buffer); b; b = results.give_back(b)) ...   // copied to b->first
//
// Memory: as many buffers as threads, and one for each chunk that is left here; 4 MB of them are kept for the next frame. Not
// compiled for each instruction set, so the functions may use std templates.
#pragma once
#include <cstdint>

namespace splatree {

// The head of a buffer; what a chunk computes follows it.
struct ChunkBuffer {
  int64_t count;       // of the result, set before finish()
  int64_t first;       // its place, set by finish()
  ChunkBuffer* next;   // of a list
  ChunkBuffer* older;  // of all buffers
  int64_t bytes;       // of the whole buffer
  const void* owner;   // the thread in whose cache it was last
};

class InOrder {
 public:
  InOrder(int64_t num_chunks, int64_t bytes_per_buffer);
  ~InOrder();

  // A buffer to compute a chunk into, at a cache line; its content is arbitrary.
  ChunkBuffer* take();

  // Hands in the buffer of a chunk. Returns those whose place is now known, this one and others, or null.
  ChunkBuffer* finish(int64_t chunk, ChunkBuffer* buffer);

  // Returns a buffer that has been copied; gives the next of its list.
  ChunkBuffer* give_back(ChunkBuffer* buffer);

  // Sum of all counts, once all chunks are finished.
  int64_t total() const;

 private:
  struct State;
  State* state_;
};

}  // namespace splatree
