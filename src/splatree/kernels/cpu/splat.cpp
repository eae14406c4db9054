// Records of a .splat from columns, and back. Compiled for the baseline alone, so that the bytes of a file do not depend on the
// processor that wrote it; exact scales take three calls of the C library's exp or log, 15 ns a row.
#include "cpu/splat.h"

#include <cmath>
#include <cstring>

#include "cpu/pool.h"
#include "shared/elementary.h"

namespace splatree {
namespace {

constexpr int64_t kRecordBytes = 32, kRowsPerChunk = 4096;
constexpr float kC0 = 0.28209479177387814f;
constexpr float kOpacityMin = 1e-6f;  // codes 0 and 255 have no logit and are read as this far from 0 and 1

// 1 + e^−x; beyond ±80 nothing changes that a code or a rank could show.
float inverse_opacity(float logit) { return 1.f + exp_of(-least(greatest(logit, -80.f), 80.f)); }

uint8_t code(float value, float largest) {
  const float held = value < 0.f ? 0.f : value > largest ? largest : value;
  return static_cast<uint8_t>(std::lrint(held));
}

// q and −q are one rotation: −1 has a code and +1 has none, so the largest component is made negative.
void encode_quat(const float* quat, uint8_t* out) {
  int largest = 0;
  double squared = 0;
  for (int i = 0; i < 4; ++i) {
    squared += double(quat[i]) * quat[i];
    if (std::fabs(quat[i]) > std::fabs(quat[largest])) largest = i;
  }
  const double unit = std::copysign(128 / std::sqrt(squared), -double(quat[largest]));
  for (int i = 0; i < 4; ++i) out[i] = code(static_cast<float>(unit * quat[i] + 128), 255.f);
}

}  // namespace

void encode_splats(const SplatColumns& from, const SplatRecords& to, int threads) {
  parallel_ranges(to.num_rows, kRowsPerChunk, threads, [&](int64_t begin, int64_t end) {
    for (int64_t row = begin; row < end; ++row) {
      uint8_t* out = to.bytes + row * kRecordBytes;
      std::memcpy(out, from.means + 3 * row, 12);
      for (int axis = 0; axis < 3; ++axis) {
        const float scale = std::exp(from.log_scales[3 * row + axis]);
        std::memcpy(out + 12 + 4 * axis, &scale, 4);
      }
      for (int c = 0; c < 3; ++c) out[24 + c] = code(255.f * (0.5f + kC0 * from.sh[row * from.sh_stride + c]), 255.f);
      out[27] = code(255.f / inverse_opacity(from.logit_opacities[row]), 255.f);
      encode_quat(from.quats + 4 * row, out + 28);
    }
  });
}

void decode_splats(const SplatRecords& from, const SplatColumns& to, int threads) {
  float logits[256], colors[256];
  for (int i = 0; i < 256; ++i) {
    const double share = std::fmin(std::fmax(i / 255., double(kOpacityMin)), 1 - double(kOpacityMin));
    logits[i] = static_cast<float>(std::log(share / (1 - share)));
    colors[i] = static_cast<float>((i / 255. - 0.5) / double(kC0));
  }
  parallel_ranges(from.num_rows, kRowsPerChunk, threads, [&](int64_t begin, int64_t end) {
    for (int64_t row = begin; row < end; ++row) {
      const uint8_t* record = from.bytes + row * kRecordBytes;
      std::memcpy(to.means + 3 * row, record, 12);
      for (int axis = 0; axis < 3; ++axis) {
        float scale;
        std::memcpy(&scale, record + 12 + 4 * axis, 4);
        to.log_scales[3 * row + axis] = std::log(scale);  // what has no logarithm is found by the check of values
      }
      for (int c = 0; c < 3; ++c) to.sh[row * to.sh_stride + c] = colors[record[24 + c]];
      to.logit_opacities[row] = logits[record[27]];
      for (int i = 0; i < 4; ++i) to.quats[4 * row + i] = (record[28 + i] - 128.f) * 0.0078125f;
    }
  });
}

void rank_splats(const SplatColumns& from, int64_t num_rows, uint16_t* ranks, int threads) {
  constexpr float kLog2E = 1.44269504f;
  parallel_ranges(num_rows, kRowsPerChunk, threads, [&](int64_t begin, int64_t end) {
    const float* s = from.log_scales;
#pragma omp simd
    for (int64_t row = begin; row < end; ++row) {
      const float volume = kLog2E * ((s[3 * row] + s[3 * row + 1]) + s[3 * row + 2]);
      const float quarters = 4.f * (volume - log2_of(inverse_opacity(from.logit_opacities[row])));
      ranks[row] = static_cast<uint16_t>(static_cast<int32_t>(least(greatest(2048.f - quarters, 0.f), 4095.f)));
    }
  });
}

}  // namespace splatree
