// Jobs of a K-means step: the sums (kmeans.cpp), the nearest centres (nearest.cpp).
#pragma once
#include <cstdint>

namespace splatree {

struct BoxTree;

struct NearestJob {
  const BoxTree* centers;
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
