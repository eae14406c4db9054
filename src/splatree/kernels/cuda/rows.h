// Rows of the scene as a thread reads them.
#pragma once
#include "cuda/device.h"

namespace splatree {
namespace {

SPLATREE_FN Vector load_vector(Global<const float> column, long long row) {
  return {column[3 * row], column[3 * row + 1], column[3 * row + 2]};
}

SPLATREE_FN Point load_point(const FrameJob* job, long long row) {
  const Vector mean = load_vector(job->means, row);
  return point_of(job->numbers.view, mean.x, mean.y, mean.z);
}

SPLATREE_FN Factor load_factor(const FrameJob* job, const Point& point, long long row) {
  const float4 quat = job->quats[row];
  return factor_of(job->numbers.view, point, quat.x, quat.y, quat.z, quat.w, load_vector(job->log_scales, row));
}

// Whether R <= τ_R.
SPLATREE_FN bool load_small(const FrameJob* job, long long row) {
  const FrameNumbers& n = job->numbers;
  if (n.all_small) return true;
  const Point point = load_point(job, row);
  if (n.rule.sphere) return size_of_extent(n.rule, point, job->extents[row]) <= n.rule.limit;
  return size_of(n.view, n.rule, point, load_factor(job, point, row)) <= n.rule.limit;
}

// Whether a row can be seen, by the test that the options name.
SPLATREE_FN bool load_visible(const FrameJob* job, long long row) {
  const FrameNumbers& n = job->numbers;
  if (n.view_test == UNSEEN_TOO) return true;
  const Point point = load_point(job, row);
  if (n.view_test == CENTRE) return is_centred(n.view, n.rule, point);
  const float logit = job->logit_opacities[row];
  const int bound = is_visible_bound(n.view, n.rule, point, load_vector(job->log_scales, row), logit);
  if (bound != OPEN) return bound == YES;
  return is_visible(n.view, point, load_factor(job, point, row), logit);
}

}  // namespace
}  // namespace splatree
