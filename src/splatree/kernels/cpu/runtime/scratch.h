// Large arrays without initial values, on huge pages where the system has them: touching fresh memory in pages of 4 KB costs
// more than most loops over it.
#pragma once
#include <cstdint>
#include <cstdlib>
#include <memory>
#include <new>

#ifdef __linux__
#include <sys/mman.h>
#endif
#ifdef _WIN32
#include <malloc.h>
#endif

namespace splatree {

struct Free {
#ifdef _WIN32
  void operator()(void* p) const { _aligned_free(p); }
#else
  void operator()(void* p) const { std::free(p); }
#endif
};

template <class T>
using Scratch = std::unique_ptr<T[], Free>;

template <class T>
Scratch<T> allocate(int64_t count) {
  constexpr size_t huge = size_t(2) << 20;
  const size_t bytes = size_t(count) * sizeof(T);
  const size_t alignment = bytes >= 2 * huge ? huge : 64;
  const size_t rounded = (bytes / alignment + 1) * alignment;
#ifdef _WIN32
  void* p = _aligned_malloc(rounded, alignment);
#else
  void* p = std::aligned_alloc(alignment, rounded);
#endif
  if (!p) throw std::bad_alloc();
#ifdef MADV_HUGEPAGE
  if (alignment == huge) madvise(p, rounded, MADV_HUGEPAGE);
#endif
  return Scratch<T>(static_cast<T*>(p));
}

}  // namespace splatree
