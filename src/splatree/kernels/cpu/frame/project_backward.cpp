// Backward of the projection: 64 splats at a time go into planes, are computed lane by lane and become rows of the derivatives.
// kernels/reference/backward.py is the definition. A thread writes the rows of its own splats only.
#include "cpu/frame/project_backward.h"

#include <string.h>

#include "cpu/frame/rows.h"
#include "cpu/runtime/isa.h"
#include "cpu/runtime/pool.h"
#include "cpu/runtime/quad.h"
#include "shared/backward.h"
#include "shared/harmonics.h"
#include "shared/record.h"

namespace splatree::SPLATREE_ISA {
namespace {

constexpr int LANES = 16, BATCH = 64, MAX_COEFFICIENTS = 16;

struct alignas(64) Planes {
  float mean[3][BATCH], quat[4][BATCH], log_scale[3][BATCH], logit[BATCH];
  float factor[3][BATCH], moment[6][BATCH], color[3][BATCH], depth[BATCH];
  float direction[3][BATCH], inverse_distance[BATCH];
  float along[MAX_COEFFICIENTS][BATCH], basis[MAX_COEFFICIENTS][BATCH];
  float by_mean[4][BATCH], by_quat[4][BATCH], by_log_scale[4][BATCH], by_logit[BATCH];
};

template <class Body>
SPLATREE_FN void for_lanes(int num_blocks, const Body& body) {
  for (int block = 0; block < num_blocks; ++block) {
#pragma omp simd
    for (int i = block * LANES; i < (block + 1) * LANES; ++i) body(i);
  }
}

// Splats that are computed together; the last is repeated to fill whole blocks of lanes.
struct Batch {
  int64_t splat[BATCH];
  int32_t row[BATCH];
  int count, num_blocks;
};

void load_batch(const ProjectBackwardJob& job, const Batch& batch, Planes& p) {
  for (int i = 0; i < batch.num_blocks * LANES; i += 4) {
    const Four rows = four_of(batch.row + i);
    load_four<3>(job.means, rows, 3, i, p.mean);
    load_four<4>(job.quats, rows, 4, i, p.quat);
    load_four<3>(job.log_scales, rows, 3, i, p.log_scale);
    for (int j = i; j < i + 4; ++j) p.logit[j] = job.logit_opacities[batch.row[j]];
  }
  for (int i = 0; i < batch.num_blocks * LANES; ++i) {
    const int64_t s = batch.splat[i];
    const float* record = job.records + s * NUM_COLUMNS;
    for (int k = 0; k < 3; ++k) p.factor[k][i] = record[FACTOR_A + k];
    for (int k = 0; k < 6; ++k) p.moment[k][i] = job.moments[6 * s + k];
    // A channel that is clipped at 0 takes no derivative.
    for (int k = 0; k < 3; ++k) p.color[k][i] = record[RED + k] > 0.f ? job.colors[3 * s + k] : 0.f;
    p.depth[i] = job.depths ? job.depths[s] : 0.f;
  }
}

template <bool ANTIALIASED>
void shape_batch(const ProjectBackwardJob& job, int num_blocks, Planes& p) {
  for_lanes(num_blocks, [&](int i) {
    const Point point = point_of(job.view, p.mean[0][i], p.mean[1][i], p.mean[2][i]);
    const Moments m = {p.moment[0][i], p.moment[1][i], p.moment[2][i], p.moment[3][i], p.moment[4][i], p.moment[5][i]};
    const GaussianBackward g = gaussian_backward_of<ANTIALIASED>(
        job.view, point, {p.log_scale[0][i], p.log_scale[1][i], p.log_scale[2][i]}, p.quat[0][i], p.quat[1][i], p.quat[2][i],
        p.quat[3][i], m, p.factor[0][i], p.factor[1][i], p.factor[2][i], p.depth[i]);
    p.by_mean[0][i] = g.mean.x, p.by_mean[1][i] = g.mean.y, p.by_mean[2][i] = g.mean.z;
    p.by_log_scale[0][i] = g.log_scale.x, p.by_log_scale[1][i] = g.log_scale.y, p.by_log_scale[2][i] = g.log_scale.z;
    for (int k = 0; k < 4; ++k) p.by_quat[k][i] = g.quat[k];
    p.by_logit[i] = m.h * (1.f - sigmoid_of(p.logit[i]));
    const float inverse = 1.f / __builtin_sqrtf(point.dx * point.dx + point.dy * point.dy + point.dz * point.dz);
    p.inverse_distance[i] = inverse;
    p.direction[0][i] = point.dx * inverse, p.direction[1][i] = point.dy * inverse, p.direction[2][i] = point.dz * inverse;
  });
}

// The colour of a splat depends on the direction that it is seen in.
template <int DEGREE>
void turn_batch(const ProjectBackwardJob& job, const Batch& batch, Planes& p) {
  constexpr int COUNT = (DEGREE + 1) * (DEGREE + 1);
  if (DEGREE == 0) return;
  for (int i = 0; i < batch.num_blocks * LANES; ++i) {
    const float* sh = job.sh + int64_t(batch.row[i]) * 3 * job.num_coefficients;
    for (int k = 1; k < COUNT; ++k)
      p.along[k][i] = sh[3 * k] * p.color[0][i] + sh[3 * k + 1] * p.color[1][i] + sh[3 * k + 2] * p.color[2][i];
  }
  for_lanes(batch.num_blocks, [&](int i) {
    const Vector d =
        direction_backward_of(p.direction[0][i], p.direction[1][i], p.direction[2][i], DEGREE, &p.along[0][i], BATCH);
    p.by_mean[0][i] += p.inverse_distance[i] * d.x;
    p.by_mean[1][i] += p.inverse_distance[i] * d.y;
    p.by_mean[2][i] += p.inverse_distance[i] * d.z;
  });
}

template <int WIDTH>
void write_rows(const float (*planes)[BATCH], int count, float* to) {
  for (int i = 0; i < count; ++i)
    for (int k = 0; k < WIDTH; ++k) to[WIDTH * i + k] = planes[k][i];
}

template <int DEGREE>
void write_batch(const ProjectBackwardJob& job, const Batch& batch, const Planes& p) {
  constexpr int COUNT = (DEGREE + 1) * (DEGREE + 1);
  const int64_t first = batch.splat[0], width = 3 * job.num_coefficients;
  write_rows<3>(p.by_mean, batch.count, job.by_means + 3 * first);
  write_rows<4>(p.by_quat, batch.count, job.by_quats + 4 * first);
  write_rows<3>(p.by_log_scale, batch.count, job.by_log_scales + 3 * first);
  memcpy(job.by_logit_opacities + first, p.by_logit, batch.count * sizeof(float));
  for (int i = 0; i < batch.count; ++i) {
    float* to = job.by_sh + (first + i) * width;
    const float color[3] = {p.color[0][i], p.color[1][i], p.color[2][i]};
    for (int k = 0; k < COUNT; ++k)
      for (int c = 0; c < 3; ++c) to[3 * k + c] = p.basis[k][i] * color[c];
    for (int64_t k = 3 * COUNT; k < width; ++k) to[k] = 0.f;
  }
}

template <int DEGREE>
void backward_all(const ProjectBackwardJob& job) {
  parallel_ranges(job.num_splats, 1024, job.threads, [&](int64_t begin, int64_t end) {
    Planes planes;
    for (int64_t first = begin; first < end; first += BATCH) {
      Batch batch;
      batch.count = int(end - first < BATCH ? end - first : BATCH);
      batch.num_blocks = (batch.count + LANES - 1) / LANES;
      for (int i = 0; i < batch.num_blocks * LANES; ++i) {
        batch.splat[i] = first + (i < batch.count ? i : batch.count - 1);
        batch.row[i] = job.rows[batch.splat[i]];
      }
      load_batch(job, batch, planes);
      job.view.antialiased ? shape_batch<true>(job, batch.num_blocks, planes) : shape_batch<false>(job, batch.num_blocks, planes);
      turn_batch<DEGREE>(job, batch, planes);
      for_lanes(batch.num_blocks, [&](int i) {
        harmonics_of(planes.direction[0][i], planes.direction[1][i], planes.direction[2][i], DEGREE, &planes.basis[0][i], BATCH);
      });
      write_batch<DEGREE>(job, batch, planes);
    }
  });
}

}  // namespace

void project_backward(const ProjectBackwardJob& job) {
  switch (job.degree) {
    case 0:
      return backward_all<0>(job);
    case 1:
      return backward_all<1>(job);
    case 2:
      return backward_all<2>(job);
    default:
      return backward_all<3>(job);
  }
}

}  // namespace splatree::SPLATREE_ISA
