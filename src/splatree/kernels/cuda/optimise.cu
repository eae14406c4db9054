// A step of Adam for rows that were drawn; kernels/reference/optimise.py is the definition.
//
// step_rows   a warp a row, a lane a number of the row: their moments lie side by side
#include "cuda/optimise.h"

namespace splatree {
namespace {

constexpr unsigned MOST_STEPS = 65535;

// Number k of a row: its column, and its place in the columns of the scene and of the derivatives.
struct Place {
  Global<float> column;
  Global<const float> derivatives;
  long long at, from;
};

SPLATREE_FN Place place_of(const StepJob* job, long long row, long long i, int k) {
  if (k < 3) return {job->means, job->by_means, 3 * row + k, 3 * i + k};
  if (k < 7) return {job->quats, job->by_quats, 4 * row + k - 3, 4 * i + k - 3};
  if (k < 10) return {job->log_scales, job->by_log_scales, 3 * row + k - 7, 3 * i + k - 7};
  if (k < 11) return {job->logit_opacities, job->by_logit_opacities, row, i};
  const long long width = 3 * job->num_coefficients;
  return {job->sh, job->by_sh, width * row + k - 11, width * i + k - 11};
}

}  // namespace
}  // namespace splatree

using namespace splatree;

SPLATREE_KERNEL(256, 4) step_rows(const StepJob* job) {
  const long long i = index_of_thread() / WARP;
  if (i >= job->num_rows) return;
  const long long row = job->rows[i];
  const int count = 11 + 3 * int(job->num_coefficients);
  bool is_finite = true;
  for (int k = lane_of(); k < count; k += WARP) {
    const Place place = place_of(job, row, i, k);
    is_finite &= place.derivatives[place.from] * 0.f == 0.f;
  }
  if (!__all_sync(ALL_LANES, is_finite)) return;
  const unsigned before = job->steps[row], t = before < MOST_STEPS ? before + 1 : before;
  const float ramp = least(t * job->numbers[RAMP], 1.f), beta_1 = job->numbers[BETA_1], beta_2 = job->numbers[BETA_2];
  const float first = ramp * job->corrections[2 * t], second = job->corrections[2 * t + 1];
  for (int k = lane_of(); k < count; k += WARP) {
    const Place place = place_of(job, row, i, k);
    const float d = place.derivatives[place.from];
    const long long at = 2 * row * job->num_moments + k;
    const float m = beta_1 * job->moments[at] + (1.f - beta_1) * d;
    const float v = beta_2 * job->moments[at + job->num_moments] + (1.f - beta_2) * d * d;
    job->moments[at] = m, job->moments[at + job->num_moments] = v;
    const float change = job->rates[k] * (m * first) / (__builtin_sqrtf(v * second) + job->numbers[EPSILON]);
    place.column[place.at] = place.column[place.at] - change;
  }
  __syncwarp();
  if (lane_of() == 0) job->steps[row] = t;
}
