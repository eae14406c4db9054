// Interleaved records into float32 columns and back, and the extremes of a column.
//
// Copying runs at the speed of memory on baseline instructions: the harmonics of a record of 248 bytes are turned in registers,
// four coefficients at a time, about as fast as its cache lines arrive. Only the magnitudes gain from wider vectors
// (magnitude.cpp).
#pragma once
#include <cstdint>

namespace splatree {

// How a value is stored in a record.
enum class Scalar : uint8_t { i8, u8, i16, u16, i32, u32, f32, f64 };

struct Column {
  float* data;              // num_rows × width, row by row
  int64_t width;            // values in a row
  const int64_t* offsets;   // where each value of a row lies in the record, bytes
  const Scalar* types;      // how each is stored
  float largest_magnitude;  // result: as that of largest_magnitude()
};

constexpr int MAX_COLUMNS = 64;

// columns[c].data[row × width + j] = the value at byte start + row × stride + offsets[j] of an open file, for each column, row
// and j; and the largest magnitude of each column, found while its values are in the cache.
//
// Each chunk is read into a buffer that stays in the second-level cache. That costs three quarters of the time of mapping the
// file, whose pages would be walked and their table built and torn down; and a file that is cut short meanwhile throws, where
// a mapped one ends the process.
void deinterleave(int file, int64_t start, int64_t num_rows, int64_t stride, Column* columns, int num_columns, int threads);

// The reverse, in memory: the value at byte row × stride + offsets[j] of `records` = columns[c].data[row × width + j], all of
// type f32. What lies between keeps its bytes. The caller writes a few chunks' worth at a time, so that all of it is in the
// cache.
void interleave(const Column* columns, int num_columns, int64_t num_rows, int64_t stride, uint8_t* records, int threads);

// Largest |value|; NaN if one is NaN, 0 if there are none. The magnitude's bits order as integers do, NaN last.
float largest_magnitude(const float* values, int64_t num_values, int threads);

// Length of the shortest of `num_vectors` vectors of four; infinity if there are none. One with a NaN is passed over; below
// 1e-19 the squares underflow and the length counts as 0.
float shortest(const float* vectors, int64_t num_vectors, int threads);

}  // namespace splatree
