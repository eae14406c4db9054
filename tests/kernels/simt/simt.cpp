// The scheduler of simt.h: fibers, barriers, and what every word remembers. driver.cpp plays the driver above it.
#include "simt.h"

#include <setjmp.h>
#include <ucontext.h>

#include <algorithm>
#include <memory>
#include <random>

namespace simt {

Dim3 thread_index, block_index, block_size, grid_size;
std::map<const char*, Memory> device_memory;
std::string failure;

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

std::vector<Memory*> shared_memory;
std::vector<Fiber> fibers;
std::vector<int> ready;
std::vector<uint64_t> block_values, warp_values;
std::vector<uint32_t> warp_epochs;
uint32_t launch, block_number, block_epoch;
int current;
jmp_buf scheduler;
ucontext_t scheduler_context;
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

bool ordered(const Touch& before, const Touch& now) {
  if (before.launch != now.launch || before.launch == 0) return true;
  if (before.block != now.block) return false;
  if (before.block_epoch != now.block_epoch) return true;
  if (before.thread == now.thread) return true;
  return before.warp == now.warp && before.warp_epoch != now.warp_epoch;
}

}  // namespace

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
  if (found == device_memory.end())
    fail(address ? "found an array that is not in device memory" : "found an array without memory");
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
