// Backward of the projection; kernels/reference/backward.py is the definition.
//
// project_backward   a thread a splat: from its sums over the pixels to the derivatives by the columns of its Gaussian, which go
//                    to rows of their own.
#include "cuda/rows.h"
#include "shared/backward.h"
#include "shared/harmonics.h"
#include "shared/sums.h"

namespace splatree {
namespace {

constexpr int MAX_COEFFICIENTS = 16;

SPLATREE_FN void store_vector(Global<float> column, long long row, Vector v) {
  column[3 * row] = v.x, column[3 * row + 1] = v.y, column[3 * row + 2] = v.z;
}

template <bool ANTIALIASED>
SPLATREE_FN GaussianBackward shape_backward(const FrameJob* job, long long row, const Point& p, const Moments& m, float factor_a,
                                            float factor_b, float factor_c, float by_depth) {
  const float4 quat = job->quats[row];
  return gaussian_backward_of<ANTIALIASED>(job->numbers.view, p, load_vector(job->log_scales, row), quat.x, quat.y, quat.z,
                                           quat.w, m, factor_a, factor_b, factor_c, by_depth);
}

// By the harmonics, and what the direction that they are seen in adds to the derivative by the mean.
template <int DEGREE>
SPLATREE_FN Vector harmonics_backward(const FrameJob* job, long long i, long long row, const Point& p, Vector by_color) {
  constexpr int COUNT = (DEGREE + 1) * (DEGREE + 1);
  const float inverse = 1.f / __builtin_sqrtf(p.dx * p.dx + p.dy * p.dy + p.dz * p.dz);
  const float x = p.dx * inverse, y = p.dy * inverse, z = p.dz * inverse;
  float basis[MAX_COEFFICIENTS], along[MAX_COEFFICIENTS];
  harmonics_of(x, y, z, DEGREE, basis, 1);
  const long long width = 3 * job->num_coefficients;
#pragma unroll
  for (int k = 0; k < COUNT; ++k) {
    along[k] = DEGREE ? dot(load_vector(job->sh, row * job->num_coefficients + k), by_color) : 0.f;
    const Vector by = {basis[k] * by_color.x, basis[k] * by_color.y, basis[k] * by_color.z};
    store_vector(job->by_sh, i * job->num_coefficients + k, by);
  }
  for (long long k = 3 * COUNT; k < width; ++k) job->by_sh[i * width + k] = 0.f;
  const Vector d = direction_backward_of(x, y, z, DEGREE, along, 1);
  return {inverse * d.x, inverse * d.y, inverse * d.z};
}

SPLATREE_FN Vector harmonics_backward(const FrameJob* job, long long i, long long row, const Point& p, Vector by_color) {
  switch (job->numbers.degree) {
    case 0:
      return harmonics_backward<0>(job, i, row, p, by_color);
    case 1:
      return harmonics_backward<1>(job, i, row, p, by_color);
    case 2:
      return harmonics_backward<2>(job, i, row, p, by_color);
    default:
      return harmonics_backward<3>(job, i, row, p, by_color);
  }
}

}  // namespace
}  // namespace splatree

using namespace splatree;

SPLATREE_KERNEL(128, 4) project_backward(const FrameJob* job) {
  const long long i = index_of_thread();
  if (i >= held(job->counters[NUM_SELECTED], job->row_capacity)) return;
  const FrameNumbers& n = job->numbers;
  const long long row = job->rows[i], sums = i * NUM_SUMS;
  const auto sum = [&](int k) { return float(job->splat_sums[sums + k]); };
  const float4 a = job->records[4 * i], b = job->records[4 * i + 1], c = job->records[4 * i + 2];
  const Point p = load_point(job, row);
  const Moments m = {sum(SUM_H), sum(SUM_HU), sum(SUM_HV), sum(SUM_HUU), sum(SUM_HUV), sum(SUM_HVV)};
  const GaussianBackward g = n.view.antialiased ? shape_backward<true>(job, row, p, m, a.z, a.w, b.x, sum(SUM_DEPTH))
                                                : shape_backward<false>(job, row, p, m, a.z, a.w, b.x, sum(SUM_DEPTH));
  // A channel that is clipped at 0 takes no derivative.
  const Vector by_color = {b.w > 0.f ? sum(SUM_RED) : 0.f, c.x > 0.f ? sum(SUM_GREEN) : 0.f, c.y > 0.f ? sum(SUM_BLUE) : 0.f};
  const Vector turned = harmonics_backward(job, i, row, p, by_color);
  store_vector(job->by_means, i, {g.mean.x + turned.x, g.mean.y + turned.y, g.mean.z + turned.z});
  store_vector(job->by_log_scales, i, g.log_scale);
  for (int k = 0; k < 4; ++k) job->by_quats[4 * i + k] = g.quat[k];
  job->by_logit_opacities[i] = m.h * (1.f - sigmoid_of(job->logit_opacities[row]));
}
