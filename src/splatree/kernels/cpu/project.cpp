// Projection and colour of selected rows in one pass: blocks of 16 rows are gathered into planes, computed lane by lane, and
// the visible lanes become records.
//
// A thread fills a chunk's records in a buffer of its own (32 KB, in its cache), waits for the place of the chunk before,
// and copies: so the records are in the order of the rows, whatever the threads, and are written to memory once.
#include "cpu/project.h"

#include <sched.h>
#include <string.h>
#include <time.h>

#include "cpu/isa.h"
#include "cpu/pool.h"
#include "cpu/quad.h"
#include "shared/harmonics.h"
#include "shared/record.h"

namespace splatree::SPLATREE_ISA {
namespace {

constexpr int LANES = 16;
constexpr int BATCH = 64;  // rows gathered at a time: a vector load right behind scalar stores would wait for them
constexpr int CHUNK = PROJECT_CHUNK;
constexpr int MAX_COEFFICIENTS = 16;

int smaller(int a, int b) { return a < b ? a : b; }

struct alignas(64) Planes {
  int32_t row[BATCH];
  float mean[3][BATCH], quat[4][BATCH], log_scale[3][BATCH], logit_opacity[BATCH];
  float dx[BATCH], dy[BATCH], dz[BATCH];
  float tx[3][BATCH], ty[3][BATCH], scale[3][BATCH], sigmoid[BATCH], mx[3][BATCH], my[3][BATCH];
  int32_t kept[BATCH];
  float out[NUM_COLUMNS][BATCH];
  float basis[MAX_COEFFICIENTS][BATCH];
};

Vector load(const float (&planes)[3][BATCH], int i) { return {planes[0][i], planes[1][i], planes[2][i]}; }
void store(Vector v, float (&planes)[3][BATCH], int i) { planes[0][i] = v.x, planes[1][i] = v.y, planes[2][i] = v.z; }

// Calls body(i) for each lane of the blocks; whole blocks, so that the code of a lane does not depend on its place.
template <class Body>
SPLATREE_FN void for_lanes(int num_blocks, const Body& body) {
  for (int block = 0; block < num_blocks; ++block) {
#pragma omp simd
    for (int i = block * LANES; i < (block + 1) * LANES; ++i) body(i);
  }
}

// What a thread computes of a chunk.
struct alignas(64) Chunk {
  float records[(CHUNK + 1) * NUM_COLUMNS];  // one more: what is not visible is written behind the last
  float depths[CHUNK];
  int32_t rows[CHUNK];
  int count;
};

// Takes the rows of a batch; the last is repeated to fill whole blocks, whose number is returned.
int load_rows(const int32_t* rows, int used, Planes& p) {
  const int num_blocks = (used + LANES - 1) / LANES;
  for (int i = 0; i < used; ++i) p.row[i] = rows[i];
  for (int i = used; i < num_blocks * LANES; ++i) p.row[i] = rows[used - 1];
  return num_blocks;
}

// A column of rows of three or four floats into planes, four rows at a time. Three are read as four: the row `last` of the
// column from its padded copy, so that nothing is read behind its end.
template <int WIDTH>
void gather(const float* column, int32_t last, const float* padded, const Planes& p, int num_blocks,
            float (*planes)[BATCH]) {
  for (int i = 0; i < num_blocks * LANES; i += 4) {
    Quad rows[4];
    for (int j = 0; j < 4; ++j) {
      const int32_t row = p.row[i + j];
      rows[j] = load_quad(row == last ? padded : column + int64_t(row) * WIDTH);
    }
    transpose(rows[0], rows[1], rows[2], rows[3]);
    for (int j = 0; j < WIDTH; ++j) store_quad(&planes[j][i], rows[j]);
  }
}

void gather(const float* column, const Planes& p, int num_blocks, float* plane) {
  for (int i = 0; i < num_blocks * LANES; ++i) plane[i] = column[p.row[i]];
}

template <bool ANTIALIASED, bool SQUARE>
void shape_batch(const ProjectJob& job, int num_blocks, Planes& p) {
  for_lanes(num_blocks, [&](int i) {
    const Splat splat = splat_of<ANTIALIASED, SQUARE>(job.view, job.square, p.out[X][i], p.out[Y][i], p.out[DEPTH][i],
                                                      load(p.mx, i), load(p.my, i), p.sigmoid[i]);
    p.out[FACTOR_A][i] = splat.a, p.out[FACTOR_B][i] = splat.b, p.out[FACTOR_C][i] = splat.c;
    p.out[OPACITY][i] = splat.opacity, p.out[LOG2_OPACITY][i] = splat.log2_opacity;
    p.out[EXTENT_X][i] = splat.extent_x, p.out[EXTENT_Y][i] = splat.extent_y;
    p.kept[i] = splat.visible;
  });
}

void project_batch(const ProjectJob& job, int num_blocks, Planes& p) {
  // The coefficients are read last; each row has cache lines of its own.
  for (int i = 0; i < num_blocks * LANES; ++i)
    __builtin_prefetch(job.sh + int64_t(p.row[i]) * job.num_coefficients * 3);
  gather<3>(job.means, job.last, job.last_mean, p, num_blocks, p.mean);
  gather<4>(job.quats, -1, nullptr, p, num_blocks, p.quat);
  gather<3>(job.log_scales, job.last, job.last_log_scale, p, num_blocks, p.log_scale);
  gather(job.logit_opacities, p, num_blocks, p.logit_opacity);
  // Four short loops: in one long loop the processor would wait for each step of a block, as the next block is too far ahead.
  for_lanes(num_blocks, [&](int i) {
    const Point point = point_of(job.view, p.mean[0][i], p.mean[1][i], p.mean[2][i]);
    const Image image = image_of(job.view, point.x, point.y, point.z);
    p.dx[i] = point.dx, p.dy[i] = point.dy, p.dz[i] = point.dz;
    p.out[X][i] = image.x, p.out[Y][i] = image.y, p.out[DEPTH][i] = point.z;
    store(image.tx, p.tx, i), store(image.ty, p.ty, i);
  });
  for_lanes(num_blocks, [&](int i) {
    store(scale_of(job.view, p.out[DEPTH][i], load(p.log_scale, i)), p.scale, i);
    p.sigmoid[i] = sigmoid_of(p.logit_opacity[i]);
  });
  for_lanes(num_blocks, [&](int i) {
    const Factor m = factor_of(load(p.tx, i), load(p.ty, i), p.quat[0][i], p.quat[1][i], p.quat[2][i], p.quat[3][i],
                               load(p.scale, i));
    store(m.x, p.mx, i), store(m.y, p.my, i);
  });
  const auto shape = job.view.antialiased ? job.is_square ? shape_batch<true, true> : shape_batch<true, false>
                     : job.is_square      ? shape_batch<false, true>
                                          : shape_batch<false, false>;
  shape(job, num_blocks, p);
}

template <int DEGREE>
void load_basis(int num_blocks, Planes& p) {
  for_lanes(num_blocks, [&](int i) {
    const float inverse = 1.f / __builtin_sqrtf(p.dx[i] * p.dx[i] + p.dy[i] * p.dy[i] + p.dz[i] * p.dz[i]);
    harmonics_of(p.dx[i] * inverse, p.dy[i] * inverse, p.dz[i] * inverse, DEGREE, &p.basis[0][i], BATCH);
  });
}

// Appends the visible rows of a batch. Every row's record is written, and overwritten by the next if it is not visible;
// then the visible ones get their colour.
template <int DEGREE>
void append_batch(const ProjectJob& job, int used, const Planes& p, Chunk& chunk) {
  int visible[BATCH + 1];  // place in the batch
  int count = 0;
  float* first = chunk.records + chunk.count * NUM_COLUMNS;
  for (int i = 0; i < used; i += 4) {
    float* records[4];
    for (int j = 0; j < 4; ++j) {
      records[j] = first + count * NUM_COLUMNS;
      visible[count] = i + j;
      count += p.kept[i + j] & (i + j < used);
    }
    for (int j = 0; j < NUM_COLUMNS; j += 4) {
      Quad a = load_quad(&p.out[j][i]), b = load_quad(&p.out[j + 1][i]);
      Quad c = load_quad(&p.out[j + 2][i]), d = load_quad(&p.out[j + 3][i]);
      transpose(a, b, c, d);
      store_quad(records[0] + j, a);
      store_quad(records[1] + j, b);
      store_quad(records[2] + j, c);
      store_quad(records[3] + j, d);
    }
  }
  for (int v = 0; v < count; ++v) {
    const int i = visible[v];
    const float* sh = job.sh + int64_t(p.row[i]) * job.num_coefficients * 3;
    float color[3] = {0.5f, 0.5f, 0.5f};
    for (int k = 0; k < (DEGREE + 1) * (DEGREE + 1); ++k)
      for (int c = 0; c < 3; ++c) color[c] += p.basis[k][i] * sh[3 * k + c];
    float* record = first + v * NUM_COLUMNS;
    for (int c = 0; c < 3; ++c) record[RED + c] = greatest(color[c], 0.f);
    chunk.rows[chunk.count + v] = p.row[i];
    chunk.depths[chunk.count + v] = p.out[DEPTH][i];
  }
  chunk.count += count;
}

// Waits until a place is known. Chunks are handed out in order, so the one before is done or at work; if its thread has lost
// its processor, sleeping leaves this one to others.
int64_t wait_for(const int64_t* place) {
  for (int tries = 0;; ++tries) {
    const int64_t first = __atomic_load_n(place, __ATOMIC_ACQUIRE);
    if (first >= 0) return first;
    const timespec pause = {0, 20000};
    tries < 8 ? sched_yield() : nanosleep(&pause, nullptr);
  }
}

template <int DEGREE>
int64_t project_all(const ProjectJob& job, int64_t* place) {
  const int64_t num_chunks = (job.num_rows + CHUNK - 1) / CHUNK;
  parallel_chunks(num_chunks, job.threads, [&](int64_t index) {
    Chunk chunk;
    Planes planes;
    memset(&planes, 0, sizeof planes);
    chunk.count = 0;
    const int64_t begin = index * CHUNK;
    const int num_rows = int(begin + CHUNK < job.num_rows ? CHUNK : job.num_rows - begin);
    for (int i = 0; i < num_rows; i += BATCH) {
      const int used = smaller(BATCH, num_rows - i);
      const int num_blocks = load_rows(job.rows + begin + i, used, planes);
      project_batch(job, num_blocks, planes);
      load_basis<DEGREE>(num_blocks, planes);
      append_batch<DEGREE>(job, used, planes, chunk);
    }
    const int64_t first = wait_for(&place[index]);
    __atomic_store_n(&place[index + 1], first + chunk.count, __ATOMIC_RELEASE);
    memcpy(job.out_rows + first, chunk.rows, chunk.count * sizeof(int32_t));
    memcpy(job.out_depths + first, chunk.depths, chunk.count * sizeof(float));
    memcpy(job.out_records + first * NUM_COLUMNS, chunk.records, chunk.count * sizeof(float) * NUM_COLUMNS);
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
