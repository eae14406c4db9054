#include "cpu/isa.h"

#include <atomic>
#include <cstring>

namespace splatree {
namespace {

#if defined(__x86_64__)
const Kernels tables[] = {{"v4"}, {"v3"}, {"v2"}};

bool runs(const Kernels& table) {
  // The levels of the x86-64 psABI.
  switch (table.isa[1]) {
    case '4':
      return __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512bw") &&
             __builtin_cpu_supports("avx512cd") && __builtin_cpu_supports("avx512dq") &&
             __builtin_cpu_supports("avx512vl");
    case '3':
      return __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma") && __builtin_cpu_supports("bmi2");
    default:
      return __builtin_cpu_supports("sse4.2") && __builtin_cpu_supports("popcnt");
  }
}
#else
const Kernels tables[] = {{"native"}};

bool runs(const Kernels&) { return true; }
#endif

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
