// The thread model of CUDA on a processor, to run device code of small scenes in tests.
//
// Each thread of a block is a fiber; barriers, votes and shuffles hand control back to a scheduler, which goes on with another
// fiber in an order drawn from a seed. Blocks run one after the other, in such an order too, or a few of them take turns
// (`num_resident`). These see late, and in its order, what another of them publishes; who waits for a block that is not resident
// waits in vain, as on a device. Every access to an array in device or shared memory is checked:
//
//   bounds      the element lies in the array
//   defined     a word that is read was written before: by a copy, a kernel, or, in shared memory, by this block
//   races       two threads that touch one word, one of them to write, have a barrier between them (a warp's votes, shuffles and
//               __syncwarp order its own threads; atomics do not race with each other; blocks of one launch have no order)
//   barriers    all threads of a block, all lanes of a mask, arrive at the same barrier
//
// What is wrong ends the launch with a message; driver.cpp hands it on as the error of the driver that it plays for the runtime.
#pragma once

#include <cmath>
#include <cstdint>
#include <cstring>
#include <functional>
#include <map>
#include <string>
#include <type_traits>
#include <vector>

namespace simt {

struct Dim3 {
  unsigned x = 1, y = 1, z = 1;
};

// The fiber that runs, and its surroundings.
extern Dim3 thread_index, block_index, block_size, grid_size;

[[noreturn]] void fail(const std::string& message);

// What a word remembers of those who touched it.
struct Touch {
  uint32_t launch = 0, block = 0, block_epoch = 0, warp_epoch = 0;
  int32_t thread = -1, warp = -1;  // -1: several
};
struct Word {
  bool defined = false;
  bool atomic = false;  // the last write
  Touch written, read;
};

// An array in device memory, or one that a block shares.
struct Memory {
  std::string name;
  char* data = nullptr;
  size_t bytes = 0;
  bool shared = false;
  bool touched = false;  // by the block that runs
  size_t grain = 4;      // bytes a word; 1 for arrays of bytes
  std::vector<Word> words;
};

// Arrays in device memory, by address.
extern std::map<const char*, Memory> device_memory;
// What went wrong first; empty if nothing did.
extern std::string failure;
// How many blocks are at work at once.
extern unsigned num_resident;
// Runs a kernel, whose threads take turns in an order drawn from the seed.
using Kernel = void (*)(const void*, int);
void run_grid(Kernel kernel, const void* job, int argument, unsigned blocks, unsigned threads, uint32_t seed);

enum Access { READ, WRITE, ATOMIC };
// Checks the access to an element, and notes it.
void touch(Memory& memory, size_t offset, size_t bytes, Access access);
// The array that begins at an address.
Memory& memory_at(const void* address);
// Registers an array of the kernels' shared memory, and gives it what the block that runs has in it.
void add_shared(Memory& memory);
// Writes a word that other blocks wait for, and reads one.
void publish_word(uint64_t* word, uint64_t value);
uint64_t published_word(const uint64_t* word);

enum Barrier { BLOCK, WARP };
// Waits for the others; gives all values that were brought, by thread of the block or lane of the warp.
const uint64_t* wait(Barrier barrier, const char* name, uint32_t mask, uint64_t value);
int lane();

template <class T>
uint64_t to_bits(T value) {
  uint64_t bits = 0;
  static_assert(sizeof value <= sizeof bits);
  std::memcpy(&bits, &value, sizeof value);
  return bits;
}
template <class T>
T from_bits(uint64_t bits) {
  T value;
  std::memcpy(&value, &bits, sizeof value);
  return value;
}

template <class T>
struct Pointer {
  Memory* memory;
  T* element;
};

// An element of a checked array.
template <class T>
class Element {
 public:
  using Value = std::remove_const_t<T>;
  Element(Memory& memory, T* element) : memory_(memory), element_(element) {}
  operator Value() const {
    check(READ);
    return *element_;
  }
  const Element& operator=(Value value) const {
    check(WRITE);
    *element_ = value;
    return *this;
  }
  const Element& operator=(const Element& other) const { return *this = Value(other); }
  const Element& operator+=(Value value) const { return *this = Value(*this) + value; }
  Pointer<T> operator&() const { return {&memory_, element_}; }

 private:
  void check(Access access) const { touch(memory_, reinterpret_cast<const char*>(element_) - memory_.data, sizeof(T), access); }
  Memory& memory_;
  T* element_;
};

template <class T>
class Global {
 public:
  Global() = default;
  explicit Global(T* data) : data_(data) {}
  operator Global<const T>() const { return Global<const T>(data_); }
  Element<T> operator[](long long i) const {
    Memory& memory = memory_at(data_);
    if (i < 0 || size_t(i + 1) * sizeof(T) > memory.bytes)
      fail(memory.name + ": found index " + std::to_string(i) + " of " + std::to_string(memory.bytes / sizeof(T)));
    return {memory, data_ + i};
  }

 private:
  T* data_ = nullptr;
};

template <class T, int SIZE>
class Shared {
 public:
  explicit Shared(const char* name) {
    memory_.name = name;
    memory_.bytes = SIZE * sizeof(T);
    memory_.shared = true;
    add_shared(memory_);
  }
  Element<T> operator[](long long i) {
    if (i < 0 || i >= SIZE) fail(memory_.name + ": found index " + std::to_string(i) + " of " + std::to_string(SIZE));
    return {memory_, reinterpret_cast<T*>(memory_.data) + i};
  }

 private:
  Memory memory_;
};

template <class T, class Change>
T change(Pointer<T> at, const Change& change) {
  touch(*at.memory, reinterpret_cast<char*>(at.element) - at.memory->data, sizeof(T), ATOMIC);
  const T before = *at.element;
  *at.element = change(before);
  return before;
}

template <class T>
T shuffle(const char* name, uint32_t mask, T value, int from) {
  const uint64_t* values = wait(WARP, name, mask, to_bits(value));
  if (from < 0 || from > 31) return value;
  if (!(mask >> from & 1))
    fail(std::string(name) + ": found a value asked of lane " + std::to_string(from) + ", which is not in the mask");
  return from_bits<T>(values[from]);
}

}  // namespace simt

#define threadIdx simt::thread_index
#define blockIdx simt::block_index
#define blockDim simt::block_size
#define gridDim simt::grid_size
#define SPLATREE_SHARED(type, name, size) static simt::Shared<type, (size)> name(#name)
#define SPLATREE_KERNEL(threads, thread_blocks) extern "C" void

struct float4 {
  float x, y, z, w;
};
struct int4 {
  int x, y, z, w;
};
inline float4 make_float4(float x, float y, float z, float w) { return {x, y, z, w}; }
inline int4 make_int4(int x, int y, int z, int w) { return {x, y, z, w}; }

inline void __syncthreads() { simt::wait(simt::BLOCK, "__syncthreads", 0, 0); }
inline int __syncthreads_count(int flag) {
  const uint64_t* flags = simt::wait(simt::BLOCK, "__syncthreads_count", 0, flag != 0);
  int count = 0;
  for (unsigned i = 0; i < blockDim.x; ++i) count += int(flags[i]);
  return count;
}
inline int __syncthreads_or(int flag) {
  const uint64_t* flags = simt::wait(simt::BLOCK, "__syncthreads_or", 0, flag != 0);
  for (unsigned i = 0; i < blockDim.x; ++i)
    if (flags[i]) return 1;
  return 0;
}
inline void __syncwarp(unsigned mask = 0xffffffffu) { simt::wait(simt::WARP, "__syncwarp", mask, 0); }
inline unsigned __ballot_sync(unsigned mask, int flag) {
  const uint64_t* flags = simt::wait(simt::WARP, "__ballot_sync", mask, flag != 0);
  unsigned lanes = 0;
  for (int l = 0; l < 32; ++l)
    if (mask >> l & 1 && flags[l]) lanes |= 1u << l;
  return lanes;
}
inline int __any_sync(unsigned mask, int flag) { return __ballot_sync(mask, flag) != 0; }
inline int __all_sync(unsigned mask, int flag) { return __ballot_sync(mask, flag) == mask; }
template <class T>
unsigned __match_any_sync(unsigned mask, T value) {
  const uint64_t* values = simt::wait(simt::WARP, "__match_any_sync", mask, simt::to_bits(value));
  unsigned lanes = 0;
  for (int l = 0; l < 32; ++l)
    if (mask >> l & 1 && values[l] == simt::to_bits(value)) lanes |= 1u << l;
  return lanes;
}
template <class T>
T __shfl_sync(unsigned mask, T value, int from) {
  return simt::shuffle("__shfl_sync", mask, value, from & 31);
}
template <class T>
T __shfl_up_sync(unsigned mask, T value, int step) {
  return simt::shuffle("__shfl_up_sync", mask, value, simt::lane() - step);
}
template <class T>
T __shfl_xor_sync(unsigned mask, T value, int with) {
  return simt::shuffle("__shfl_xor_sync", mask, value, simt::lane() ^ with);
}
inline int __popc(unsigned x) { return __builtin_popcount(x); }
inline int __ffs(unsigned x) { return __builtin_ffs(int(x)); }

template <class T>
T atomicAdd(simt::Pointer<T> at, T value) {
  return simt::change(at, [&](T before) { return T(before + value); });
}
template <class T>
T atomicMax(simt::Pointer<T> at, T value) {
  return simt::change(at, [&](T before) { return before < value ? value : before; });
}

inline void publish(simt::Pointer<unsigned long long> word, unsigned long long value) {
  simt::change(word, [](unsigned long long before) { return before; });
  simt::publish_word(reinterpret_cast<uint64_t*>(word.element), value);
}
inline unsigned long long read_published(simt::Pointer<unsigned long long> word) {
  simt::change(word, [](unsigned long long value) { return value; });
  return simt::published_word(reinterpret_cast<const uint64_t*>(word.element));
}

inline float4 load_four(simt::Global<const float> column, long long at) {
  if (at % 4) simt::fail("load_four: found place " + std::to_string(at) + ", wanted a multiple of four");
  return {column[at], column[at + 1], column[at + 2], column[at + 3]};
}

namespace splatree {
using simt::Global;
}
