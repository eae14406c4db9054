// What the kernels of the loss get; kernels/cuda/job.py reads names and types from the lines below.
#pragma once
#include "cuda/device.h"

namespace splatree {

struct LossJob {
  Global<const float> image;          // h w 3
  Global<const unsigned char> photo;  // h w 3
  Global<const unsigned char> mask;   // h w, 1 where a pixel counts
  Global<const float> numbers;        // in the order of LossNumber
  Global<float> maps;                 // 3 h w 3: derivatives of the index by the blurs of X, X² and X Y
  Global<float> by_image;             // h w 3
  Global<float> errors;               // h w
  Global<float> sums;                 // NUM_LOSS_SUMS a thread block
  long long width;
  long long height;
};

constexpr int LOSS_TAPS = 11;

// BY_...: (1 − λ) / n and λ / n, for n numbers that count.
enum LossNumber { TAP, GAIN = TAP + LOSS_TAPS, C1 = GAIN + 3, C2, BY_DIFFERENCE, BY_INDEX };

}  // namespace splatree
