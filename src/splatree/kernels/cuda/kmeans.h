// What the kernels of a step of K-means get; kernels/cuda/job.py reads names and types from the lines below.
#pragma once
#include "cuda/device.h"

namespace splatree {

struct KmeansJob {
  Global<const float> points;         // n 3
  Global<const float> centers;        // c 3
  Global<float> boxes;                // 6 a leaf of 32 centres: lower and upper corner
  Global<int> labels;                 // n
  Global<float> squared_distances;    // n
  Global<unsigned long long> sums;    // c 3, in units of 2^-sum_bits
  Global<unsigned long long> counts;  // c
  Global<double> inertia;             // of each warp's points
  long long num_points;
  long long num_centers;
  long long sum_bits;
};

}  // namespace splatree
