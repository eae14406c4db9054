// The slots in which a page keeps its nodes; kernels/reference/slots.py is the definition.
#pragma once
#include <cstdint>

namespace splatree {

// What a page was sent, slot by slot.
struct SentNodes {
  const float *means, *eyes;        // s 3
  const float *limits, *dilations;  // s
};

// Each returns how many places, or slots, it wrote to `out`.
int64_t keep_slots(const int32_t* rows, int64_t num_rows, const int32_t* slot_after, int32_t* stamps, int32_t step,
                   int32_t* slots, int32_t* out);
int64_t release_slots(const int32_t* rows, const int32_t* slots, int64_t num_rows, int32_t* slot_after, const int32_t* stamps,
                      int32_t step, int32_t* out);

// At most `limit` places, and one more to say that there are more.
int64_t stale_slots(const int32_t* slots, int64_t num_slots, const SentNodes& sent, const double* eye, const double* centre,
                    double share, int64_t first, int64_t limit, int32_t* out);
// Also writes the dilation that each of them has by now.
int64_t drifted_slots(const int32_t* slots, int64_t num_slots, const SentNodes& sent, const double* plane, double unit,
                      double factor, int32_t* out, float* now);

}  // namespace splatree
