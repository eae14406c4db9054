// Interleaved records into float32 columns, and the largest magnitude of a column.
//
// Both run at the speed of memory on baseline instructions: a record of 248 bytes costs 62 loads and 62 stores, about
// as long as the cache lines take to arrive; so neither is compiled for wider vectors.
#pragma once
#include <cstdint>

namespace splatree {

// How a value is stored in a record.
enum class Scalar : uint8_t { i8, u8, i16, u16, i32, u32, f32, f64 };

struct Column {
  float* data;             // num_rows × width, row by row
  int64_t width;           // values in a row
  const int64_t* offsets;  // where each value of a row lies in the record, bytes
  const Scalar* types;     // how each is stored
};

// columns[c].data[row × width + j] = the value at records + row × stride + offsets[j], for each column, row and j.
void deinterleave(const uint8_t* records, int64_t num_rows, int64_t stride, const Column* columns, int num_columns,
                  int threads);

// Largest |value|; NaN if one is NaN, 0 if there are none. The magnitude's bits order as integers do, NaN last.
float largest_magnitude(const float* values, int64_t num_values, int threads);

}  // namespace splatree
