// Jobs of a K-means step: the tree over the centres and the sums (kmeans.cpp), the nearest centres (nearest.cpp).
#pragma once
#include <cstdint>

namespace splatree {

constexpr int LEAF_CENTERS = 8;

// A leaf of the tree: centres as planes, the rest of the last leaf infinitely far away.
struct CenterLeaf {
  float x[LEAF_CENTERS], y[LEAF_CENTERS], z[LEAF_CENTERS];
  int32_t label[LEAF_CENTERS];
};

struct CenterBox {
  float lower[3], upper[3];
};

// A complete binary tree: node i has the children 2 i + 1 and 2 i + 2; the last num_leaves nodes are the leaves, in order.
struct CenterTree {
  const CenterBox* boxes;
  const CenterLeaf* leaves;
  int32_t num_leaves;  // a power of two
};

struct NearestJob {
  CenterTree tree;
  const float* points;       // n 3
  int32_t* labels;           // n
  float* squared_distances;  // n
};

struct KmeansJob {
  const float* points;  // n 3, neighbours in the list near in space
  int64_t num_points;
  const float* centers;  // c 3
  int32_t num_centers;
  int threads;
  int32_t* labels;           // n
  float* squared_distances;  // n
  double* sums;              // c 3: of the points of each centre
  int64_t* counts;           // c
};

void kmeans_step(const KmeansJob& job);

}  // namespace splatree
