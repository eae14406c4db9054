// Columns of floats as bytes and back: kernels/reference/quantize.py is the definition.
#pragma once
#include <cstdint>

namespace splatree {

constexpr int MAX_WIDTH = 48;  // values of a row of any column

// A column of float rows and one of byte rows. A row of floats may be part of a longer one (the harmonics without the DC).
struct ByteColumn {
  float* values;   // row r starts at r × stride
  uint8_t* codes;  // row r starts at r × width
  int64_t stride;
  int width;
  float scale[MAX_WIDTH], offset[MAX_WIDTH];  // of each place: to codes, code = scale × value + offset; from codes, the reverse
  int32_t step[MAX_WIDTH];                    // to codes: whole multiples of it, a power of two
};

// Three fixed-point numbers of 24 bits a row, or a quaternion in four bytes (smallest three) or three (xyz, w ≥ 0).
struct Triples {
  float* values;   // 3 or 4 a row; quaternions are wxyz
  uint8_t* codes;  // 9, 4 or 3 a row
  float signs[4];  // of each value, to codes
  float scale;     // of fixed-point numbers
};

enum class QuatCode : int { smallest_three, first_three };

}  // namespace splatree
