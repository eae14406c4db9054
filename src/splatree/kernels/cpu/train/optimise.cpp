// A step of Adam for rows that were drawn; kernels/reference/optimise.py is the definition. The numbers of a row are gathered
// side by side, as its moments lie in memory, so one row is a few vectors. A thread changes the rows of its own entries only.
#include <string.h>

#include "cpu/runtime/isa.h"
#include "cpu/runtime/pool.h"
#include "cpu/train/train.h"

namespace splatree::SPLATREE_ISA {
namespace {

constexpr int MOST = 64;  // numbers of a row, rounded up

struct alignas(64) Row {
  float derivative[MOST], value[MOST];
};

// Takes the numbers of entry i side by side; what is beyond them stays 0.
void gather(const StepJob& job, int64_t i, int64_t row, Row& r) {
  int place = 0;
  for (int c = 0; c < job.num_columns; place += job.widths[c++]) {
    const int width = job.widths[c];
    for (int k = 0; k < width; ++k) r.derivative[place + k] = job.derivatives[c][i * width + k];
    for (int k = 0; k < width; ++k) r.value[place + k] = job.columns[c][row * width + k];
  }
}

void scatter(const StepJob& job, int64_t row, const Row& r) {
  int place = 0;
  for (int c = 0; c < job.num_columns; place += job.widths[c++])
    for (int k = 0; k < job.widths[c]; ++k) job.columns[c][row * job.widths[c] + k] = r.value[place + k];
}

bool is_finite(const Row& r, int count) {
  float sum = 0.f;
#pragma omp simd reduction(+ : sum)
  for (int k = 0; k < count; ++k) sum += r.derivative[k] * 0.f;
  return sum == 0.f;
}

}  // namespace

void step_rows(const StepJob& job) {
  const int count = job.num_moments;
  parallel_ranges(job.num_rows, 1024, job.threads, [&](int64_t begin, int64_t end) {
    Row r;
    memset(&r, 0, sizeof r);
    for (int64_t i = begin; i < end; ++i) {
      const int64_t row = job.rows[i];
      gather(job, i, row, r);
      if (!is_finite(r, count)) continue;
      const int before = job.steps[row], t = before < 65535 ? before + 1 : before;
      job.steps[row] = uint16_t(t);
      const float ramp = t * job.ramp < 1.f ? t * job.ramp : 1.f;
      const float first = ramp * job.corrections[2 * t], second = job.corrections[2 * t + 1];
      float *m = job.moments + row * 2 * count, *v = m + count;
#pragma omp simd
      for (int k = 0; k < count; ++k) {
        const float d = r.derivative[k];
        m[k] = job.beta_1 * m[k] + (1.f - job.beta_1) * d;
        v[k] = job.beta_2 * v[k] + (1.f - job.beta_2) * d * d;
        r.value[k] -= job.rates[k] * (m[k] * first) / (__builtin_sqrtf(v[k] * second) + job.epsilon);
      }
      scatter(job, row, r);
    }
  });
}

}  // namespace splatree::SPLATREE_ISA
