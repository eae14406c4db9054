// Nodes in 32 bytes; kernels/reference/nodes.py is the definition.
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

struct NodeTree {
  const int32_t* subtree_end;  // n
  const uint8_t* depth;        // n
  const float* curves;         // n 4; null: merged rows as they are stored
};

// out[8 i] to out[8 i + 7] from rows[i], of a tree with curves as it is drawn at dilations[i].
void pack_nodes(const NodeColumns& columns, const NodeTree& tree, const int32_t* rows, const float* dilations, int64_t num_rows,
                const double* eye, const double* centre, uint32_t* out, int threads);

// out[2 i] and out[2 i + 1] from rows[i]: opacity and scales of its node, in halves.
void pack_shapes(const NodeColumns& columns, const NodeTree& tree, const int32_t* rows, const float* dilations, int64_t num_rows,
                 uint32_t* out, int threads);

// out[i] from rows[i].
void pack_colors(const NodeColumns& columns, const int32_t* rows, int64_t num_rows, const double* eye, uint32_t* out,
                 int threads);

}  // namespace splatree
