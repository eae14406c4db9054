// Jobs of the loss against a photograph (loss.cpp) and of the optimiser's step (optimise.cpp).
#pragma once
#include <cstdint>

#include "shared/sums.h"

namespace splatree {

constexpr int LOSS_EDGE_Y = 64, LOSS_EDGE_X = 192;  // px of an area that is computed at once
constexpr int LOSS_TAPS = 11;

struct LossJob {
  const float* image;    // h w 3
  const uint8_t* photo;  // h w 3
  const uint8_t* mask;   // h w, 1 where a pixel counts; null: all do
  float gain[3];
  float taps[LOSS_TAPS];  // of the window, along one axis
  float c1, c2;           // of SSIM
  int width, height;
  float by_difference, by_index;  // (1 − λ) / n and λ / n, n numbers that count
  int threads;
  float* by_image;  // h w 3
  float* errors;    // h w
  double* sums;     // NUM_LOSS_SUMS of each area
};

struct StepJob {
  int64_t num_rows;     // v
  const int32_t* rows;  // v
  int num_columns;
  const float* derivatives[5];  // v and its width each
  float* columns[5];            // n and its width each
  int widths[5];
  float* moments;            // n 2 e
  uint16_t* steps;           // n
  int num_moments;           // e, a multiple of 8, at most 64
  const float* rates;        // e
  const float* corrections;  // 65536 2: of both moments after so many steps
  float ramp;                // 1 / steps until the full rate
  float beta_1, beta_2, epsilon;
  int threads;
};

}  // namespace splatree
