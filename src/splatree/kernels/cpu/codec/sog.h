// The pixels of SOG; kernels/reference/sog.py says what they are.
#pragma once
#include <cstdint>

namespace splatree {

struct SogEncodeJob {
  int64_t num_rows, sh_stride;  // floats of harmonics in a row
  const float *means, *quats, *log_scales, *logit_opacities, *sh;
  const int32_t* places;                  // pixel of each row
  const int32_t* labels;                  // entry of the palette, or null
  const double* mean_ranges;              // low x y z, high x y z, of sign(x) ln(1 + |x|)
  const float *scale_bounds, *dc_bounds;  // 255 ascending
  uint8_t *means_l, *means_u, *scales;    // n × 3
  uint8_t *quats_pixels, *sh0;            // n × 4
  uint8_t* labels_pixels;                 // n × 3, or null
};

void encode_sog(const SogEncodeJob& job, int threads);

struct SogDecodeJob {
  int64_t num_rows, sh_stride;
  const uint8_t *means_l, *means_u, *scales, *labels;  // n × 3
  const uint8_t *quats_pixels, *sh0;                   // n × 4
  const float* mean_tables;                            // 3 × 65536
  const float *scale_tables, *dc_tables;               // 3 × 256
  const float *logit_table, *rest_table;               // 256
  const uint8_t* palette;                              // codes of sh_stride - 3 harmonics an entry
  int64_t palette_size;
  float *means, *quats, *log_scales, *logit_opacities, *sh;
};

// The first row whose code stands for nothing, or -1.
struct SogDamage {
  int64_t tag, label;
};

SogDamage decode_sog(const SogDecodeJob& job, int threads);

// out[i] = the number of the 255 ascending bounds below values[i].
void find_codes(const float* values, int64_t count, const float* bounds, uint8_t* out, int threads);

}  // namespace splatree
