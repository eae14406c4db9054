// The largest magnitude of floats that lie in the cache: as integers, since the bits of a float without its sign order as it
// does, infinity and NaN above all numbers.
#include <stdint.h>
#include <string.h>

namespace splatree::SPLATREE_ISA {

// Bits of the largest magnitude; 0 if there are no values.
int32_t largest_bits(const float* values, int64_t num_values) {
  int32_t largest = 0;
#pragma omp simd reduction(max : largest)
  for (int64_t i = 0; i < num_values; ++i) {
    int32_t bits;
    memcpy(&bits, values + i, sizeof bits);
    bits &= 0x7fffffff;
    largest = bits > largest ? bits : largest;
  }
  return largest;
}

}  // namespace splatree::SPLATREE_ISA
