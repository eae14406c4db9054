// Records of a .splat from columns, and back, a range of rows at a time. All arithmetic is that of single IEEE operations
// (CMakeLists.txt forbids to contract them), so the bytes of a file depend neither on the instruction set nor on a row's place.
// Exact scales take three calls of the C library's exp or log a row, more than half of the time.
#include "cpu/codec/splat.h"

#include <stdint.h>
#include <string.h>

#include "shared/constants.h"
#include "shared/elementary.h"

namespace splatree::SPLATREE_ISA {
namespace {

constexpr int ROWS = 64;  // as planes on the stack
constexpr float C0 = float(constants::SH_C0);

// 1 + e^−x; beyond ±80 nothing changes that a code or a rank could show.
SPLATREE_FN float inverse_opacity(float logit) { return 1.f + exp_of(-least(greatest(logit, -80.f), 80.f)); }

SPLATREE_FN uint32_t code(float value) { return uint32_t(int32_t(__builtin_rintf(least(greatest(value, 0.f), 255.f)))); }

SPLATREE_FN uint32_t bytes(uint32_t a, uint32_t b, uint32_t c, uint32_t d) { return a | b << 8 | c << 16 | d << 24; }

struct alignas(64) Planes {
  float r[ROWS], g[ROWS], b[ROWS], logit[ROWS], w[ROWS], x[ROWS], y[ROWS], z[ROWS];
  uint32_t rgba[ROWS], quat[ROWS];
};

void load(const SplatColumns& from, int64_t begin, int64_t count, Planes& p) {
  for (int64_t i = 0; i < count; ++i) {
    const float *dc = from.sh + (begin + i) * from.sh_stride, *quat = from.quats + 4 * (begin + i);
    p.r[i] = dc[0], p.g[i] = dc[1], p.b[i] = dc[2];
    p.w[i] = quat[0], p.x[i] = quat[1], p.y[i] = quat[2], p.z[i] = quat[3];
  }
  memcpy(p.logit, from.logit_opacities + begin, count * sizeof(float));
}

void encode_colors(Planes& p) {
#pragma omp simd
  for (int i = 0; i < ROWS; ++i)
    p.rgba[i] = bytes(code(255.f * (0.5f + C0 * p.r[i])), code(255.f * (0.5f + C0 * p.g[i])), code(255.f * (0.5f + C0 * p.b[i])),
                      code(255.f / inverse_opacity(p.logit[i])));
}

// q and −q are one rotation: −1 has a code and +1 has none, so the largest component is made negative.
void encode_quats(Planes& p) {
#pragma omp simd
  for (int i = 0; i < ROWS; ++i) {
    const float w = p.w[i], x = p.x[i], y = p.y[i], z = p.z[i];
    const double squared = ((double(w) * w + double(x) * x) + double(y) * y) + double(z) * z;
    float largest = w;
    largest = __builtin_fabsf(x) > __builtin_fabsf(largest) ? x : largest;
    largest = __builtin_fabsf(y) > __builtin_fabsf(largest) ? y : largest;
    largest = __builtin_fabsf(z) > __builtin_fabsf(largest) ? z : largest;
    const double unit = (largest < 0.f ? 128. : -128.) / __builtin_sqrt(squared);
    p.quat[i] =
        bytes(code(float(unit * w + 128)), code(float(unit * x + 128)), code(float(unit * y + 128)), code(float(unit * z + 128)));
  }
}

}  // namespace

int32_t encode_splats(const SplatColumns& from, int64_t begin, int64_t end, uint8_t* records) {
  Planes p = {};
  int32_t largest = 0;
  for (int64_t row = begin; row < end; row += ROWS) {
    const int64_t count = end - row < ROWS ? end - row : ROWS;
    load(from, row, count, p);
    encode_colors(p);
    encode_quats(p);
#pragma omp simd reduction(max : largest)
    for (int i = 0; i < ROWS; ++i) {
      const int32_t r = bits_of(__builtin_fabsf(p.r[i])), g = bits_of(__builtin_fabsf(p.g[i]));
      const int32_t b = bits_of(__builtin_fabsf(p.b[i])), rg = r > g ? r : g, rgb = rg > b ? rg : b;
      largest = rgb > largest ? rgb : largest;
    }
    for (int64_t i = 0; i < count; ++i) {
      uint8_t* out = records + (row + i) * SPLAT_BYTES;
      const float* log_scales = from.log_scales + 3 * (row + i);
      const float scales[3] = {__builtin_expf(log_scales[0]), __builtin_expf(log_scales[1]), __builtin_expf(log_scales[2])};
      memcpy(out, from.means + 3 * (row + i), 12);
      memcpy(out + 12, scales, 12);
      memcpy(out + 24, p.rgba + i, 4);
      memcpy(out + 28, p.quat + i, 4);
    }
  }
  return largest;
}

void decode_splats(const uint8_t* records, const SplatTables& tables, const SplatColumns& to, int64_t begin, int64_t end) {
  for (int64_t row = begin; row < end; ++row) {
    const uint8_t* record = records + row * SPLAT_BYTES;
    memcpy(to.means + 3 * row, record, 12);
    float scales[3];
    memcpy(scales, record + 12, 12);
    // What has no logarithm is found by the check of values.
    for (int axis = 0; axis < 3; ++axis) to.log_scales[3 * row + axis] = __builtin_logf(scales[axis]);
    for (int c = 0; c < 3; ++c) to.sh[row * to.sh_stride + c] = tables.colors[record[24 + c]];
    to.logit_opacities[row] = tables.logits[record[27]];
    for (int i = 0; i < 4; ++i) to.quats[4 * row + i] = (record[28 + i] - 128.f) * 0.0078125f;
  }
}

void rank_splats(const SplatColumns& from, int64_t begin, int64_t end, uint16_t* ranks) {
  constexpr float LOG2_E = 1.44269504f;
  const float* s = from.log_scales;
#pragma omp simd
  for (int64_t row = begin; row < end; ++row) {
    const float volume = LOG2_E * ((s[3 * row] + s[3 * row + 1]) + s[3 * row + 2]);
    const float quarters = 4.f * (volume - log2_of(inverse_opacity(from.logit_opacities[row])));
    ranks[row] = uint16_t(int32_t(least(greatest(2048.f - quarters, 0.f), 4095.f)));
  }
}

}  // namespace splatree::SPLATREE_ISA
