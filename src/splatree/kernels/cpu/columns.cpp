#include "cpu/columns.h"

#include <algorithm>
#include <atomic>
#include <cstring>

#include "cpu/pool.h"

namespace splatree {
namespace {

// 1024 records of 248 bytes in and as many out are half of a 1 MB second-level cache.
constexpr int64_t kRowsPerChunk = 1024;
constexpr int64_t kValuesPerChunk = 1 << 18;  // 1 MB

template <class T>
T load(const uint8_t* at) {
  T value;
  std::memcpy(&value, at, sizeof value);
  return value;
}

float load_as_float(const uint8_t* at, Scalar type) {
  switch (type) {
    case Scalar::i8: return load<int8_t>(at);
    case Scalar::u8: return load<uint8_t>(at);
    case Scalar::i16: return load<int16_t>(at);
    case Scalar::u16: return load<uint16_t>(at);
    case Scalar::i32: return static_cast<float>(load<int32_t>(at));
    case Scalar::u32: return static_cast<float>(load<uint32_t>(at));
    case Scalar::f32: return load<float>(at);
    case Scalar::f64: return static_cast<float>(load<double>(at));
  }
  return 0;
}

}  // namespace

void deinterleave(const uint8_t* records, int64_t num_rows, int64_t stride, const Column* columns, int num_columns,
                  int threads) {
  parallel_ranges(num_rows, kRowsPerChunk, threads, [&](int64_t begin, int64_t end) {
    for (int c = 0; c < num_columns; ++c) {
      const Column& column = columns[c];
      const int64_t width = column.width;
      const bool all_f32 = std::all_of(column.types, column.types + width, [](Scalar t) { return t == Scalar::f32; });
      for (int64_t row = begin; row < end; ++row) {
        const uint8_t* record = records + row * stride;
        float* out = column.data + row * width;
        if (all_f32)
          for (int64_t j = 0; j < width; ++j) out[j] = load<float>(record + column.offsets[j]);
        else
          for (int64_t j = 0; j < width; ++j) out[j] = load_as_float(record + column.offsets[j], column.types[j]);
      }
    }
  });
}

float largest_magnitude(const float* values, int64_t num_values, int threads) {
  std::atomic<int32_t> largest{0};
  parallel_ranges(num_values, kValuesPerChunk, threads, [&](int64_t begin, int64_t end) {
    int32_t found = 0;
    for (int64_t i = begin; i < end; ++i) {
      int32_t bits;
      std::memcpy(&bits, values + i, sizeof bits);
      found = std::max(found, bits & 0x7fffffff);
    }
    int32_t seen = largest.load(std::memory_order_relaxed);
    while (found > seen && !largest.compare_exchange_weak(seen, found, std::memory_order_relaxed)) {
    }
  });
  const int32_t bits = largest.load();
  float value;
  std::memcpy(&value, &bits, sizeof value);
  return value;
}

}  // namespace splatree
