#include "cpu/runtime/pool.h"

#include <algorithm>
#include <atomic>
#include <condition_variable>
#include <exception>
#include <mutex>
#include <system_error>
#include <thread>
#include <vector>

#ifndef _WIN32
#include <pthread.h>
#endif

#include "cpu/runtime/processors.h"

namespace splatree {
namespace {

struct Job {
  ChunkFunction function;
  void* context;
  int64_t num_chunks;
  int most_helpers;  // threads besides the caller
  std::atomic<int64_t> next{0};
  int num_helpers = 0;           // at work on it now; guarded by the pool's mutex
  std::condition_variable left;  // the last helper has left
  std::mutex error_mutex;
  std::exception_ptr error;

  bool has_chunks() const { return next.load(std::memory_order_relaxed) < num_chunks; }

  // Runs one chunk; false if none is left.
  bool run_chunk() {
    const int64_t chunk = next.fetch_add(1, std::memory_order_relaxed);
    if (chunk >= num_chunks) return false;
    try {
      function(context, chunk);
    } catch (...) {
      std::lock_guard<std::mutex> lock(error_mutex);
      if (!error) error = std::current_exception();
      next.store(num_chunks, std::memory_order_relaxed);
    }
    return true;
  }
};

class Pool {
 public:
  // Runs the job on this thread and on workers that are free. Workers that wake up late find the job gone, and nobody waits
  // for them: only for those that are at work on one of its chunks.
  void run(Job& job) {
    {
      std::lock_guard<std::mutex> lock(mutex_);
      hire(job.most_helpers);
      jobs_.push_back(&job);
      num_started_.fetch_add(1, std::memory_order_relaxed);
    }
    for (int i = 0; i < job.most_helpers; ++i) wake_.notify_one();
    while (job.run_chunk()) {
    }
    std::unique_lock<std::mutex> lock(mutex_);
    jobs_.erase(std::find(jobs_.begin(), jobs_.end(), &job));
    job.left.wait(lock, [&job] { return job.num_helpers == 0; });
  }

 private:
  // Where the system gives no more threads, there are fewer.
  void hire(int num_workers) {
    try {
      while (static_cast<int>(workers_.size()) < num_workers) workers_.emplace_back([this] { serve(); });
    } catch (const std::system_error&) {
    }
  }

  void serve() {
    std::unique_lock<std::mutex> lock(mutex_);
    for (;;) {
      Job* const job = neediest();
      if (!job) {
        wake_.wait(lock);
        continue;
      }
      ++job->num_helpers;
      const uint64_t seen = num_started_.load(std::memory_order_relaxed);
      lock.unlock();
      // A job that starts meanwhile gets its share of the workers: they choose anew.
      while (num_started_.load(std::memory_order_relaxed) == seen && job->run_chunk()) {
      }
      lock.lock();
      if (--job->num_helpers == 0) job->left.notify_one();
    }
  }

  // The job that has the fewest helpers, of those that take one more; null if there is none.
  Job* neediest() const {
    Job* found = nullptr;
    for (Job* job : jobs_)
      if (job->has_chunks() && job->num_helpers < job->most_helpers && (!found || job->num_helpers < found->num_helpers))
        found = job;
    return found;
  }

  std::mutex mutex_;
  std::condition_variable wake_;
  std::vector<std::thread> workers_;
  std::vector<Job*> jobs_;                // running now
  std::atomic<uint64_t> num_started_{0};  // of jobs, ever
};

// The pool is never destroyed: its threads wait until the process ends. A forked child has none of them,
// so it starts with a new one.
Pool* pool = nullptr;
std::mutex pool_mutex;

Pool& get_pool() {
  std::lock_guard<std::mutex> lock(pool_mutex);
  if (!pool) {
#ifndef _WIN32
    static const int registered = pthread_atfork([] { pool_mutex.lock(); }, [] { pool_mutex.unlock(); },
                                                 [] {
                                                   pool = nullptr;
                                                   pool_mutex.unlock();
                                                 });
    (void)registered;
#endif
    pool = new Pool;
  }
  return *pool;
}

}  // namespace

void run_chunks(int64_t num_chunks, int threads, ChunkFunction function, void* context) {
  if (num_chunks <= 0) return;
  if (threads <= 0 && num_chunks > 1) threads = hardware_threads();
  if (threads > num_chunks) threads = static_cast<int>(num_chunks);

  Job job;
  job.function = function;
  job.context = context;
  job.num_chunks = num_chunks;
  job.most_helpers = threads - 1;
  if (threads > 1)
    get_pool().run(job);
  else
    while (job.run_chunk()) {
    }
  if (job.error) std::rethrow_exception(job.error);
}

}  // namespace splatree
