// Records of 32 bytes of a .splat from columns, and back: kernels/reference/splat.py is the definition.
#pragma once
#include <cstdint>

namespace splatree {

constexpr int64_t SPLAT_BYTES = 32;
constexpr int SPLAT_RANKS = 4096;

// Columns of Gaussians; harmonics have `sh_stride` floats a row, of which the first three are the DC.
struct SplatColumns {
  float *means, *quats, *log_scales, *logit_opacities, *sh;
  int64_t sh_stride;
};

// What a byte of a record stands for.
struct SplatTables {
  float logits[256], colors[256];
};
SplatTables splat_tables();

// Puts records that are listed with their ranks into a file in which `places` tells where the next record of each rank goes, and
// moves these on. Records of one rank keep their order and are written at once.
void place_splats(const uint8_t* records, const uint16_t* ranks, int64_t num_rows, int64_t* places, int file);

}  // namespace splatree
