// Numbers of few bits: the quantisers that packed formats share, as pure functions of lanes.
#pragma once
#include "shared/elementary.h"

namespace splatree {
namespace {

SPLATREE_FN float clamp(float x, float low, float high) { return least(greatest(x, low), high); }

SPLATREE_FN float magnitude_of(float x) { return float_of(bits_of(x) & 0x7fffffff); }

// A rotation by its three components other than the largest, which is made positive: all four of length one.
struct SmallestThree {
  int largest;  // its place in the order a, b, c, d; the first of equals
  float first, second, third;
};

SPLATREE_FN SmallestThree smallest_three(float a, float b, float c, float d) {
  // Scaled by a power of two first: the squares of a very short or long quaternion stay normal.
  const float most = greatest(greatest(magnitude_of(a), magnitude_of(b)), greatest(magnitude_of(c), magnitude_of(d)));
  const float scale = power_of_two_over(most);
  a *= scale, b *= scale, c *= scale, d *= scale;
  const float x = magnitude_of(a), y = magnitude_of(b), z = magnitude_of(c), w = magnitude_of(d);
  const bool low = x >= y, high = z >= w;
  const float front = low ? x : y, back = high ? z : w;
  const bool is_front = front >= back;
  const int largest = is_front ? (low ? 0 : 1) : (high ? 2 : 3);
  const float top = is_front ? (low ? a : b) : (high ? c : d);
  const float length = __builtin_sqrtf((a * a + b * b) + (c * c + d * d));
  const float unit = (top < 0.f ? -1.f : 1.f) / length;
  return {largest, (largest == 0 ? b : a) * unit, (largest <= 1 ? c : b) * unit, (largest <= 2 ? d : c) * unit};
}

struct Four {
  float a, b, c, d;
};

SPLATREE_FN Four from_smallest_three(int largest, float first, float second, float third) {
  const float top = __builtin_sqrtf(greatest(1.f - (first * first + second * second + third * third), 0.f));
  return {largest == 0 ? top : first, largest == 1 ? top : (largest == 0 ? first : second),
          largest == 2 ? top : (largest == 3 ? third : second), largest == 3 ? top : third};
}

}  // namespace
}  // namespace splatree
