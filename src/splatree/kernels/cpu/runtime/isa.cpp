#include "cpu/runtime/isa.h"

#include <atomic>
#include <cstring>

// The functions of one variant, and their table.
#define SPLATREE_FUNCTION(result, name, arguments) result name arguments;
#define SPLATREE_ENTRY(result, name, arguments) , name
#define SPLATREE_DECLARE(isa)                                                                \
  namespace splatree::isa {                                                                  \
  SPLATREE_KERNELS(SPLATREE_FUNCTION)                                                        \
  static Kernels table(const char* name) { return {name SPLATREE_KERNELS(SPLATREE_ENTRY)}; } \
  }

// The levels that CMakeLists.txt compiles.
#ifdef SPLATREE_LEVEL_v4
SPLATREE_DECLARE(isa_v4)
#endif
#ifdef SPLATREE_LEVEL_v3
SPLATREE_DECLARE(isa_v3)
#endif
#ifdef SPLATREE_LEVEL_v2
SPLATREE_DECLARE(isa_v2)
#endif
#ifdef SPLATREE_LEVEL_native
SPLATREE_DECLARE(isa_native)
#endif

namespace splatree {
namespace {

// Best first.
const Kernels tables[] = {
#ifdef SPLATREE_LEVEL_v4
    isa_v4::table("v4"),
#endif
#ifdef SPLATREE_LEVEL_v3
    isa_v3::table("v3"),
#endif
#ifdef SPLATREE_LEVEL_v2
    isa_v2::table("v2"),
#endif
#ifdef SPLATREE_LEVEL_native
    isa_native::table("native"),
#endif
};

bool runs(const Kernels& table) {
#if defined(__x86_64__)
  // The levels of the x86-64 psABI.
  switch (table.isa[1]) {
    case '4':
      return __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512bw") && __builtin_cpu_supports("avx512cd") &&
             __builtin_cpu_supports("avx512dq") && __builtin_cpu_supports("avx512vl");
    case '3':
      return __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma") && __builtin_cpu_supports("bmi2");
    case '2':
      return __builtin_cpu_supports("sse4.2") && __builtin_cpu_supports("popcnt");
  }
#endif
  (void)table;
  return true;  // native: what the compiler takes for granted
}

const Kernels* best() {
  for (const Kernels& table : tables)
    if (runs(table)) return &table;
  return &tables[sizeof tables / sizeof tables[0] - 1];
}

std::atomic<const Kernels*> current{nullptr};

}  // namespace

const Kernels& kernels() {
  const Kernels* table = current.load(std::memory_order_acquire);
  if (!table) {
    table = best();
    current.store(table, std::memory_order_release);
  }
  return *table;
}

bool use_isa(const char* name) {
  for (const Kernels& table : tables)
    if (std::strcmp(table.isa, name) == 0 && runs(table)) {
      current.store(&table, std::memory_order_release);
      return true;
    }
  return false;
}

void each_isa(void (*visit)(void*, const char*), void* context) {
  for (const Kernels& table : tables)
    if (runs(table)) visit(context, table.isa);
}

}  // namespace splatree
