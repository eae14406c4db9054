// Instruction sets: which variants were compiled, which the processor runs, which is in use.
//
// A vector source (VECTOR_SOURCES in CMakeLists.txt) is compiled once for each level, inside the namespace SPLATREE_ISA:
//
//   namespace splatree::SPLATREE_ISA { void project(const ProjectJob& job) { ... } }
//
// and listed in SPLATREE_KERNELS below; callers write `kernels().project(job)`. Such a source must not use std
// templates: their weak symbols would be shared between variants.
#pragma once
#include <cstdint>

namespace splatree {

struct ProjectJob;
class InOrder;
struct SplatTiles;
struct Spans;
struct BinJob;
struct BlendJob;
struct BlendBackwardJob;
struct PairSums;
struct ProjectBackwardJob;
struct LossJob;
struct StepJob;
struct SelectJob;
struct CutRows;
struct RunResult;
struct BoxTree;
struct LeafNeighbors;
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
struct CullBoxesJob;
struct CullJob;
struct SightJob;
struct SplatColumns;
struct SplatTables;

// Every vector kernel: what it returns, its name, its arguments.
// clang-format off
#define SPLATREE_KERNELS(kernel)                                                                               \
  kernel(int64_t, project_buffer_bytes, ())                                                                    \
  kernel(void, project, (const ProjectJob& job, InOrder& results))                                             \
  kernel(void, list_spans, (const BinJob& job, int64_t begin, int64_t end, SplatTiles* tiles, Spans& spans))   \
  kernel(void, blend, (const BlendJob& job))                                                                   \
  kernel(void, blend_backward, (const BlendBackwardJob& job, const PairSums& pairs))                           \
  kernel(void, project_backward, (const ProjectBackwardJob& job))                                              \
  kernel(void, photo_loss, (const LossJob& job))                                                               \
  kernel(void, step_rows, (const StepJob& job))                                                                \
  kernel(int32_t, largest_bits, (const float* values, int64_t num_values))                                     \
  kernel(RunResult, select_group, (const SelectJob& job, int64_t group, const CutRows& out))                   \
  kernel(void, nearest_of_leaf, (const BoxTree& tree, int64_t leaf, LeafNeighbors& found))                     \
  kernel(PairCost, cheapest_pair, (const PairCandidates& pair))                                                \
  kernel(void, costs_of_pairs, (const PairCandidates& pair, float* costs))                                     \
  kernel(void, small_rows, (const SelectJob& job, const int32_t* rows, int64_t count, uint8_t* small))         \
  kernel(void, visible_rows, (const SelectJob& job, const int32_t* rows, int64_t count, uint8_t* visible))     \
  kernel(void, label_nearest, (const NearestJob& job, int64_t begin, int64_t end))                             \
  kernel(void, quantize, (const ByteColumn& column, int64_t begin, int64_t end))                               \
  kernel(void, dequantize, (const ByteColumn& column, int64_t begin, int64_t end))                             \
  kernel(void, bytes_from_logits, (const float* logits, int64_t begin, int64_t end, uint8_t* codes))           \
  kernel(void, pack_fixed, (const Triples& job, int64_t begin, int64_t end))                                   \
  kernel(void, unpack_fixed, (const Triples& job, int64_t begin, int64_t end))                                 \
  kernel(void, pack_quats, (const Triples& job, QuatCode kind, int64_t begin, int64_t end))                    \
  kernel(void, unpack_quats, (const Triples& job, QuatCode kind, int64_t begin, int64_t end))                  \
  kernel(void, nearest_lanes, (const Centres& centres, const float* const* points, LaneMinima* minima))        \
  kernel(void, nearest_centres, (const Centres& centres, const float* const* points, NearestCentres* nearest)) \
  kernel(void, onto_axes, (const AxesJob& job, int64_t begin, int64_t end))                                    \
  kernel(void, pack_chunk, (const PackedJob& job, int64_t chunk))                                              \
  kernel(void, unpack_chunk, (const PackedJob& job, int64_t chunk))                                            \
  kernel(void, bound_spheres, (const SpheresJob& job, int64_t begin, int64_t end))                             \
  kernel(void, cull_spheres, (const CullJob& job, int64_t begin, int64_t end))                                 \
  kernel(void, cull_boxes, (const CullBoxesJob& job, int64_t begin, int64_t end))                              \
  kernel(void, see_through, (const SightJob& job))                                                             \
  kernel(int32_t, encode_splats, (const SplatColumns& from, int64_t begin, int64_t end, uint8_t* records))     \
  kernel(void, decode_splats,                                                                                  \
         (const uint8_t* records, const SplatTables& tables, const SplatColumns& to, int64_t begin, int64_t end))\
  kernel(void, rank_splats, (const SplatColumns& from, int64_t begin, int64_t end, uint16_t* ranks))
// clang-format on

struct Kernels {
  const char* isa;
#define SPLATREE_MEMBER(result, name, arguments) result(*name) arguments;
  SPLATREE_KERNELS(SPLATREE_MEMBER)
#undef SPLATREE_MEMBER
};

// The table of the best level that the processor runs, or of the level set by use_isa().
const Kernels& kernels();

// Chooses a level by name (tests run them all in turn); false if the processor or the build lacks it.
bool use_isa(const char* name);

// Calls visit(name) for each level that the build has and the processor runs, best first.
void each_isa(void (*visit)(void* context, const char* name), void* context);

}  // namespace splatree
