// What a step of the optimiser gets; kernels/cuda/job.py reads names and types from the lines below.
#pragma once
#include "cuda/device.h"

namespace splatree {

struct StepJob {
  Global<const int> rows;                  // v, each once
  Global<const float> by_means;            // v 3
  Global<const float> by_quats;            // v 4
  Global<const float> by_log_scales;       // v 3
  Global<const float> by_logit_opacities;  // v
  Global<const float> by_sh;               // v k 3
  Global<float> means;                     // n 3
  Global<float> quats;                     // n 4
  Global<float> log_scales;                // n 3
  Global<float> logit_opacities;           // n
  Global<float> sh;                        // n k 3
  Global<float> moments;                   // n 2 e
  Global<unsigned> steps;                  // n
  Global<const float> rates;               // e
  Global<const float> corrections;         // 2 a number of steps: of both moments
  Global<const float> numbers;             // in the order of StepNumber
  long long num_rows;                      // v
  long long num_coefficients;              // k
  long long num_moments;                   // e
};

enum StepNumber { RAMP, BETA_1, BETA_2, EPSILON };  // RAMP: 1 / steps until the full rate

}  // namespace splatree
