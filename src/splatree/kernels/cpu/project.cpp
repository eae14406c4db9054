// Projection and colour of selected rows in one pass: blocks of 16 rows are gathered into planes, computed lane by lane, and
// the visible lanes appended as records.
//
// A thread fills a chunk's records in a buffer of its own (64 KB, in its cache), waits for the place of the chunk before, and
// copies: so the records are in the order of the rows, whatever the threads, and are written to memory once.
#include "cpu/project.h"

#include <sched.h>
#include <string.h>

#include "cpu/isa.h"
#include "cpu/pool.h"
#include "shared/harmonics.h"
#include "shared/record.h"

namespace splatree::SPLATREE_ISA {
namespace {

constexpr int LANES = 16;
constexpr int CHUNK = 1024;  // rows
constexpr int MAX_COEFFICIENTS = 16;


struct alignas(64) Planes {
  int32_t row[LANES];
  float mean[3][LANES], quat[4][LANES], log_scale[3][LANES], logit_opacity[LANES];
  float dx[LANES], dy[LANES], dz[LANES], x[LANES], y[LANES], z[LANES];
  float out[NUM_COLUMNS][LANES];
  int32_t visible[LANES];
  float basis[MAX_COEFFICIENTS][LANES];
};

// The rows of a block; after the end its last row is repeated, and dropped later.
int load_rows(const ProjectJob& job, int64_t begin, int64_t end, Planes& p) {
  const int used = end - begin < LANES ? int(end - begin) : LANES;
  for (int l = 0; l < LANES; ++l) {
    const int64_t i = begin + (l < used ? l : used - 1);
    p.row[l] = job.rows ? job.rows[i] : int32_t(i);
  }
  return used;
}

template <int WIDTH>
void gather(const float* column, const int32_t* rows, float (*planes)[LANES]) {
  for (int l = 0; l < LANES; ++l) {
    const float* row = column + int64_t(rows[l]) * WIDTH;
    for (int i = 0; i < WIDTH; ++i) planes[i][l] = row[i];
  }
}

// Camera coordinates; whether any lane is beyond the near plane.
bool load_points(const ProjectJob& job, Planes& p) {
  gather<3>(job.means, p.row, p.mean);
  int any = 0;
#pragma omp simd reduction(| : any)
  for (int l = 0; l < LANES; ++l) {
    const Point point = point_of(job.view, p.mean[0][l], p.mean[1][l], p.mean[2][l]);
    p.dx[l] = point.dx, p.dy[l] = point.dy, p.dz[l] = point.dz;
    p.x[l] = point.x, p.y[l] = point.y, p.z[l] = point.z;
    any |= point.z > job.view.near;
  }
  return any;
}

bool project_block(const ProjectJob& job, int used, Planes& p) {
  gather<4>(job.quats, p.row, p.quat);
  gather<3>(job.log_scales, p.row, p.log_scale);
  gather<1>(job.logit_opacities, p.row, &p.logit_opacity);
  int any = 0;
#pragma omp simd reduction(| : any)
  for (int l = 0; l < LANES; ++l) {
    const Point point = {p.dx[l], p.dy[l], p.dz[l], p.x[l], p.y[l], p.z[l]};
    const Splat splat =
        splat_of(job.view, point, p.quat[0][l], p.quat[1][l], p.quat[2][l], p.quat[3][l],
                 {p.log_scale[0][l], p.log_scale[1][l], p.log_scale[2][l]}, p.logit_opacity[l]);
    p.out[X][l] = splat.x, p.out[Y][l] = splat.y;
    p.out[FACTOR_A][l] = splat.a, p.out[FACTOR_B][l] = splat.b, p.out[FACTOR_C][l] = splat.c;
    p.out[OPACITY][l] = splat.opacity, p.out[LOG2_OPACITY][l] = splat.log2_opacity;
    p.out[DEPTH][l] = p.z[l];
    p.out[EXTENT_X][l] = splat.extent_x, p.out[EXTENT_Y][l] = splat.extent_y;
    p.visible[l] = splat.visible & (l < used);
    any |= p.visible[l];
  }
  return any;
}

template <int DEGREE>
void load_basis(Planes& p) {
#pragma omp simd
  for (int l = 0; l < LANES; ++l) {
    const float inverse = 1.f / __builtin_sqrtf(p.dx[l] * p.dx[l] + p.dy[l] * p.dy[l] + p.dz[l] * p.dz[l]);
    harmonics_of(p.dx[l] * inverse, p.dy[l] * inverse, p.dz[l] * inverse, DEGREE, &p.basis[0][l], LANES);
  }
}

template <int DEGREE>
int append_block(const ProjectJob& job, Planes& p, int32_t* rows, float* records, int count) {
  load_basis<DEGREE>(p);
  for (int l = 0; l < LANES; ++l) {
    if (!p.visible[l]) continue;
    float* record = records + int64_t(count) * NUM_COLUMNS;
    for (int i = 0; i < NUM_COLUMNS; ++i) record[i] = p.out[i][l];
    const float* sh = job.sh + int64_t(p.row[l]) * job.num_coefficients * 3;
    float color[3] = {0.5f, 0.5f, 0.5f};
    for (int k = 0; k < (DEGREE + 1) * (DEGREE + 1); ++k)
      for (int c = 0; c < 3; ++c) color[c] += p.basis[k][l] * sh[3 * k + c];
    for (int c = 0; c < 3; ++c) record[RED + c] = greatest(color[c], 0.f);
    rows[count++] = p.row[l];
  }
  return count;
}

template <int DEGREE>
int64_t project_all(const ProjectJob& job, int64_t* place) {
  const int64_t num_chunks = (job.num_rows + CHUNK - 1) / CHUNK;
  parallel_chunks(num_chunks, job.threads, [&](int64_t chunk) {
    alignas(64) float records[CHUNK * NUM_COLUMNS];
    int32_t rows[CHUNK];
    Planes planes;
    memset(&planes, 0, sizeof planes);
    const int64_t end = (chunk + 1) * CHUNK < job.num_rows ? (chunk + 1) * CHUNK : job.num_rows;
    int count = 0;
    for (int64_t begin = chunk * CHUNK; begin < end; begin += LANES) {
      const int used = load_rows(job, begin, end, planes);
      if (load_points(job, planes) && project_block(job, used, planes))
        count = append_block<DEGREE>(job, planes, rows, records, count);
    }
    // Chunks are handed out in order, so the one before is done or at work.
    int64_t first;
    while ((first = __atomic_load_n(&place[chunk], __ATOMIC_ACQUIRE)) < 0) sched_yield();
    __atomic_store_n(&place[chunk + 1], first + count, __ATOMIC_RELEASE);
    memcpy(job.out_rows + first, rows, count * sizeof *rows);
    memcpy(job.out_records + first * NUM_COLUMNS, records, count * sizeof(float) * NUM_COLUMNS);
  });
  return place[num_chunks];
}

}  // namespace

// `place` has one entry a chunk and one more, 0 and then all -1; returns the number of splats.
int64_t project(const ProjectJob& job, int64_t* place) {
  switch (job.degree) {
    case 0:
      return project_all<0>(job, place);
    case 1:
      return project_all<1>(job, place);
    case 2:
      return project_all<2>(job, place);
    default:
      return project_all<3>(job, place);
  }
}

}  // namespace splatree::SPLATREE_ISA
