#include "cpu/runtime/pool.h"

#include <atomic>
#include <condition_variable>
#include <exception>
#include <mutex>
#include <thread>
#include <vector>

#ifdef __linux__
#include <sched.h>
#endif
#include <pthread.h>

namespace splatree {
namespace {

struct Job {
  ChunkFunction function;
  void* context;
  int64_t num_chunks;
  std::atomic<int64_t> next{0};
  std::mutex error_mutex;
  std::exception_ptr error;

  void work() {
    for (;;) {
      const int64_t chunk = next.fetch_add(1, std::memory_order_relaxed);
      if (chunk >= num_chunks) return;
      try {
        function(context, chunk);
      } catch (...) {
        std::lock_guard<std::mutex> lock(error_mutex);
        if (!error) error = std::current_exception();
        next.store(num_chunks, std::memory_order_relaxed);
      }
    }
  }
};

class Pool {
 public:
  void run(Job& job, int threads) {
    {
      std::lock_guard<std::mutex> lock(mutex_);
      while (static_cast<int>(workers_.size()) < threads - 1)
        workers_.emplace_back([this, id = workers_.size()] { serve(id); });
      job_ = &job;
      invited_ = static_cast<size_t>(threads - 1);
      active_ = invited_;
      ++generation_;
    }
    wake_.notify_all();
    job.work();
    std::unique_lock<std::mutex> lock(mutex_);
    done_.wait(lock, [this] { return active_ == 0; });
    job_ = nullptr;
  }

  std::mutex busy;  // held by the caller whose job is running

 private:
  void serve(size_t id) {
    uint64_t seen = 0;
    std::unique_lock<std::mutex> lock(mutex_);
    for (;;) {
      wake_.wait(lock, [&] { return generation_ != seen; });
      seen = generation_;
      if (id >= invited_) continue;
      Job* job = job_;
      lock.unlock();
      job->work();
      lock.lock();
      if (--active_ == 0) done_.notify_one();
    }
  }

  std::mutex mutex_;
  std::condition_variable wake_, done_;
  std::vector<std::thread> workers_;
  Job* job_ = nullptr;
  size_t invited_ = 0, active_ = 0;
  uint64_t generation_ = 0;
};

// The pool is never destroyed: its threads wait until the process ends. A forked child has none of them,
// so it starts with a new one.
Pool* pool = nullptr;
std::mutex pool_mutex;

Pool& get_pool() {
  std::lock_guard<std::mutex> lock(pool_mutex);
  if (!pool) {
    static const int registered = pthread_atfork(
        [] { pool_mutex.lock(); }, [] { pool_mutex.unlock(); },
        [] {
          pool = nullptr;
          pool_mutex.unlock();
        });
    (void)registered;
    pool = new Pool;
  }
  return *pool;
}

}  // namespace

int hardware_threads() {
#ifdef __linux__
  cpu_set_t set;
  if (sched_getaffinity(0, sizeof set, &set) == 0) return CPU_COUNT(&set);
#endif
  const unsigned n = std::thread::hardware_concurrency();
  return n ? static_cast<int>(n) : 1;
}

void run_chunks(int64_t num_chunks, int threads, ChunkFunction function, void* context) {
  if (num_chunks <= 0) return;
  if (threads <= 0) threads = hardware_threads();
  if (threads > num_chunks) threads = static_cast<int>(num_chunks);

  Job job;
  job.function = function;
  job.context = context;
  job.num_chunks = num_chunks;
  if (threads > 1) {
    Pool& shared = get_pool();
    std::unique_lock<std::mutex> lock(shared.busy, std::try_to_lock);
    if (lock.owns_lock())
      shared.run(job, threads);
    else
      job.work();
  } else {
    job.work();
  }
  if (job.error) std::rethrow_exception(job.error);
}

}  // namespace splatree
