// Instruction sets: which variants were compiled, which the processor runs, which is in use.
//
// A vector source (VECTOR_SOURCES in CMakeLists.txt) is compiled once for each level, inside the namespace SPLATREE_ISA:
//
//   namespace splatree::SPLATREE_ISA { void project(const ProjectJob& job) { ... } }
//
// and listed in the table `Kernels` below; callers write `kernels().project(job)`. Such a source must not use std
// templates: their weak symbols would be shared between variants.
#pragma once
#include <cstdint>

namespace splatree {

struct ProjectJob;
struct SplatTiles;
struct Spans;
struct BinJob;
struct BlendJob;
struct SelectJob;
struct RunResult;
struct PairCandidates;
struct PairCost;
struct NearestJob;
struct ByteColumn;
struct Triples;
struct PackedJob;
enum class QuatCode : int;
struct Centres;
struct LaneMinima;
struct NearestCentres;
struct AxesJob;
struct SpheresJob;
struct CullJob;

struct Kernels {
  const char* isa;
  int64_t (*project)(const ProjectJob& job, int64_t* place);
  void (*list_spans)(const BinJob& job, int64_t begin, int64_t end, SplatTiles* tiles, Spans& spans);
  void (*blend)(const BlendJob& job);
  int32_t (*largest_bits)(const float* values, int64_t num_values);
  RunResult (*select_group)(const SelectJob& job, int64_t group, int32_t* out);
  PairCost (*cheapest_pair)(const PairCandidates& pair);
  void (*small_rows)(const SelectJob& job, const int32_t* rows, int64_t count, uint8_t* small);
  void (*visible_rows)(const SelectJob& job, const int32_t* rows, int64_t count, uint8_t* visible);
  void (*label_nearest)(const NearestJob& job, int64_t begin, int64_t end);
  void (*quantize)(const ByteColumn& column, int64_t begin, int64_t end);
  void (*dequantize)(const ByteColumn& column, int64_t begin, int64_t end);
  void (*bytes_from_logits)(const float* logits, int64_t begin, int64_t end, uint8_t* codes);
  void (*pack_fixed)(const Triples& job, int64_t begin, int64_t end);
  void (*unpack_fixed)(const Triples& job, int64_t begin, int64_t end);
  void (*pack_quats)(const Triples& job, QuatCode kind, int64_t begin, int64_t end);
  void (*unpack_quats)(const Triples& job, QuatCode kind, int64_t begin, int64_t end);
  void (*nearest_lanes)(const Centres& centres, const float* const* points, LaneMinima* minima);
  void (*nearest_centres)(const Centres& centres, const float* const* points, NearestCentres* nearest);
  void (*onto_axes)(const AxesJob& job, int64_t begin, int64_t end);
  void (*pack_chunk)(const PackedJob& job, int64_t chunk);
  void (*unpack_chunk)(const PackedJob& job, int64_t chunk);
  void (*bound_spheres)(const SpheresJob& job, int64_t begin, int64_t end);
  void (*cull_spheres)(const CullJob& job, int64_t begin, int64_t end);
};

// The table of the best level that the processor runs, or of the level set by use_isa().
const Kernels& kernels();

// Chooses a level by name (tests run them all in turn); false if the processor or the build lacks it.
bool use_isa(const char* name);

// Calls visit(name) for each level that the build has and the processor runs, best first.
void each_isa(void (*visit)(void* context, const char* name), void* context);

}  // namespace splatree
