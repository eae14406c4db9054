#include "cpu/runtime/in_order.h"

#include <mutex>
#include <vector>

#include "cpu/runtime/scratch.h"

namespace splatree {
namespace {

thread_local const char this_thread = 0;  // its address tells threads apart

// Buffers of the last frames, kept for the next: memory that has been touched before costs a page fault less for each 4 KB.
class Kept {
 public:
  // One of at least so many bytes, or null.
  ChunkBuffer* take(int64_t bytes) {
    const std::unique_lock<std::mutex> lock(mutex_, std::try_to_lock);
    if (!lock.owns_lock() || !first_ || first_->bytes < bytes) return nullptr;
    ChunkBuffer* const buffer = first_;
    first_ = buffer->older;
    bytes_ -= buffer->bytes;
    return buffer;
  }

  // Keeps a buffer, or frees it where enough are kept.
  void put(ChunkBuffer* buffer) {
    const std::unique_lock<std::mutex> lock(mutex_, std::try_to_lock);
    if (!lock.owns_lock() || bytes_ + buffer->bytes > MOST_BYTES) return Free()(buffer);
    buffer->older = first_;
    first_ = buffer;
    bytes_ += buffer->bytes;
  }

 private:
  static constexpr int64_t MOST_BYTES = 4 << 20;  // a hundred buffers: what one thread computes while another has no processor

  // Only tried: nobody waits for it, and a process that was forked while it was held does without what is kept.
  std::mutex mutex_;
  ChunkBuffer* first_ = nullptr;
  int64_t bytes_ = 0;
};

Kept& kept() {
  static Kept* const buffers = new Kept;  // as long as the process, since threads may outlive statics
  return *buffers;
}

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
    kept().put(buffer);
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
    buffer = kept().take(s.bytes_per_buffer);
    if (!buffer) {
      buffer = reinterpret_cast<ChunkBuffer*>(allocate<char>(s.bytes_per_buffer).release());
      buffer->bytes = s.bytes_per_buffer;
    }
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
