// Inner products, 16 lanes at a time: the scores of four points against all blocks of centres, and coordinates along axes.
//
// A block of d dimensions costs 4 · 16 · d multiply-adds for 16 · d loads; the comparison comes once a block. The lanes are
// explicit vectors of the compiler here: scores and minima have to stay in registers from one loop to the next, which loops over
// arrays do not reach (a fifth of the speed, measured).
#include "cpu/codec/scores.h"

#include "cpu/runtime/isa.h"

namespace splatree::SPLATREE_ISA {
namespace {

#if defined(__AVX512F__)
constexpr int WIDTH = 16;
#elif defined(__AVX__)
constexpr int WIDTH = 8;
#else
constexpr int WIDTH = 4;
#endif
constexpr int PARTS = LANES / WIDTH;

typedef float Floats __attribute__((vector_size(4 * WIDTH)));
typedef int32_t Ints __attribute__((vector_size(4 * WIDTH)));
typedef float Unaligned __attribute__((vector_size(4 * WIDTH), aligned(4), may_alias));

inline __attribute__((always_inline)) Floats load(const float* values) { return *reinterpret_cast<const Unaligned*>(values); }

struct Minima {
  Floats least[POINTS_AT_ONCE][PARTS];
  Ints block[POINTS_AT_ONCE][PARTS];
};

// Of equal scores in a lane the first block's counts.
inline __attribute__((always_inline)) void search(const Centres& centres, const float* const* points, Minima& minima) {
  const int64_t dims = centres.dims;
  const float *p0 = points[0], *p1 = points[1], *p2 = points[2], *p3 = points[3];
  Floats least[POINTS_AT_ONCE][PARTS];
  Ints at[POINTS_AT_ONCE][PARTS] = {};
  for (int p = 0; p < POINTS_AT_ONCE; ++p)
    for (int part = 0; part < PARTS; ++part) least[p][part] = Floats{} + __builtin_inff();

  for (int64_t b = 0; b < centres.num_blocks; ++b) {
    const float* lanes = centres.blocks + b * (dims + 1) * LANES;
    Floats score[POINTS_AT_ONCE][PARTS];
    for (int p = 0; p < POINTS_AT_ONCE; ++p)
      for (int part = 0; part < PARTS; ++part) score[p][part] = load(lanes + dims * LANES + part * WIDTH);
    for (int64_t d = 0; d < dims; ++d, lanes += LANES) {
      const float x[POINTS_AT_ONCE] = {p0[d], p1[d], p2[d], p3[d]};
      for (int part = 0; part < PARTS; ++part) {
        const Floats centre = load(lanes + part * WIDTH);
        for (int p = 0; p < POINTS_AT_ONCE; ++p) score[p][part] -= x[p] * centre;
      }
    }
    for (int p = 0; p < POINTS_AT_ONCE; ++p)
      for (int part = 0; part < PARTS; ++part) {
        const Ints nearer = score[p][part] < least[p][part];
        least[p][part] = nearer ? score[p][part] : least[p][part];
        at[p][part] = nearer ? Ints{} + static_cast<int32_t>(b) : at[p][part];
      }
  }
  __builtin_memcpy(minima.least, least, sizeof least);
  __builtin_memcpy(minima.block, at, sizeof at);
}

}  // namespace

void nearest_lanes(const Centres& centres, const float* const* points, LaneMinima* minima) {
  Minima found;
  search(centres, points, found);
  __builtin_memcpy(minima->score, found.least, sizeof minima->score);
  __builtin_memcpy(minima->block, found.block, sizeof minima->block);
}

// Of equal scores the centre with the lowest number counts.
void nearest_centres(const Centres& centres, const float* const* points, NearestCentres* nearest) {
  Minima found;
  search(centres, points, found);
  Ints lane;
  for (int l = 0; l < WIDTH; ++l) lane[l] = l;
  for (int p = 0; p < POINTS_AT_ONCE; ++p) {
    Floats least = found.least[p][0];
    for (int part = 1; part < PARTS; ++part) {
      const Ints less = found.least[p][part] < least;
      least = less ? found.least[p][part] : least;
    }
    float score = least[0];
    for (int l = 1; l < WIDTH; ++l) score = least[l] < score ? least[l] : score;
    Ints number = Ints{} + INT32_MAX;
    for (int part = 0; part < PARTS; ++part) {
      const Ints centre = found.block[p][part] * static_cast<int32_t>(LANES) + (lane + part * WIDTH);
      const Ints taken = (found.least[p][part] == score) & (centre < number);
      number = taken ? centre : number;
    }
    int32_t centre = number[0];
    for (int l = 1; l < WIDTH; ++l) centre = number[l] < centre ? number[l] : centre;
    nearest->score[p] = score;
    nearest->centre[p] = centre;
  }
}

void onto_axes(const AxesJob& job, int64_t begin, int64_t end) {
  const int64_t padded = (job.dims + LANES - 1) / LANES * LANES;
  for (int64_t i = begin; i < end; ++i) {
    const float* vector = job.vectors + i * job.stride;
    for (int64_t first = 0; first < job.dims; first += LANES) {
      Floats sums[PARTS] = {};
      for (int64_t j = 0; j < job.width; ++j) {
        const float x = vector[j] - job.origin[j];
        for (int part = 0; part < PARTS; ++part) sums[part] += x * load(job.axes + j * padded + first + part * WIDTH);
      }
      float lanes[LANES];
      __builtin_memcpy(lanes, sums, sizeof lanes);
      float* out = job.out + i * job.dims + first;
      const int64_t count = job.dims - first < LANES ? job.dims - first : LANES;
      for (int64_t l = 0; l < count; ++l) out[l] = lanes[l];
    }
  }
}

}  // namespace splatree::SPLATREE_ISA
