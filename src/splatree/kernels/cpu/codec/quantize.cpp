// Columns of floats as bytes and back, a range of rows at a time. What has a rounding step that depends on more than one
// operation runs in full blocks of 16 lanes, the last one filled up, so that a row's code never depends on its place.
#include "cpu/codec/quantize.h"

#include <stdint.h>
#include <string.h>

#include "cpu/runtime/quad.h"
#include "shared/quantize.h"

namespace splatree::SPLATREE_ISA {
namespace {

constexpr int LANES = 16;

template <int WIDTH>
void quantize_rows(const ByteColumn& column, int64_t begin, int64_t end) {
  int32_t half[WIDTH];
  for (int j = 0; j < WIDTH; ++j) half[j] = column.step[j] / 2;
  for (int64_t row = begin; row < end; ++row) {
    const float* values = column.values + row * column.stride;
    uint8_t codes[WIDTH];
#pragma omp simd
    for (int j = 0; j < WIDTH; ++j) {
      const float code = __builtin_rintf(clamp(values[j] * column.scale[j] + column.offset[j], -256.f, 512.f));
      const int32_t stepped = (int32_t(code) + half[j]) & -column.step[j];
      codes[j] = uint8_t(stepped < 0 ? 0 : stepped > 255 ? 255 : stepped);
    }
    memcpy(column.codes + row * WIDTH, codes, WIDTH);
  }
}

template <int WIDTH>
void dequantize_rows(const ByteColumn& column, int64_t begin, int64_t end) {
  for (int64_t row = begin; row < end; ++row) {
    float* values = column.values + row * column.stride;
    const uint8_t* codes = column.codes + row * WIDTH;
#pragma omp simd
    for (int j = 0; j < WIDTH; ++j) values[j] = float(codes[j]) * column.scale[j] + column.offset[j];
  }
}

// Sixteen quaternions as planes w, x, y, z, their signs changed.
struct alignas(64) Quats {
  float w[LANES], x[LANES], y[LANES], z[LANES];
};

void load_quats(const float* rows, const float* signs, Quats& q) {
  for (int i = 0; i < LANES; i += 4) {
    Quad a = load_quad(rows + 4 * i), b = load_quad(rows + 4 * i + 4);
    Quad c = load_quad(rows + 4 * i + 8), d = load_quad(rows + 4 * i + 12);
    transpose(a, b, c, d);
    store_quad(q.w + i, a * signs[0]), store_quad(q.x + i, b * signs[1]);
    store_quad(q.y + i, c * signs[2]), store_quad(q.z + i, d * signs[3]);
  }
}

void store_quats(const Quats& q, float* rows) {
  for (int i = 0; i < LANES; i += 4) {
    Quad a = load_quad(q.w + i), b = load_quad(q.x + i), c = load_quad(q.y + i), d = load_quad(q.z + i);
    transpose(a, b, c, d);
    store_quad(rows + 4 * i, a), store_quad(rows + 4 * i + 4, b);
    store_quad(rows + 4 * i + 8, c), store_quad(rows + 4 * i + 12, d);
  }
}

// Nine bits of a component of at most √½, and its sign above them.
SPLATREE_FN uint32_t ten_bits(float component) {
  const float magnitude = magnitude_of(component) * (511.f * 1.41421356f) + 0.5f;
  return uint32_t(int32_t(least(magnitude, 511.f))) | (component < 0.f ? 512u : 0u);
}

SPLATREE_FN float from_ten_bits(uint32_t code) {
  const float magnitude = float(int32_t(code & 511u)) * (0.707106781f / 511.f);
  return code & 512u ? -magnitude : magnitude;
}

// The places of SPZ are x, y, z, w.
void pack_smallest(const Quats& q, uint32_t* codes) {
#pragma omp simd
  for (int i = 0; i < LANES; ++i) {
    const SmallestThree three = smallest_three(q.x[i], q.y[i], q.z[i], q.w[i]);
    codes[i] = uint32_t(three.largest) << 30 | ten_bits(three.first) << 20 | ten_bits(three.second) << 10 | ten_bits(three.third);
  }
}

void unpack_smallest(const uint32_t* codes, Quats& q) {
#pragma omp simd
  for (int i = 0; i < LANES; ++i) {
    const uint32_t code = codes[i];
    const Four four =
        from_smallest_three(int(code >> 30), from_ten_bits(code >> 20), from_ten_bits(code >> 10), from_ten_bits(code));
    q.x[i] = four.a, q.y[i] = four.b, q.z[i] = four.c, q.w[i] = four.d;
  }
}

void pack_first(const Quats& q, uint32_t* codes) {
#pragma omp simd
  for (int i = 0; i < LANES; ++i) {
    const float w = q.w[i], x = q.x[i], y = q.y[i], z = q.z[i];
    const float most = greatest(greatest(magnitude_of(w), magnitude_of(x)), greatest(magnitude_of(y), magnitude_of(z)));
    const float scale = power_of_two_over(most);
    const float a = w * scale, b = x * scale, c = y * scale, d = z * scale;
    const float unit = (a < 0.f ? -127.5f : 127.5f) / __builtin_sqrtf((a * a + b * b) + (c * c + d * d));
    const float u = clamp(__builtin_rintf(b * unit + 127.5f), 0.f, 255.f);
    const float v = clamp(__builtin_rintf(c * unit + 127.5f), 0.f, 255.f);
    const float t = clamp(__builtin_rintf(d * unit + 127.5f), 0.f, 255.f);
    codes[i] = uint32_t(int32_t(u)) | uint32_t(int32_t(v)) << 8 | uint32_t(int32_t(t)) << 16;
  }
}

void unpack_first(const uint32_t* codes, Quats& q) {
#pragma omp simd
  for (int i = 0; i < LANES; ++i) {
    const float x = float(int32_t(codes[i] & 255u)) / 127.5f - 1.f;
    const float y = float(int32_t(codes[i] >> 8 & 255u)) / 127.5f - 1.f;
    const float z = float(int32_t(codes[i] >> 16 & 255u)) / 127.5f - 1.f;
    q.x[i] = x, q.y[i] = y, q.z[i] = z;
    q.w[i] = __builtin_sqrtf(greatest(1.f - (x * x + y * y + z * z), 0.f));
  }
}

int64_t smaller(int64_t a, int64_t b) { return a < b ? a : b; }

}  // namespace

void quantize(const ByteColumn& column, int64_t begin, int64_t end) {
  switch (column.width) {
    case 3:
      return quantize_rows<3>(column, begin, end);
    case 9:
      return quantize_rows<9>(column, begin, end);
    case 24:
      return quantize_rows<24>(column, begin, end);
    case 45:
      return quantize_rows<45>(column, begin, end);
  }
}

void dequantize(const ByteColumn& column, int64_t begin, int64_t end) {
  switch (column.width) {
    case 3:
      return dequantize_rows<3>(column, begin, end);
    case 9:
      return dequantize_rows<9>(column, begin, end);
    case 24:
      return dequantize_rows<24>(column, begin, end);
    case 45:
      return dequantize_rows<45>(column, begin, end);
  }
}

void bytes_from_logits(const float* logits, int64_t begin, int64_t end, uint8_t* codes) {
  for (int64_t row = begin; row < end; row += LANES) {
    const int64_t used = smaller(LANES, end - row);
    float block[LANES] = {};
    uint8_t out[LANES];
    memcpy(block, logits + row, used * sizeof(float));
#pragma omp simd
    for (int i = 0; i < LANES; ++i) out[i] = uint8_t(int32_t(__builtin_rintf(sigmoid_of(block[i]) * 255.f)));
    memcpy(codes + row, out, used);
  }
}

void pack_fixed(const Triples& job, int64_t begin, int64_t end) {
  for (int64_t row = begin; row < end; ++row)
    for (int j = 0; j < 3; ++j) {
      const double value = double(job.values[3 * row + j]) * job.signs[j] * job.scale;
      const int32_t fixed = int32_t(value + (value < 0 ? -0.5 : 0.5));
      uint8_t* code = job.codes + 9 * row + 3 * j;
      code[0] = uint8_t(fixed), code[1] = uint8_t(fixed >> 8), code[2] = uint8_t(fixed >> 16);
    }
}

void unpack_fixed(const Triples& job, int64_t begin, int64_t end) {
  for (int64_t row = begin; row < end; ++row)
    for (int j = 0; j < 3; ++j) {
      const uint8_t* code = job.codes + 9 * row + 3 * j;
      const int32_t fixed = int32_t(uint32_t(code[0]) << 8 | uint32_t(code[1]) << 16 | uint32_t(code[2]) << 24) >> 8;
      job.values[3 * row + j] = float(fixed) * job.scale;
    }
}

void pack_quats(const Triples& job, QuatCode kind, int64_t begin, int64_t end) {
  const int bytes = kind == QuatCode::smallest_three ? 4 : 3;
  for (int64_t row = begin; row < end; row += LANES) {
    const int64_t used = smaller(LANES, end - row);
    float rows[4 * LANES];
    uint32_t codes[LANES];
    Quats q;
    for (int i = 0; i < 4 * LANES; ++i) rows[i] = 1.f;
    memcpy(rows, job.values + 4 * row, used * 4 * sizeof(float));
    load_quats(rows, job.signs, q);
    kind == QuatCode::smallest_three ? pack_smallest(q, codes) : pack_first(q, codes);
    for (int i = 0; i < used; ++i) memcpy(job.codes + (row + i) * bytes, codes + i, bytes);
  }
}

void unpack_quats(const Triples& job, QuatCode kind, int64_t begin, int64_t end) {
  const int bytes = kind == QuatCode::smallest_three ? 4 : 3;
  for (int64_t row = begin; row < end; row += LANES) {
    const int64_t used = smaller(LANES, end - row);
    float rows[4 * LANES];
    uint32_t codes[LANES] = {};
    Quats q;
    for (int i = 0; i < used; ++i) memcpy(codes + i, job.codes + (row + i) * bytes, bytes);
    kind == QuatCode::smallest_three ? unpack_smallest(codes, q) : unpack_first(codes, q);
    store_quats(q, rows);
    memcpy(job.values + 4 * row, rows, used * 4 * sizeof(float));
  }
}

}  // namespace splatree::SPLATREE_ISA
