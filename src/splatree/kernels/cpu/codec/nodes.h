// Nodes in 32 bytes and the slots in which a page keeps them; kernels/reference/nodes.py and slots.py are the definitions.
#pragma once
#include <cstdint>

namespace splatree {

struct NodeColumns {
  const float* means;            // n 3
  const float* quats;            // n 4
  const float* log_scales;       // n 3
  const float* logit_opacities;  // n
  const float* sh;               // n k 3
  int degree;
};

// out[8 i] to out[8 i + 7] from rows[i].
void pack_nodes(const NodeColumns& columns, const int32_t* subtree_end, const uint8_t* depth, const int32_t* rows,
                int64_t num_rows, const double* eye, const double* centre, uint32_t* out, int threads);

// out[i] from rows[i].
void pack_colors(const NodeColumns& columns, const int32_t* rows, int64_t num_rows, const double* eye, uint32_t* out,
                 int threads);

// Each returns how many it wrote.
int64_t keep_slots(const int32_t* rows, int64_t num_rows, const int32_t* slot_after, int32_t* stamps, int32_t step, int32_t* out);
int64_t release_slots(const int32_t* held, int64_t num_held, int32_t* slot_after, const int32_t* stamps, int32_t step,
                      int32_t* out);

// Writes at most `limit` rows, and one more to say that there are more.
int64_t stale_slots(const int32_t* rows, int64_t num_rows, const int32_t* slot_after, const float* means, const float* eyes,
                    const double* eye, const double* centre, double share, int64_t limit, int32_t* out);

}  // namespace splatree
