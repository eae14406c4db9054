// Projection and colour of selected rows in one pass over memory, a chunk at a time: rows that cannot be in view are dropped
// by a bound (in_view.h); the others are taken into planes, computed lane by lane, and the visible lanes become records.
//
// A thread fills a chunk's records in a buffer (32 KB, in its cache). They are copied once their place is known, when the chunks
// before are finished, by the thread that finished the last of them (runtime/in_order.h): so the records are in the order of the
// rows, whatever the threads, they are written to memory once, and no thread waits for another. Many records are written past
// the caches: a line that is not read first costs half, and what is beyond the caches' size would not be found there anyway.
#include "cpu/frame/project.h"

#include <string.h>
#ifdef __SSE2__
#include <immintrin.h>
#endif

#include "cpu/frame/in_view.h"
#include "cpu/frame/rows.h"
#include "cpu/runtime/in_order.h"
#include "cpu/runtime/isa.h"
#include "cpu/runtime/pool.h"
#include "cpu/runtime/quad.h"
#include "shared/harmonics.h"
#include "shared/record.h"

namespace splatree::SPLATREE_ISA {
namespace {

constexpr int LANES = 16;
constexpr int BATCH = 64;  // rows taken at a time: a vector load right behind narrower stores would wait for them
constexpr int MOST = 48;   // of a batch: if so many are in view, all are computed where they are
constexpr int CHUNK = PROJECT_CHUNK;
constexpr int MAX_COEFFICIENTS = 16;
constexpr int64_t STREAMED_ROWS = 1 << 19;  // whose records are 32 MB

int smaller(int a, int b) { return a < b ? a : b; }

struct alignas(64) Planes {
  float mean[3][BATCH], quat[4][BATCH], log_scale[3][BATCH], logit_opacity[BATCH];
  float dx[BATCH], dy[BATCH], dz[BATCH];
  float tx[3][BATCH], ty[3][BATCH], scale[3][BATCH], sigmoid[BATCH], mx[3][BATCH], my[3][BATCH];
  float curve[4][BATCH];
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

// What is computed of a chunk.
struct alignas(64) Chunk : ChunkBuffer {
  alignas(64) float records[(CHUNK + 1) * NUM_COLUMNS];  // one more: what is not visible is written behind the last
  float depths[CHUNK + 1];
  int32_t rows[CHUNK + 1];
};

// Rows that are computed together. The last is repeated to fill whole blocks of lanes.
struct Batch {
  const int32_t* row;
  int count, num_blocks;
  bool is_run;  // whether they follow each other, as they do where whole runs are drawn
};

Batch batch_of(int32_t* row, int count) {
  const int num_blocks = (count + LANES - 1) / LANES;
  for (int i = count; i < num_blocks * LANES; ++i) row[i] = row[count - 1];
  int differs = 0;
#pragma omp simd reduction(| : differs)
  for (int i = 0; i < num_blocks * LANES; ++i) differs |= row[i] ^ (row[0] + i);
  return {row, count, num_blocks, !differs};
}

// Means and scales, on which a first look decides.
void load_places(const ProjectJob& job, const Batch& batch, Planes& p) {
  const int64_t num_lanes = batch.num_blocks * LANES, first = batch.row[0];
  if (batch.is_run) {
    load_run<3>(job.means + 3 * first, num_lanes, p.mean);
    load_run<3>(job.log_scales + 3 * first, num_lanes, p.log_scale);
    return;
  }
  for (int i = 0; i < num_lanes; i += 4) {
    const Four rows = four_of(batch.row + i);
    load_four<3>(job.means, rows, 3, i, p.mean);
    load_four<3>(job.log_scales, rows, 3, i, p.log_scale);
  }
}

void load_looks(const ProjectJob& job, const Batch& batch, Planes& p) {
  const int64_t num_lanes = batch.num_blocks * LANES, first = batch.row[0];
  if (batch.is_run) {
    load_run<4>(job.quats + 4 * first, num_lanes, p.quat);
    memcpy(p.logit_opacity, job.logit_opacities + first, num_lanes * sizeof(float));
    return;
  }
  for (int i = 0; i < num_lanes; i += 4) {
    const Four rows = four_of(batch.row + i);
    const float* logits = job.logit_opacities;
    load_four<4>(job.quats, rows, 4, i, p.quat);
    store_quad(&p.logit_opacity[i], Quad{logits[rows.row[0]], logits[rows.row[1]], logits[rows.row[2]], logits[rows.row[3]]});
  }
}

// The coefficients of degree 0.
void load_means_of_color(const ProjectJob& job, const Batch& batch, float (*planes)[BATCH]) {
  const int64_t num_lanes = batch.num_blocks * LANES, stride = 3 * job.num_coefficients;
  if (batch.is_run && stride == 3) return load_run<3>(job.sh + 3 * int64_t(batch.row[0]), num_lanes, planes);
  for (int i = 0; i < num_lanes; i += 4) load_four<3>(job.sh, four_of(batch.row + i), stride, i, planes);
}

template <bool ANTIALIASED, bool SQUARE>
void shape_batch(const ProjectJob& job, int num_blocks, Planes& p) {
  for_lanes(num_blocks, [&](int i) {
    const Splat splat = splat_of<ANTIALIASED, SQUARE>(job.view, job.square, p.out[X][i], p.out[Y][i], p.out[DEPTH][i],
                                                      load(p.mx, i), load(p.my, i), p.sigmoid[i]);
    p.out[FACTOR_A][i] = splat.a, p.out[FACTOR_B][i] = splat.b, p.out[FACTOR_C][i] = splat.c;
    p.out[OPACITY][i] = splat.opacity, p.out[LOG2_OPACITY][i] = splat.log2_opacity;
    p.out[HALF_SIZE_X][i] = splat.half_size_x, p.out[HALF_SIZE_Y][i] = splat.half_size_y;
    p.kept[i] = splat.visible;
  });
}

// Inner nodes are drawn by the pixel at their depth.
void follow_batch(const ProjectJob& job, const Batch& batch, Planes& p) {
  const int64_t num_lanes = batch.num_blocks * LANES;
  if (batch.is_run) {
    load_run<4>(job.curves + 4 * int64_t(batch.row[0]), num_lanes, p.curve);
  } else {
    for (int i = 0; i < num_lanes; i += 4) load_four<4>(job.curves, four_of(batch.row + i), 4, i, p.curve);
  }
  const float per_square = job.view.dilation / (job.view.fx * job.view.fy);
  for_lanes(batch.num_blocks, [&](int i) {
    const Curve curve = {p.curve[0][i], p.curve[1][i], p.curve[2][i], p.curve[3][i]};
    const Vector scale = load(p.scale, i);
    const Followed f = followed_of(curve, per_square * p.out[DEPTH][i] * p.out[DEPTH][i], scale, p.sigmoid[i]);
    store(f.scale, p.scale, i);
    p.sigmoid[i] = f.opacity;
  });
}

void project_batch(const ProjectJob& job, const Batch& batch, Planes& p) {
  const int num_blocks = batch.num_blocks;
  load_places(job, batch, p);
  load_looks(job, batch, p);
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
  if (job.curves) follow_batch(job, batch, p);
  for_lanes(num_blocks, [&](int i) {
    const Factor m =
        factor_of(load(p.tx, i), load(p.ty, i), p.quat[0][i], p.quat[1][i], p.quat[2][i], p.quat[3][i], load(p.scale, i));
    store(m.x, p.mx, i), store(m.y, p.my, i);
  });
  const auto shape = job.view.antialiased ? job.is_square ? shape_batch<true, true> : shape_batch<true, false>
                     : job.is_square ? shape_batch<false, true>
                                          : shape_batch<false, false>;
  shape(job, num_blocks, p);
}

// Colours of four rows: their coefficients, a channel after the other, times the basis, coefficient by coefficient.
template <int DEGREE>
void color_four(const float* const (&sh)[4], int i, Planes& p) {
  constexpr int USED = 3 * (DEGREE + 1) * (DEGREE + 1);
  Quad color[3] = {{0.5f, 0.5f, 0.5f, 0.5f}, {0.5f, 0.5f, 0.5f, 0.5f}, {0.5f, 0.5f, 0.5f, 0.5f}};
#pragma GCC unroll 12
  for (int begin = 0; begin < USED; begin += 4) {
    // The last four overlap with those before: nothing is read behind a row.
    const int first = begin + 4 <= USED ? begin : USED - 4;
    Quad q[4] = {load_quad(sh[0] + first), load_quad(sh[1] + first), load_quad(sh[2] + first), load_quad(sh[3] + first)};
    transpose(q[0], q[1], q[2], q[3]);
#pragma GCC unroll 4
    for (int j = begin - first; j < 4; ++j) {
      const int k = (first + j) / 3, c = (first + j) % 3;
      color[c] += load_quad(&p.basis[k][i]) * q[j];
    }
  }
  for (int c = 0; c < 3; ++c) store_quad(&p.out[RED + c][i], color[c]);
}

template <int DEGREE>
void color_batch(const ProjectJob& job, const Batch& batch, Planes& p) {
  const int num_blocks = batch.num_blocks;
  if constexpr (DEGREE == 0) {
    float basis;
    harmonics_of(0, 0, 0, 0, &basis, 1);
    load_means_of_color(job, batch, p.out + RED);
    for_lanes(num_blocks, [&](int i) {
      for (int c = 0; c < 3; ++c) p.out[RED + c][i] = 0.5f + basis * p.out[RED + c][i];
    });
  } else {
    for_lanes(num_blocks, [&](int i) {
      const float inverse = 1.f / __builtin_sqrtf(p.dx[i] * p.dx[i] + p.dy[i] * p.dy[i] + p.dz[i] * p.dz[i]);
      harmonics_of(p.dx[i] * inverse, p.dy[i] * inverse, p.dz[i] * inverse, DEGREE, &p.basis[0][i], BATCH);
    });
    const int64_t stride = 3 * job.num_coefficients;
    for (int i = 0; i < num_blocks * LANES; i += 4) {
      if (!(p.kept[i] | p.kept[i + 1] | p.kept[i + 2] | p.kept[i + 3])) continue;
      const float* sh[4];
      for (int j = 0; j < 4; ++j) sh[j] = job.sh + int64_t(batch.row[i + j]) * stride;
      color_four<DEGREE>(sh, i, p);
    }
  }
  for_lanes(num_blocks, [&](int i) {
    for (int c = 0; c < 3; ++c) p.out[RED + c][i] = greatest(p.out[RED + c][i], 0.f);
  });
}

// Appends the visible rows of a batch. Every row's record is written, and overwritten by the next if it is not visible.
void append_batch(const Batch& batch, const Planes& p, Chunk& chunk) {
  int count = int(chunk.count);
  for (int i = 0; i < batch.count; i += 4) {
    float* records[4];
    for (int j = 0; j < 4; ++j) {
      records[j] = chunk.records + count * NUM_COLUMNS;
      chunk.rows[count] = batch.row[i + j];
      chunk.depths[count] = p.out[DEPTH][i + j];
      store_quad(records[j] + HALF_SIZE_Y, Quad{p.out[HALF_SIZE_Y][i + j], 0.f, 0.f, 0.f});
      count += p.kept[i + j];
    }
    for (int j = 0; j < HALF_SIZE_Y; j += 4) {
      Quad a = load_quad(&p.out[j][i]), b = load_quad(&p.out[j + 1][i]);
      Quad c = load_quad(&p.out[j + 2][i]), d = load_quad(&p.out[j + 3][i]);
      transpose(a, b, c, d);
      store_quad(records[0] + j, a);
      store_quad(records[1] + j, b);
      store_quad(records[2] + j, c);
      store_quad(records[3] + j, d);
    }
  }
  chunk.count = count;
}

template <int DEGREE>
void draw_batch(const ProjectJob& job, const Batch& batch, Planes& p, Chunk& chunk) {
  project_batch(job, batch, p);
  for (int i = batch.count; i < batch.num_blocks * LANES; ++i) p.kept[i] = 0;
  color_batch<DEGREE>(job, batch, p);
  append_batch(batch, p, chunk);
}

// Rows of a chunk that wait until they are enough for a batch.
struct Waiting {
  int32_t row[CHUNK + LANES];
  int begin, end;
};

// Draws those that wait, if they are at least so many, in batches.
template <int DEGREE>
void draw_waiting(const ProjectJob& job, int least, Waiting& waiting, Planes& p, Chunk& chunk) {
  while (waiting.end - waiting.begin >= least) {
    const int count = smaller(BATCH, waiting.end - waiting.begin);
    draw_batch<DEGREE>(job, batch_of(waiting.row + waiting.begin, count), p, chunk);
    waiting.begin += count;
  }
}

// Appends the rows of a batch that may be in view to those that wait; returns their number.
int list_candidates(const ProjectJob& job, const InView& bound, const Batch& batch, Planes& p, Waiting& waiting) {
  load_places(job, batch, p);
  for_lanes(batch.num_blocks, [&](int i) { p.kept[i] = may_be_seen(job.view, bound, load(p.mean, i), load(p.log_scale, i)); });
  int end = waiting.end;
  for (int i = 0; i < batch.count; ++i) {
    waiting.row[end] = batch.row[i];
    end += p.kept[i];
  }
  const int count = end - waiting.end;
  waiting.end = end;
  return count;
}

template <int DEGREE>
void draw_chunk(const ProjectJob& job, const InView& bound, int32_t* rows, int num_rows, Chunk& chunk) {
  Planes planes;
  Waiting waiting;
  waiting.begin = waiting.end = 0;
  for (int i = 0; i < num_rows; i += BATCH) {
    const Batch batch = batch_of(rows + i, smaller(BATCH, num_rows - i));
    // Squares of published codes reach farther than the bound knows: all of their rows are computed.
    const int before = waiting.end;
    if (!job.is_square && list_candidates(job, bound, batch, planes, waiting) < MOST) {
      draw_waiting<DEGREE>(job, BATCH, waiting, planes, chunk);
      continue;
    }
    waiting.end = before;
    draw_waiting<DEGREE>(job, 1, waiting, planes, chunk);
    draw_batch<DEGREE>(job, batch, planes, chunk);
  }
  draw_waiting<DEGREE>(job, 1, waiting, planes, chunk);
}

// Copies records past the caches.
void stream(float* to, const float* from, int64_t count) {
#ifdef __SSE2__
  for (int64_t i = 0; i < count; i += NUM_COLUMNS)
    for (int j = 0; j < NUM_COLUMNS; j += 4) _mm_stream_ps(to + i + j, _mm_load_ps(from + i + j));
  _mm_sfence();
#else
  memcpy(to, from, count * sizeof(float));
#endif
}

// Copies a chunk to its place.
void place(const ProjectJob& job, bool streams, const Chunk& chunk) {
  memcpy(job.out_rows + chunk.first, chunk.rows, chunk.count * sizeof(int32_t));
  memcpy(job.out_depths + chunk.first, chunk.depths, chunk.count * sizeof(float));
  float* records = job.out_records + chunk.first * NUM_COLUMNS;
  if (streams)
    stream(records, chunk.records, chunk.count * NUM_COLUMNS);
  else
    memcpy(records, chunk.records, chunk.count * sizeof(float) * NUM_COLUMNS);
}

template <int DEGREE>
void project_all(const ProjectJob& job, InOrder& results) {
  const int64_t num_chunks = (job.num_rows + CHUNK - 1) / CHUNK;
  const InView bound = in_view_of(job.view);
  const bool streams = job.num_rows >= STREAMED_ROWS && reinterpret_cast<uintptr_t>(job.out_records) % 64 == 0;
  parallel_chunks(num_chunks, job.threads, [&](int64_t index) {
    Chunk& chunk = *static_cast<Chunk*>(results.take());
    chunk.count = 0;
    int32_t rows[CHUNK + LANES];
    const int64_t begin = index * CHUNK;
    const int num_rows = int(begin + CHUNK < job.num_rows ? CHUNK : job.num_rows - begin);
    memcpy(rows, job.rows + begin, num_rows * sizeof(int32_t));
    draw_chunk<DEGREE>(job, bound, rows, num_rows, chunk);
    for (ChunkBuffer* done = results.finish(index, &chunk); done; done = results.give_back(done))
      place(job, streams, *static_cast<Chunk*>(done));
  });
}

}  // namespace

int64_t project_buffer_bytes() { return sizeof(Chunk); }

void project(const ProjectJob& job, InOrder& results) {
  switch (job.degree) {
    case 0:
      return project_all<0>(job, results);
    case 1:
      return project_all<1>(job, results);
    case 2:
      return project_all<2>(job, results);
    default:
      return project_all<3>(job, results);
  }
}

}  // namespace splatree::SPLATREE_ISA
