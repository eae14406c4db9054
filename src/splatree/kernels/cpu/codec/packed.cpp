// Gaussians in chunks of 256 and back. A chunk is gathered into planes that stay in the first-level cache, the last one filled up
// with its last row, and computed in full vectors.
#include "cpu/codec/packed.h"

#include <stdint.h>
#include <string.h>

#include "cpu/runtime/quad.h"
#include "shared/constants.h"
#include "shared/quantize.h"

namespace splatree::SPLATREE_ISA {
namespace {

constexpr int CHUNK = PACKED_CHUNK;
constexpr int AHEAD = 24;  // rows whose cache lines are on their way while one is read
constexpr float SH_C0 = float(constants::SH_C0);
constexpr float LOG_SCALE_MAX = 20.f;  // of the bounds of a chunk

struct alignas(64) Planes {
  float mean[3][CHUNK], log_scale[3][CHUNK], color[3][CHUNK], quat[4][CHUNK], logit[CHUNK];
  uint32_t packed[4][CHUNK];
};

SPLATREE_FN uint32_t unorm(float share, float most) { return uint32_t(int32_t(clamp(share * most + 0.5f, 0.f, most))); }

// Three numbers of 11, 10 and 11 bits of the range [low, high].
void pack_range(const float (*planes)[CHUNK], const float* low, const float* high, uint32_t* packed) {
  const float x_range = high[0] - low[0], y_range = high[1] - low[1], z_range = high[2] - low[2];
  // Where all values are equal, any share gives them back: 0.
  const float x_unit = x_range > 0.f ? x_range : 1.f, y_unit = y_range > 0.f ? y_range : 1.f;
  const float z_unit = z_range > 0.f ? z_range : 1.f;
  const float x_low = low[0], y_low = low[1], z_low = low[2];
#pragma omp simd
  for (int i = 0; i < CHUNK; ++i)
    packed[i] = unorm((planes[0][i] - x_low) / x_unit, 2047.f) << 21 | unorm((planes[1][i] - y_low) / y_unit, 1023.f) << 11 |
                unorm((planes[2][i] - z_low) / z_unit, 2047.f);
}

void pack_colors(const Planes& p, const float* low, const float* high, uint32_t* packed) {
  float unit[3];
  for (int c = 0; c < 3; ++c) unit[c] = high[c] > low[c] ? high[c] - low[c] : 1.f;
  const float r = low[0], g = low[1], b = low[2], r_unit = unit[0], g_unit = unit[1], b_unit = unit[2];
#pragma omp simd
  for (int i = 0; i < CHUNK; ++i)
    packed[i] = unorm((p.color[0][i] - r) / r_unit, 255.f) << 24 | unorm((p.color[1][i] - g) / g_unit, 255.f) << 16 |
                unorm((p.color[2][i] - b) / b_unit, 255.f) << 8 | unorm(sigmoid_of(p.logit[i]), 255.f);
}

void pack_rotations(const Planes& p, uint32_t* packed) {
#pragma omp simd
  for (int i = 0; i < CHUNK; ++i) {
    const SmallestThree three = smallest_three(p.quat[0][i], p.quat[1][i], p.quat[2][i], p.quat[3][i]);
    packed[i] = uint32_t(three.largest) << 30 | unorm(three.first * 0.707106781f + 0.5f, 1023.f) << 20 |
                unorm(three.second * 0.707106781f + 0.5f, 1023.f) << 10 | unorm(three.third * 0.707106781f + 0.5f, 1023.f);
  }
}

void bounds_of(const float* plane, float& low, float& high) {
  float least_seen = plane[0], most_seen = plane[0];
#pragma omp simd reduction(min : least_seen) reduction(max : most_seen)
  for (int i = 0; i < CHUNK; ++i) {
    least_seen = plane[i] < least_seen ? plane[i] : least_seen;
    most_seen = plane[i] > most_seen ? plane[i] : most_seen;
  }
  low = least_seen, high = most_seen;
}

// The harmonics of a row, coefficient by coefficient, as bytes channel by channel: 256 (sh / 8 + ½), rounded down.
template <int PER_CHANNEL>
void pack_rest(const float* sh, uint8_t* rest) {
  uint8_t codes[3 * PER_CHANNEL];
#pragma omp simd
  for (int j = 0; j < 3 * PER_CHANNEL; ++j) codes[j] = uint8_t(int32_t(clamp(sh[j] * 32.f + 128.f, 0.f, 255.f)));
  for (int j = 0; j < PER_CHANNEL; ++j)
    for (int c = 0; c < 3; ++c) rest[c * PER_CHANNEL + j] = codes[3 * j + c];
}

template <int PER_CHANNEL>
void unpack_rest(const uint8_t* rest, const float* table, float* sh) {
  for (int j = 0; j < PER_CHANNEL; ++j)
    for (int c = 0; c < 3; ++c) sh[3 * j + c] = table[rest[c * PER_CHANNEL + j]];
}

// 0 and 255 stand for the ends of the range, ±4, the others for the middles of theirs.
void fill_rest_table(float* table) {
  for (int code = 1; code < 255; ++code) table[code] = (float(code) + 0.5f) / 32.f - 4.f;
  table[0] = -4.f, table[255] = 4.f;
}

void unpack_range(const uint32_t* packed, const float* low, const float* high, float (*planes)[CHUNK]) {
  const float x_step = (high[0] - low[0]) / 2047.f, y_step = (high[1] - low[1]) / 1023.f;
  const float z_step = (high[2] - low[2]) / 2047.f;
  const float x_low = low[0], y_low = low[1], z_low = low[2];
#pragma omp simd
  for (int i = 0; i < CHUNK; ++i) {
    planes[0][i] = float(int32_t(packed[i] >> 21)) * x_step + x_low;
    planes[1][i] = float(int32_t(packed[i] >> 11 & 1023u)) * y_step + y_low;
    planes[2][i] = float(int32_t(packed[i] & 2047u)) * z_step + z_low;
  }
}

SPLATREE_FN float component(uint32_t code) { return (float(int32_t(code & 1023u)) / 1023.f - 0.5f) * 1.41421356f; }

void unpack_rotations(const uint32_t* packed, Planes& p) {
#pragma omp simd
  for (int i = 0; i < CHUNK; ++i) {
    const uint32_t code = packed[i];
    const Four q = from_smallest_three(int(code >> 30), component(code >> 20), component(code >> 10), component(code));
    p.quat[0][i] = q.a, p.quat[1][i] = q.b, p.quat[2][i] = q.c, p.quat[3][i] = q.d;
  }
}

void unpack_colors(const uint32_t* packed, const float* low, const float* high, Planes& p) {
  const float r_step = (high[0] - low[0]) / 255.f, g_step = (high[1] - low[1]) / 255.f, b_step = (high[2] - low[2]) / 255.f;
  const float r = low[0], g = low[1], b = low[2];
#pragma omp simd
  for (int i = 0; i < CHUNK; ++i) {
    p.color[0][i] = (float(int32_t(packed[i] >> 24)) * r_step + r - 0.5f) / SH_C0;
    p.color[1][i] = (float(int32_t(packed[i] >> 16 & 255u)) * g_step + g - 0.5f) / SH_C0;
    p.color[2][i] = (float(int32_t(packed[i] >> 8 & 255u)) * b_step + b - 0.5f) / SH_C0;
  }
}

// Asks for the cache lines of a row, which in any order but that of the scene would otherwise be waited for one by one.
SPLATREE_FN void prefetch(const PackedJob& job, int64_t row) {
  __builtin_prefetch(job.means + 3 * row);
  __builtin_prefetch(job.quats + 4 * row);
  __builtin_prefetch(job.log_scales + 3 * row);
  __builtin_prefetch(job.logits + row);
  const float* sh = job.sh + row * 3 * job.num_coefficients;
  for (int at = 0; at < 3 * job.num_coefficients; at += 16) __builtin_prefetch(sh + at);
}

int rows_of(const PackedJob& job, int64_t chunk) {
  const int64_t left = job.num_rows - chunk * CHUNK;
  return int(left < CHUNK ? left : CHUNK);
}

}  // namespace

void pack_chunk(const PackedJob& job, int64_t chunk) {
  const int used = rows_of(job, chunk), k = job.num_coefficients, num_rest = 3 * (k - 1);
  Planes p;
  for (int i = 0; i < CHUNK; ++i) {
    const int64_t place = chunk * CHUNK + (i < used ? i : used - 1);
    const int64_t row = job.order[place];
    if (place + AHEAD < job.num_rows) prefetch(job, job.order[place + AHEAD]);
    const float* sh = job.sh + row * 3 * k;
    for (int c = 0; c < 3; ++c) {
      p.mean[c][i] = job.means[3 * row + c];
      p.log_scale[c][i] = job.log_scales[3 * row + c];
      p.color[c][i] = sh[c] * SH_C0 + 0.5f;
    }
    for (int c = 0; c < 4; ++c) p.quat[c][i] = job.quats[4 * row + c];
    p.logit[i] = job.logits[row];
    if (i >= used) continue;
    uint8_t* rest = job.rest + place * num_rest;
    switch (k) {
      case 4:
        pack_rest<3>(sh + 3, rest);
        break;
      case 9:
        pack_rest<8>(sh + 3, rest);
        break;
      case 16:
        pack_rest<15>(sh + 3, rest);
        break;
    }
  }
  float low[9], high[9];
  for (int c = 0; c < 3; ++c) {
    bounds_of(p.mean[c], low[c], high[c]);
    bounds_of(p.log_scale[c], low[3 + c], high[3 + c]);
    bounds_of(p.color[c], low[6 + c], high[6 + c]);
    low[3 + c] = clamp(low[3 + c], -LOG_SCALE_MAX, LOG_SCALE_MAX);
    high[3 + c] = clamp(high[3 + c], -LOG_SCALE_MAX, LOG_SCALE_MAX);
  }
  pack_range(p.mean, low, high, p.packed[0]);
  pack_rotations(p, p.packed[1]);
  pack_range(p.log_scale, low + 3, high + 3, p.packed[2]);
  pack_colors(p, low + 6, high + 6, p.packed[3]);
  float* bounds = job.bounds + chunk * PACKED_BOUNDS;
  for (int kind = 0; kind < 3; ++kind)
    for (int c = 0; c < 3; ++c) bounds[6 * kind + c] = low[3 * kind + c], bounds[6 * kind + 3 + c] = high[3 * kind + c];
  for (int i = 0; i < used; ++i)
    for (int c = 0; c < 4; ++c) job.vertices[4 * (chunk * CHUNK + i) + c] = p.packed[c][i];
}

void unpack_chunk(const PackedJob& job, int64_t chunk) {
  const int used = rows_of(job, chunk), k = job.num_coefficients, num_rest = 3 * (k - 1);
  const float* bounds = job.bounds + chunk * PACKED_BOUNDS;
  float table[256];
  fill_rest_table(table);
  Planes p;
  for (int i = 0; i < CHUNK; ++i)
    for (int c = 0; c < 4; ++c) p.packed[c][i] = i < used ? job.vertices[4 * (chunk * CHUNK + i) + c] : 0;
  unpack_range(p.packed[0], bounds, bounds + 3, p.mean);
  unpack_rotations(p.packed[1], p);
  unpack_range(p.packed[2], bounds + 6, bounds + 9, p.log_scale);
  unpack_colors(p.packed[3], bounds + 12, bounds + 15, p);
  for (int i = 0; i < used; ++i) {
    const int64_t row = chunk * CHUNK + i;
    float* sh = job.sh + row * 3 * k;
    for (int c = 0; c < 3; ++c) {
      job.means[3 * row + c] = p.mean[c][i];
      job.log_scales[3 * row + c] = p.log_scale[c][i];
      sh[c] = p.color[c][i];
    }
    for (int c = 0; c < 4; ++c) job.quats[4 * row + c] = p.quat[c][i];
    job.logits[row] = job.logit_table[p.packed[3][i] & 255u];
    const uint8_t* rest = job.rest + row * num_rest;
    switch (k) {
      case 4:
        unpack_rest<3>(rest, table, sh + 3);
        break;
      case 9:
        unpack_rest<8>(rest, table, sh + 3);
        break;
      case 16:
        unpack_rest<15>(rest, table, sh + 3);
        break;
    }
  }
}

}  // namespace splatree::SPLATREE_ISA
