// Gaussians in chunks of 256, each value in a few bits of its chunk's range: kernels/reference/packed.py is the definition.
#pragma once
#include <cstdint>

namespace splatree {

constexpr int PACKED_CHUNK = 256;
constexpr int PACKED_BOUNDS = 18;  // min and max of x y z, of the log-scales, of r g b, three at a time

// Columns of Gaussians, and the packed form of them.
struct PackedJob {
  float *means, *quats, *log_scales, *logits, *sh;
  const int64_t* order;  // to pack: the row of each place
  int64_t num_rows;
  int num_coefficients;      // 1, 4, 9, 16
  float* bounds;             // 18 a chunk
  uint32_t* vertices;        // position, rotation, scale, color
  uint8_t* rest;             // 3 (num_coefficients - 1) a row, channel by channel
  const float* logit_table;  // to unpack: of each code
};

}  // namespace splatree
