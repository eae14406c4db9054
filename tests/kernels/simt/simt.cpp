// The scheduler of simt.h, and the functions of the CUDA driver that the runtime calls (kernels/cuda/driver.py), played on a
// processor: memory is the process's own, a module is the table of kernels linked into this library.
//
// As on a device, nothing runs before the host waits: copies from and to pinned memory, memsets and launches queue up until
// then. So a host that overwrites what is still to be copied, or reads what has not arrived, gets what it deserves. Waits
// are counted.
#include "simt.h"

#include <dlfcn.h>
#include <setjmp.h>
#include <ucontext.h>

#include <algorithm>
#include <chrono>
#include <deque>
#include <map>
#include <memory>
#include <random>

namespace simt {

Dim3 thread_index, block_index, block_size, grid_size;

namespace {

constexpr size_t STACK = 256 << 10;

struct Fiber {
  ucontext_t context;
  jmp_buf place;
  std::unique_ptr<char[]> stack;
  bool started, done;
  bool waits;
  Barrier barrier;
  const char* name;
  uint32_t mask;
  uint64_t value;
};

using Kernel = void (*)(const void*, int);

std::map<const char*, Memory> device_memory;  // by address
std::vector<Memory*> shared_memory;
std::vector<Fiber> fibers;
std::vector<int> ready;
std::vector<uint64_t> block_values, warp_values;
std::vector<uint32_t> warp_epochs;
uint32_t launch, block_number, block_epoch;
int current;
jmp_buf scheduler;
ucontext_t scheduler_context;
std::string failure;
std::mt19937 random_order;
Kernel kernel;
const void* kernel_job;
int kernel_argument;

int warp_of(int thread) { return thread / 32; }
int lanes_of(int warp) { return std::min<int>(32, int(block_size.x) - 32 * warp); }

std::string where(int thread) { return "thread " + std::to_string(thread) + " of block " + std::to_string(block_number); }

void run_fiber() {
  kernel(kernel_job, kernel_argument);
  fibers[current].done = true;
  _longjmp(scheduler, 1);
}

// Lets threads go on whose barrier is complete.
void release(int thread) {
  Fiber& arrived = fibers[thread];
  if (arrived.barrier == BLOCK) {
    for (const Fiber& f : fibers)
      if (f.done || !f.waits || f.barrier != BLOCK || std::strcmp(f.name, arrived.name)) return;
    ++block_epoch;
    for (size_t i = 0; i < fibers.size(); ++i) {
      block_values[i] = fibers[i].value;
      fibers[i].waits = false;
      ready.push_back(int(i));
    }
    return;
  }
  const int warp = warp_of(thread), first = 32 * warp;
  const uint32_t there = lanes_of(warp) == 32 ? ~0u : (1u << lanes_of(warp)) - 1;
  if (arrived.mask & ~there) fail(std::string(arrived.name) + ": its mask names lanes that the warp does not have");
  for (int l = 0; l < lanes_of(warp); ++l) {
    if (!(arrived.mask >> l & 1)) continue;
    const Fiber& f = fibers[first + l];
    if (f.done || !f.waits || f.barrier != WARP || f.mask != arrived.mask || std::strcmp(f.name, arrived.name)) return;
  }
  if (arrived.mask == there) ++warp_epochs[warp];
  for (int l = 0; l < lanes_of(warp); ++l) {
    if (!(arrived.mask >> l & 1)) continue;
    warp_values[first + l] = fibers[first + l].value;
    fibers[first + l].waits = false;
    ready.push_back(first + l);
  }
}

void run_block() {
  block_epoch = 0;
  std::fill(warp_epochs.begin(), warp_epochs.end(), 0);
  for (Memory* memory : shared_memory) std::fill(memory->words.begin(), memory->words.end(), Word{});
  ready.clear();
  for (size_t i = 0; i < fibers.size(); ++i) {
    Fiber& f = fibers[i];
    f.started = f.done = f.waits = false;
    ready.push_back(int(i));
  }
  size_t num_done = 0;
  while (num_done < fibers.size()) {
    if (ready.empty()) {
      std::string message;
      for (size_t i = 0; i < fibers.size() && message.size() < 600; ++i)
        if (!fibers[i].done) message += where(int(i)) + " waits at " + fibers[i].name + "; ";
      fail(message + std::to_string(num_done) + " threads have ended");
    }
    const size_t pick = random_order() % ready.size();
    current = ready[pick];
    ready[pick] = ready.back();
    ready.pop_back();
    thread_index.x = unsigned(current);
    Fiber& f = fibers[current];
    if (!_setjmp(scheduler)) {
      if (f.started) _longjmp(f.place, 1);
      f.started = true;
      getcontext(&f.context);
      f.context.uc_stack.ss_sp = f.stack.get();
      f.context.uc_stack.ss_size = STACK;
      f.context.uc_link = nullptr;
      makecontext(&f.context, run_fiber, 0);
      setcontext(&f.context);
    }
    if (!failure.empty()) return;
    if (f.done)
      ++num_done;
    else
      release(current);
    if (!failure.empty()) return;
  }
}

void run_grid(Kernel function, const void* job, int argument, unsigned blocks, unsigned threads, uint32_t seed) {
  ++launch;
  kernel = function, kernel_job = job, kernel_argument = argument;
  grid_size.x = blocks, block_size.x = threads;
  random_order.seed(seed + launch);
  if (fibers.size() < threads || fibers.size() > threads) {
    fibers.resize(threads);
    for (Fiber& f : fibers)
      if (!f.stack) f.stack.reset(new char[STACK]);
  }
  block_values.assign(threads, 0), warp_values.assign(threads, 0), warp_epochs.assign(threads / 32 + 1, 0);
  std::vector<unsigned> order(blocks);
  for (unsigned i = 0; i < blocks; ++i) order[i] = i;
  std::shuffle(order.begin(), order.end(), random_order);
  for (const unsigned block : order) {
    block_number = block_index.x = block;
    run_block();
    if (!failure.empty()) return;
  }
}

bool ordered(const Touch& before, const Touch& now) {
  if (before.launch != now.launch || before.launch == 0) return true;
  if (before.block != now.block) return false;
  if (before.block_epoch != now.block_epoch) return true;
  if (before.thread == now.thread) return true;
  return before.warp == now.warp && before.warp_epoch != now.warp_epoch;
}

}  // namespace

void fail(const std::string& message) {
  if (failure.empty()) failure = message;
  _longjmp(scheduler, 1);
}

int lane() { return current % 32; }

const uint64_t* wait(Barrier barrier, const char* name, uint32_t mask, uint64_t value) {
  const int thread = current;
  Fiber& f = fibers[thread];
  if (barrier == WARP && !(mask >> (thread % 32) & 1)) fail(std::string(name) + ": " + where(thread) + " is not in its own mask");
  f.waits = true, f.barrier = barrier, f.name = name, f.mask = mask, f.value = value;
  if (!_setjmp(f.place)) _longjmp(scheduler, 1);
  return barrier == BLOCK ? block_values.data() : &warp_values[32 * warp_of(thread)];
}

void add_shared(Memory& memory) { shared_memory.push_back(&memory); }

Memory& memory_at(const void* address) {
  const auto found = device_memory.find(static_cast<const char*>(address));
  if (found == device_memory.end()) fail(address ? "found an array that is not in device memory" : "found an array without memory");
  return found->second;
}

void touch(Memory& memory, size_t offset, size_t bytes, Access access) {
  if (bytes % 4 && memory.grain == 4) {
    std::vector<Word> fine(memory.bytes);
    for (size_t i = 0; i < fine.size(); ++i) fine[i] = memory.words[i / 4];
    memory.words.swap(fine);
    memory.grain = 1;
  }
  const Touch now{launch, block_number, block_epoch, warp_epochs[warp_of(current)], current, warp_of(current)};
  for (size_t i = offset / memory.grain; i < (offset + bytes) / memory.grain; ++i) {
    Word& word = memory.words[i];
    const auto complain = [&](const char* what) {
      fail(memory.name + ", word " + std::to_string(i) + ": " + what + ", " + where(current));
    };
    if (access != WRITE && !word.defined) complain("read before it is written");
    if (!(access == ATOMIC && word.atomic) && !ordered(word.written, now))
      complain(access == READ ? "race of a read with a write before" : "race of two writes");
    if (access != READ && !ordered(word.read, now)) complain("race of a write with a read before");
    if (access == READ) {
      // Several readers: they are remembered as a warp's, or as all of the block's.
      const bool joins = word.read.launch == now.launch && word.read.block == now.block &&
                         word.read.block_epoch == now.block_epoch && word.read.thread != now.thread;
      const bool same_warp = joins && word.read.warp == now.warp;
      const bool other_block = word.read.launch == now.launch && word.read.block != now.block;
      word.read = now;
      if (joins) word.read.thread = -2;
      if (joins && !same_warp) word.read.warp = -2;
      if (other_block) word.read.block = ~0u;
    } else {
      word.written = now;
      word.atomic = access == ATOMIC;
      word.defined = true;
    }
  }
}

}  // namespace simt

// The driver. Names, arguments and numbers are those of cuda.h.
namespace {

using simt::failure;
using Work = std::function<void()>;
using Handle = void*;
using Address = unsigned long long;

enum Result { SUCCESS = 0, INVALID_VALUE = 1, OUT_OF_MEMORY = 2, NOT_FOUND = 500, LAUNCH_FAILED = 719, CAPTURING = 900 };

std::deque<Work> queue;
std::vector<Work>* recording = nullptr;
std::map<const char*, size_t> pinned;
long long num_waits = 0, num_launches = 0;
uint32_t seed = 1;
size_t memory_limit = size_t(1) << 30, memory_used = 0;
std::map<Handle, double> event_times;

int add(Work work) {
  if (!failure.empty()) return LAUNCH_FAILED;
  if (recording)
    recording->push_back(std::move(work));
  else
    queue.push_back(std::move(work));
  return SUCCESS;
}

int finish() {
  if (recording) return CAPTURING;
  while (!queue.empty() && failure.empty()) {
    Work work = std::move(queue.front());
    queue.pop_front();
    work();
  }
  return failure.empty() ? SUCCESS : LAUNCH_FAILED;
}

int wait_for_device() {
  ++num_waits;
  return finish();
}

bool is_pinned(const void* p) {
  auto after = pinned.upper_bound(static_cast<const char*>(p));
  if (after == pinned.begin()) return false;
  --after;
  return static_cast<const char*>(p) < after->first + after->second;
}

// The array that holds an address, and the place in it.
simt::Memory* memory_around(Address address, size_t& offset) {
  const char* p = reinterpret_cast<const char*>(address);
  auto after = simt::device_memory.upper_bound(p);
  if (after == simt::device_memory.begin()) return nullptr;
  --after;
  offset = size_t(p - after->first);
  return offset < after->second.bytes ? &after->second : nullptr;
}

void define(simt::Memory& memory, size_t offset, size_t bytes) {
  for (size_t i = offset / memory.grain; i < (offset + bytes + memory.grain - 1) / memory.grain; ++i) {
    memory.words[i] = simt::Word{};
    memory.words[i].defined = true;
  }
}

}  // namespace

#define API extern "C" __attribute__((visibility("default")))

// For tests.
API void simt_seed(uint32_t value) { seed = value; }
API long long simt_waits() { return num_waits; }
API long long simt_launches() { return num_launches; }
API const char* simt_failure() { return failure.c_str(); }
API void simt_forget_failure() {
  failure.clear();
  queue.clear();
}
API void simt_limit_memory(size_t bytes) { memory_limit = bytes; }
API void simt_name(Address address, const char* name) {
  size_t offset;
  if (simt::Memory* memory = memory_around(address, offset)) memory->name = name;
}

API int cuInit(unsigned) { return SUCCESS; }
API int cuDriverGetVersion(int* version) { return *version = 13000, SUCCESS; }
API int cuDeviceGetCount(int* count) { return *count = 1, SUCCESS; }
API int cuDeviceGet(int* device, int ordinal) { return *device = ordinal, ordinal ? 101 : SUCCESS; }
API int cuDeviceGetName(char* name, int size, int) { return std::strncpy(name, "SIMT emulator", size), SUCCESS; }
API int cuDeviceGetAttribute(int* value, int attribute, int) {
  *value = attribute == 16 ? 2 : attribute == 75 ? 9 : 0;  // multiprocessors; compute capability
  return SUCCESS;
}
API int cuDeviceTotalMem_v2(size_t* bytes, int) { return *bytes = memory_limit, SUCCESS; }
API int cuMemGetInfo_v2(size_t* left, size_t* total) {
  return *left = memory_limit - memory_used, *total = memory_limit, SUCCESS;
}
API int cuDevicePrimaryCtxRetain(Handle* context, int) { return *context = &queue, SUCCESS; }
API int cuCtxSetCurrent(Handle) { return SUCCESS; }
API int cuModuleLoadData(Handle* module, const void*) { return *module = &queue, SUCCESS; }
API int cuModuleGetFunction(Handle* function, Handle, const char* name) {
  Dl_info self;
  dladdr(reinterpret_cast<void*>(&cuInit), &self);
  Handle library = dlopen(self.dli_fname, RTLD_NOW | RTLD_NOLOAD);
  *function = dlsym(library, name);
  return *function ? SUCCESS : NOT_FOUND;
}
API int cuMemAlloc_v2(Address* address, size_t bytes) {
  if (memory_used + bytes > memory_limit) return OUT_OF_MEMORY;
  memory_used += bytes;
  char* data = static_cast<char*>(std::aligned_alloc(256, (bytes + 511) / 256 * 256));
  std::memset(data, 0xa5, bytes);
  simt::Memory& memory = simt::device_memory[data];
  memory.name = "array";
  memory.data = data, memory.bytes = bytes;
  memory.words.assign((bytes + 3) / 4, simt::Word{});
  *address = reinterpret_cast<Address>(data);
  return SUCCESS;
}
API int cuMemFree_v2(Address address) {
  const int result = wait_for_device();
  size_t offset;
  simt::Memory* memory = memory_around(address, offset);
  if (!memory || offset) return INVALID_VALUE;
  memory_used -= memory->bytes;
  char* data = memory->data;
  simt::device_memory.erase(data);
  std::free(data);
  return result;
}
API int cuMemAllocHost_v2(void** address, size_t bytes) {
  *address = std::calloc(1, bytes);
  pinned[static_cast<char*>(*address)] = bytes;
  return SUCCESS;
}
API int cuMemFreeHost(void* address) {
  pinned.erase(static_cast<char*>(address));
  std::free(address);
  return SUCCESS;
}
API int cuMemcpyHtoDAsync_v2(Address to, const void* from, size_t bytes, Handle) {
  size_t offset;
  if (!memory_around(to, offset)) return INVALID_VALUE;
  // What is not pinned is taken at once.
  std::shared_ptr<std::vector<char>> taken;
  if (!is_pinned(from))
    taken = std::make_shared<std::vector<char>>(static_cast<const char*>(from), static_cast<const char*>(from) + bytes);
  return add([=] {
    size_t at;
    simt::Memory* memory = memory_around(to, at);
    if (!memory || at + bytes > memory->bytes) {
      failure = "copy to the device: found an array that is too short";
      return;
    }
    std::memcpy(memory->data + at, taken ? taken->data() : from, bytes);
    define(*memory, at, bytes);
  });
}
API int cuMemcpyDtoHAsync_v2(void* to, Address from, size_t bytes, Handle) {
  const bool later = is_pinned(to);
  const int result = add([=] {
    size_t at;
    simt::Memory* memory = memory_around(from, at);
    if (!memory || at + bytes > memory->bytes)
      failure = "copy from the device: found an array that is too short";
    else
      std::memcpy(to, memory->data + at, bytes);
  });
  return result || later ? result : wait_for_device();
}
API int cuMemsetD8Async(Address to, unsigned char value, size_t bytes, Handle) {
  return add([=] {
    size_t at;
    simt::Memory* memory = memory_around(to, at);
    if (!memory || at + bytes > memory->bytes) {
      failure = "memset: found an array that is too short";
      return;
    }
    std::memset(memory->data + at, value, bytes);
    define(*memory, at, bytes);
  });
}
API int cuLaunchKernel(Handle function, unsigned blocks, unsigned, unsigned, unsigned threads, unsigned, unsigned,
                       unsigned, Handle, void** arguments, void**) {
  if (!blocks || !threads || threads > 1024) return INVALID_VALUE;
  const void* job = *static_cast<const void**>(arguments[0]);
  const int argument = *static_cast<int*>(arguments[1]);
  return add([=] {
    ++num_launches;
    simt::run_grid(reinterpret_cast<simt::Kernel>(function), job, argument, blocks, threads, seed);
  });
}
API int cuStreamCreate(Handle* stream, unsigned) { return *stream = &queue, SUCCESS; }
API int cuStreamSynchronize(Handle) { return wait_for_device(); }
API int cuEventCreate(Handle* event, unsigned) {
  *event = new char;
  event_times[*event] = 0;
  return SUCCESS;
}
API int cuEventRecord(Handle event, Handle) {
  return add([=] { event_times[event] = std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count(); });
}
API int cuEventSynchronize(Handle) { return wait_for_device(); }
API int cuEventElapsedTime(float* ms, Handle from, Handle to) {
  return *ms = float(1e3 * (event_times[to] - event_times[from])), SUCCESS;
}
API int cuEventDestroy_v2(Handle event) {
  event_times.erase(event);
  delete static_cast<char*>(event);
  return SUCCESS;
}
API int cuStreamBeginCapture_v2(Handle, int) {
  if (recording) return CAPTURING;
  recording = new std::vector<Work>;
  return SUCCESS;
}
API int cuStreamEndCapture(Handle, Handle* graph) {
  *graph = recording;
  recording = nullptr;
  return *graph ? SUCCESS : INVALID_VALUE;
}
API int cuGraphInstantiateWithFlags(Handle* exec, Handle graph, unsigned long long) {
  *exec = new std::vector<Work>(*static_cast<std::vector<Work>*>(graph));
  return SUCCESS;
}
API int cuGraphDestroy(Handle graph) { return delete static_cast<std::vector<Work>*>(graph), SUCCESS; }
API int cuGraphExecDestroy(Handle exec) { return delete static_cast<std::vector<Work>*>(exec), SUCCESS; }
API int cuGraphLaunch(Handle exec, Handle) {
  for (const Work& work : *static_cast<std::vector<Work>*>(exec))
    if (const int result = add(work)) return result;
  return SUCCESS;
}
API int cuGetErrorName(int error, const char** name) {
  *name = error == OUT_OF_MEMORY ? "CUDA_ERROR_OUT_OF_MEMORY"
          : error == LAUNCH_FAILED ? "CUDA_ERROR_LAUNCH_FAILED"
          : error == CAPTURING ? "CUDA_ERROR_STREAM_CAPTURE_UNSUPPORTED"
          : error == NOT_FOUND ? "CUDA_ERROR_NOT_FOUND"
                               : "CUDA_ERROR_INVALID_VALUE";
  return SUCCESS;
}
API int cuGetErrorString(int error, const char** text) {
  *text = error == LAUNCH_FAILED ? failure.c_str() : "refused by the emulator";
  return SUCCESS;
}
