// The pixels of SOG version 2; kernels/reference/sog.py says what they are.
#pragma once
#include <cstdint>

namespace splatree {

struct SogEncodeJob {
  int64_t num_rows, sh_stride;  // floats of harmonics in a row
  const float *means, *quats, *log_scales, *logit_opacities, *sh;
  const int32_t* order;
  const double* mean_ranges;                 // low x y z, high x y z, of sign(x) ln(1 + |x|)
  const float *scale_bounds, *dc_bounds;     // 255 ascending
  uint8_t *means_l, *means_u, *scales;       // n × 3
  uint8_t *quats_pixels, *sh0;               // n × 4
};

void encode_sog(const SogEncodeJob& job, int threads);

// out[i] = the number of the 255 ascending bounds below values[i].
void find_codes(const float* values, int64_t count, const float* bounds, uint8_t* out, int threads);

}  // namespace splatree
