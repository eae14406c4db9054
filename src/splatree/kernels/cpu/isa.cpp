#include "cpu/isa.h"

#include <atomic>
#include <cstring>

// The functions of one variant, and their table.
#define SPLATREE_DECLARE(isa)                                             \
  namespace splatree::isa {                                               \
  int64_t project(const ProjectJob&, int64_t*);                           \
  void list_spans(const BinJob&, int64_t, int64_t, SplatTiles*, Spans&);  \
  void blend(const BlendJob&);                                            \
  int32_t largest_bits(const float*, int64_t);                            \
  RunResult select_group(const SelectJob&, int64_t, int32_t*);            \
  PairCost cheapest_pair(const PairCandidates&);                          \
  void small_rows(const SelectJob&, const int32_t*, int64_t, uint8_t*);   \
  void visible_rows(const SelectJob&, const int32_t*, int64_t, uint8_t*); \
  void label_nearest(const NearestJob&, int64_t, int64_t);                \
  void quantize(const ByteColumn&, int64_t, int64_t);                     \
  void dequantize(const ByteColumn&, int64_t, int64_t);                   \
  void bytes_from_logits(const float*, int64_t, int64_t, uint8_t*);       \
  void pack_fixed(const Triples&, int64_t, int64_t);                      \
  void unpack_fixed(const Triples&, int64_t, int64_t);                    \
  void pack_quats(const Triples&, QuatCode, int64_t, int64_t);            \
  void unpack_quats(const Triples&, QuatCode, int64_t, int64_t);          \
  void nearest_lanes(const Centres&, const float* const*, LaneMinima*);   \
  void nearest_centres(const Centres&, const float* const*, NearestCentres*); \
  void onto_axes(const AxesJob&, int64_t, int64_t);                       \
  void pack_chunk(const PackedJob&, int64_t);                             \
  void unpack_chunk(const PackedJob&, int64_t);                           \
  void bound_spheres(const SpheresJob&, int64_t, int64_t);                \
  void cull_spheres(const CullJob&, int64_t, int64_t);                    \
  }
#define SPLATREE_TABLE(name, isa)                                                                                  \
  {name, isa::project, isa::list_spans, isa::blend, isa::largest_bits, isa::select_group, isa::cheapest_pair, isa::small_rows, isa::visible_rows, \
   isa::label_nearest, isa::quantize, isa::dequantize, isa::bytes_from_logits, isa::pack_fixed, isa::unpack_fixed, \
   isa::pack_quats, isa::unpack_quats, isa::nearest_lanes, isa::nearest_centres, isa::onto_axes, isa::pack_chunk, isa::unpack_chunk,\
   isa::bound_spheres, isa::cull_spheres}

#if defined(__x86_64__)
SPLATREE_DECLARE(isa_v4)
SPLATREE_DECLARE(isa_v3)
SPLATREE_DECLARE(isa_v2)
#else
SPLATREE_DECLARE(isa_native)
#endif

namespace splatree {
namespace {

#if defined(__x86_64__)
const Kernels tables[] = {SPLATREE_TABLE("v4", isa_v4), SPLATREE_TABLE("v3", isa_v3), SPLATREE_TABLE("v2", isa_v2)};

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
const Kernels tables[] = {SPLATREE_TABLE("native", isa_native)};

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
