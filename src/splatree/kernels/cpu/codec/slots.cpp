// Passes over the slots of a cut. Slots lie in about the order of their rows, so memory is read nearly in order.
#include "cpu/codec/slots.h"

namespace splatree {

int64_t keep_slots(const int32_t* rows, int64_t num_rows, const int32_t* slot_after, int32_t* stamps, int32_t step,
                   int32_t* slots, int32_t* out) {
  int64_t count = 0;
  for (int64_t i = 0; i < num_rows; ++i) {
    slots[i] = slot_after[rows[i]] - 1;
    if (slots[i] >= 0)
      stamps[slots[i]] = step;
    else
      out[count++] = int32_t(i);
  }
  return count;
}

int64_t release_slots(const int32_t* rows, const int32_t* slots, int64_t num_rows, int32_t* slot_after, const int32_t* stamps,
                      int32_t step, int32_t* out) {
  int64_t count = 0;
  for (int64_t i = 0; i < num_rows; ++i) {
    if (stamps[slots[i]] == step) continue;
    slot_after[rows[i]] = 0;
    out[count++] = slots[i];
  }
  return count;
}

int64_t stale_slots(const int32_t* slots, int64_t num_slots, const SentNodes& sent, const double* eye, const double* centre,
                    double share, int64_t first, int64_t limit, int32_t* out) {
  float at[3], here[3];
  for (int axis = 0; axis < 3; ++axis) {
    at[axis] = static_cast<float>(eye[axis]);
    here[axis] = static_cast<float>(eye[axis] - centre[axis]);
  }
  const float allowed = static_cast<float>(share * share);
  int64_t count = 0;
  for (int64_t i = 0; i < num_slots && count <= limit; ++i) {
    const int64_t place = first + i < num_slots ? first + i : first + i - num_slots;
    const float* from = sent.eyes + 3 * int64_t(slots[place]);
    const float* mean = sent.means + 3 * int64_t(slots[place]);
    float moved = 0, distance = 0;
    for (int axis = 0; axis < 3; ++axis) {
      moved += (from[axis] - here[axis]) * (from[axis] - here[axis]);
      distance += (mean[axis] - at[axis]) * (mean[axis] - at[axis]);
    }
    if (moved > allowed * distance) out[count++] = int32_t(place);
  }
  return count;
}

int64_t drifted_slots(const int32_t* slots, int64_t num_slots, const SentNodes& sent, const double* plane, double unit,
                      double factor, int32_t* out, float* now) {
  int64_t count = 0;
  for (int64_t i = 0; i < num_slots; ++i) {
    const int64_t slot = slots[i];
    const double limit = sent.limits[slot], before = sent.dilations[slot];
    if (limit == 0) continue;  // a leaf: half of a cut and more, whose means need not be looked up
    const float* mean = sent.means + 3 * slot;
    const double depth = plane[0] * mean[0] + plane[1] * mean[1] + plane[2] * mean[2] + plane[3];
    const double whole = unit * depth * depth, found = whole < limit ? whole : limit;
    out[count] = int32_t(i);
    now[count] = static_cast<float>(found);
    count += (found > factor * before) | (factor * found < before);
  }
  return count;
}

}  // namespace splatree
