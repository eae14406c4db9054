// Records of 32 bytes of a .splat from columns, and back: kernels/reference/splat.py is the definition.
#pragma once
#include <cstdint>

namespace splatree {

struct SplatRecords {
  uint8_t* bytes;  // num_rows × 32
  int64_t num_rows;
};

// Columns of Gaussians; harmonics have `sh_stride` floats a row, of which the first three are the DC.
struct SplatColumns {
  float *means, *quats, *log_scales, *logit_opacities, *sh;
  int64_t sh_stride;
};

void encode_splats(const SplatColumns& from, const SplatRecords& to, int threads);
void decode_splats(const SplatRecords& from, const SplatColumns& to, int threads);

// Place of each row in the file, coarsely: 0 to 4095, the smaller the larger opacity × volume is, in quarters of an octave.
void rank_splats(const SplatColumns& from, int64_t num_rows, uint16_t* ranks, int threads);

}  // namespace splatree
