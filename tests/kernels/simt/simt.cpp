// The scheduler of simt.h: fibers, barriers, and what every word remembers. driver.cpp plays the driver above it.
#include "simt.h"

#include <setjmp.h>
#include <ucontext.h>

#include <algorithm>
#include <deque>
#include <memory>
#include <random>

namespace simt {

Dim3 thread_index, block_index, block_size, grid_size;
std::map<const char*, Memory> device_memory;
std::string failure;
unsigned num_resident = 1;

namespace {

constexpr size_t STACK = 256 << 10;
constexpr unsigned MOST_STEPS = 64;      // of a turn of a block among others
constexpr long long PATIENCE = 8 << 20;  // steps in which no block ends: then all wait in vain

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

// What a block has in an array of shared memory.
struct Contents {
  std::unique_ptr<float4[]> bytes;
  std::vector<Word> words;
  bool touched = false;
};

struct Publication {
  uint64_t *word, value;
};

// A block at work.
struct Block {
  unsigned number;
  uint32_t epoch;
  size_t num_done;
  std::vector<Fiber> fibers;
  std::vector<int> ready;
  std::vector<uint64_t> block_values, warp_values;
  std::vector<uint32_t> warp_epochs;
  std::vector<Contents> shared;       // by the place in shared_memory; words of the block that runs are there instead
  std::deque<Publication> published;  // what other blocks do not see yet
};

std::vector<Memory*> shared_memory;
std::deque<Block> blocks;
Block* running = nullptr;
uint32_t launch;
int current;
long long num_idle_steps;  // since a block has ended
jmp_buf scheduler;
std::mt19937 random_order;
Kernel kernel;
const void* kernel_job;
int kernel_argument;

int warp_of(int thread) { return thread / 32; }
int lanes_of(int warp) { return std::min<int>(32, int(block_size.x) - 32 * warp); }

std::string where(int thread) { return "thread " + std::to_string(thread) + " of block " + std::to_string(running->number); }

void run_fiber() {
  kernel(kernel_job, kernel_argument);
  running->fibers[current].done = true;
  _longjmp(scheduler, 1);
}

// Lets threads go on whose barrier is complete.
void release(int thread) {
  std::vector<Fiber>& fibers = running->fibers;
  Fiber& arrived = fibers[thread];
  if (arrived.barrier == BLOCK) {
    for (unsigned i = 0; i < block_size.x; ++i) {
      const Fiber& f = fibers[i];
      if (f.done || !f.waits || f.barrier != BLOCK || std::strcmp(f.name, arrived.name)) return;
    }
    ++running->epoch;
    for (unsigned i = 0; i < block_size.x; ++i) {
      running->block_values[i] = fibers[i].value;
      fibers[i].waits = false;
      running->ready.push_back(int(i));
    }
    return;
  }
  const int warp = warp_of(thread), first = 32 * warp;
  const uint32_t there = lanes_of(warp) == 32 ? ~0u : (1u << lanes_of(warp)) - 1;
  if (arrived.mask & ~there) {
    failure = std::string(arrived.name) + ": its mask names lanes that the warp does not have";
    return;
  }
  for (int l = 0; l < lanes_of(warp); ++l) {
    if (!(arrived.mask >> l & 1)) continue;
    const Fiber& f = fibers[first + l];
    if (f.done || !f.waits || f.barrier != WARP || f.mask != arrived.mask || std::strcmp(f.name, arrived.name)) return;
  }
  if (arrived.mask == there) ++running->warp_epochs[warp];
  for (int l = 0; l < lanes_of(warp); ++l) {
    if (!(arrived.mask >> l & 1)) continue;
    running->warp_values[first + l] = fibers[first + l].value;
    fibers[first + l].waits = false;
    running->ready.push_back(first + l);
  }
}

// Gives an array of shared memory what a block has in it.
void place(Block& block, size_t i) {
  if (block.shared.size() <= i) block.shared.resize(i + 1);
  Contents& contents = block.shared[i];
  Memory& memory = *shared_memory[i];
  if (!contents.bytes) {
    contents.bytes.reset(new float4[(memory.bytes + 15) / 16]);
    contents.words.resize((memory.bytes + 3) / 4);
  }
  memory.data = reinterpret_cast<char*>(contents.bytes.get());
  memory.words.swap(contents.words);
  memory.touched = contents.touched;
}

void leave() {
  for (size_t i = 0; running && i < shared_memory.size(); ++i) {
    shared_memory[i]->words.swap(running->shared[i].words);
    running->shared[i].touched = shared_memory[i]->touched;
  }
  running = nullptr;
}

void enter(Block& block) {
  if (running == &block) return;
  leave();
  running = &block;
  for (size_t i = 0; i < shared_memory.size(); ++i) place(block, i);
}

void begin(Block& block, unsigned number) {
  enter(block);
  block.number = number, block.epoch = 0, block.num_done = 0;
  block.block_values.assign(block_size.x, 0), block.warp_values.assign(block_size.x, 0);
  block.warp_epochs.assign(block_size.x / 32 + 1, 0);
  for (Memory* memory : shared_memory)
    if (memory->touched) std::fill(memory->words.begin(), memory->words.end(), Word{}), memory->touched = false;
  if (block.fibers.size() < block_size.x) block.fibers.resize(block_size.x);
  block.ready.clear();
  for (unsigned i = 0; i < block_size.x; ++i) {
    Fiber& f = block.fibers[i];
    if (!f.stack) f.stack.reset(new char[STACK]);
    f.started = f.done = f.waits = false;
    block.ready.push_back(int(i));
  }
}

// Lets others see what a block has published: all, or as much as chance allows.
void show(Block& block, bool all) {
  while (!block.published.empty() && (all || random_order() % 2)) {
    *block.published.front().word = block.published.front().value;
    block.published.pop_front();
  }
}

// Lets a thread of the block that runs go on to its next barrier.
void resume(int thread) {
  current = thread;
  thread_index.x = unsigned(thread);
  block_index.x = running->number;
  Fiber& f = running->fibers[thread];
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
}

// The same for any that may, for so many times at most.
void run(long long num_steps) {
  Block& block = *running;
  std::vector<int>& ready = block.ready;
  for (; num_steps && block.num_done < block_size.x && failure.empty(); --num_steps) {
    if (ready.empty()) {
      for (size_t i = 0; i < block_size.x && failure.size() < 600; ++i)
        if (!block.fibers[i].done) failure += where(int(i)) + " waits at " + block.fibers[i].name + "; ";
      failure += std::to_string(block.num_done) + " threads have ended";
      return;
    }
    if (++num_idle_steps > PATIENCE) {
      failure = "found threads that wait for what no resident block will do, as " + where(ready[0]);
      return;
    }
    const size_t pick = random_order() % ready.size();
    const int thread = ready[pick];
    ready[pick] = ready.back();
    ready.pop_back();
    resume(thread);
    if (block.fibers[thread].done)
      ++block.num_done;
    else if (failure.empty())
      release(thread);
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

void run_grid(Kernel function, const void* job, int argument, unsigned num_blocks, unsigned threads, uint32_t seed) {
  ++launch;
  kernel = function, kernel_job = job, kernel_argument = argument;
  grid_size.x = num_blocks, block_size.x = threads;
  random_order.seed(seed + launch);
  std::vector<unsigned> order(num_blocks);
  for (unsigned i = 0; i < num_blocks; ++i) order[i] = i;
  std::shuffle(order.begin(), order.end(), random_order);
  if (blocks.size() < num_resident) blocks.resize(num_resident);
  num_idle_steps = 0;
  unsigned num_begun = 0;
  std::vector<Block*> at_work;
  while (num_begun < std::min(num_resident, num_blocks)) {
    Block& block = blocks[num_begun];
    block.published.clear();
    begin(block, order[num_begun++]);
    at_work.push_back(&block);
  }
  while (!at_work.empty()) {
    const size_t turn = at_work.size() > 1 ? random_order() % at_work.size() : 0;
    Block& block = *at_work[turn];
    enter(block);
    run(at_work.size() > 1 ? 1 + random_order() % MOST_STEPS : -1);
    if (!failure.empty()) return;
    const bool has_ended = block.num_done == block_size.x;
    show(block, has_ended);
    if (!has_ended) continue;
    num_idle_steps = 0;
    if (num_begun < num_blocks)
      begin(block, order[num_begun++]);
    else
      at_work.erase(at_work.begin() + long(turn));
  }
}

void publish_word(uint64_t* word, uint64_t value) {
  running->published.push_back({word, value});
  if (num_resident == 1) show(*running, true);
}

uint64_t published_word(const uint64_t* word) {
  for (auto own = running->published.rbegin(); own != running->published.rend(); ++own)
    if (own->word == word) return own->value;
  return *word;
}

void fail(const std::string& message) {
  if (failure.empty()) failure = message;
  _longjmp(scheduler, 1);
}

int lane() { return current % 32; }

const uint64_t* wait(Barrier barrier, const char* name, uint32_t mask, uint64_t value) {
  const int thread = current;
  Fiber& f = running->fibers[thread];
  if (barrier == WARP && !(mask >> (thread % 32) & 1)) fail(std::string(name) + ": " + where(thread) + " is not in its own mask");
  f.waits = true, f.barrier = barrier, f.name = name, f.mask = mask, f.value = value;
  if (!_setjmp(f.place)) _longjmp(scheduler, 1);
  return barrier == BLOCK ? running->block_values.data() : &running->warp_values[32 * warp_of(thread)];
}

void add_shared(Memory& memory) {
  shared_memory.push_back(&memory);
  place(*running, shared_memory.size() - 1);
}

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
  memory.touched = true;
  const int warp = warp_of(current);
  const Touch now{launch, running->number, running->epoch, running->warp_epochs[warp], current, warp};
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
