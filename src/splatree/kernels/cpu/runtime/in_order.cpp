#include "cpu/runtime/in_order.h"

#include <mutex>
#include <vector>

#include "cpu/runtime/scratch.h"

namespace splatree {
namespace {

thread_local const char this_thread = 0;  // its address tells threads apart

}  // namespace

struct InOrder::State {
  std::mutex mutex;
  std::vector<ChunkBuffer*> finished;  // of each chunk that has no place yet; null: not finished
  int64_t next_chunk = 0;              // the first one without a place
  int64_t next_place = 0;              // where its result will be
  int64_t bytes_per_buffer;
  ChunkBuffer* free = nullptr;
  ChunkBuffer* all = nullptr;
};

InOrder::InOrder(int64_t num_chunks, int64_t bytes_per_buffer) : state_(new State) {
  state_->finished.resize(static_cast<size_t>(num_chunks));
  state_->bytes_per_buffer = bytes_per_buffer;
}

InOrder::~InOrder() {
  for (ChunkBuffer *buffer = state_->all, *older; buffer; buffer = older) {
    older = buffer->older;
    Free()(buffer);
  }
  delete state_;
}

ChunkBuffer* InOrder::take() {
  State& s = *state_;
  std::lock_guard<std::mutex> lock(s.mutex);
  // One that this thread has filled before is in its cache. The list is no longer than there are threads and buffers left here.
  ChunkBuffer** found = nullptr;
  for (ChunkBuffer** place = &s.free; *place; place = &(*place)->next) {
    if (!found) found = place;
    if ((*place)->owner != &this_thread) continue;
    found = place;
    break;
  }
  ChunkBuffer* buffer;
  if (found) {
    buffer = *found;
    *found = buffer->next;
  } else {
    buffer = reinterpret_cast<ChunkBuffer*>(allocate<char>(s.bytes_per_buffer).release());
    buffer->older = s.all;
    s.all = buffer;
  }
  buffer->owner = &this_thread;
  return buffer;
}

ChunkBuffer* InOrder::finish(int64_t chunk, ChunkBuffer* buffer) {
  State& s = *state_;
  std::lock_guard<std::mutex> lock(s.mutex);
  s.finished[static_cast<size_t>(chunk)] = buffer;
  ChunkBuffer* list = nullptr;
  ChunkBuffer** end = &list;
  const int64_t num_chunks = static_cast<int64_t>(s.finished.size());
  for (; s.next_chunk < num_chunks; ++s.next_chunk) {
    ChunkBuffer* const placed = s.finished[static_cast<size_t>(s.next_chunk)];
    if (!placed) break;
    placed->first = s.next_place;
    s.next_place += placed->count;
    *end = placed;
    end = &placed->next;
  }
  *end = nullptr;
  return list;
}

ChunkBuffer* InOrder::give_back(ChunkBuffer* buffer) {
  State& s = *state_;
  std::lock_guard<std::mutex> lock(s.mutex);
  ChunkBuffer* const next = buffer->next;
  buffer->next = s.free;
  s.free = buffer;
  return next;
}

int64_t InOrder::total() const { return state_->next_place; }

}  // namespace splatree
