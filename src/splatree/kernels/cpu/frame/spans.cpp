// The tiles of each splat, 16 splats at a time in the order of depth, in which they are then counted and written. Spans of the
// first rows come from the vector loop; the few splats that have more go on row by row.
#include <stdlib.h>
#include <string.h>

#include "cpu/frame/bin.h"
#include "cpu/runtime/isa.h"
#include "cpu/runtime/quad.h"
#include "shared/ellipse.h"
#include "shared/record.h"

namespace splatree::SPLATREE_ISA {
namespace {

constexpr int LANES = 16;
constexpr int BATCH = 64;  // splats gathered at a time
constexpr int AHEAD = 32;  // splats between the fetch of a record and its use

struct alignas(64) Planes {
  float column[NUM_COLUMNS][BATCH];
  // Of the Ellipse.
  float k_squared[BATCH], c_squared[BATCH], skew[BATCH], inverse_a[BATCH], height[BATCH], dy_of_right[BATCH], margin[BATCH];
  int32_t first_row[BATCH], num_rows[BATCH];
  uint32_t tiles[1 + NEAR_ROWS][BATCH];  // SplatTiles, word by word
  float log2_threshold[BATCH];
  float nearest[BATCH];  // smallest |L d|² in a tile that the splat is not listed in
};

// Records into planes, four by four; the last is repeated to fill whole blocks, whose number is returned.
int load_records(const BinJob& job, int64_t begin, int64_t end, Planes& p) {
  const int used = end - begin < BATCH ? int(end - begin) : BATCH, num_blocks = (used + LANES - 1) / LANES;
  for (int i = 0; i < num_blocks * LANES; i += 4) {
    const float* record[4];
    for (int l = 0; l < 4; ++l) {
      record[l] = job.records + int64_t(job.order[begin + (i + l < used ? i + l : used - 1)]) * NUM_COLUMNS;
      if (begin + i + l + AHEAD < end) __builtin_prefetch(job.records + int64_t(job.order[begin + i + l + AHEAD]) * NUM_COLUMNS);
    }
    for (int j = 0; j < NUM_COLUMNS; j += 4) {
      Quad q[4];
      for (int l = 0; l < 4; ++l) q[l] = load_quad(record[l] + j);
      transpose(q[0], q[1], q[2], q[3]);
      for (int l = 0; l < 4; ++l) store_quad(&p.column[j + l][i], q[l]);
    }
  }
  return num_blocks;
}

Span* grow(Spans& spans, int num_rows) {
  if (spans.size + num_rows > spans.capacity) {
    spans.capacity = 2 * spans.capacity + num_rows + 1024;
    spans.data = static_cast<Span*>(realloc(spans.data, spans.capacity * sizeof(Span)));
    if (!spans.data) abort();
  }
  Span* first = spans.data + spans.size;
  spans.size += num_rows;
  return first;
}

// Appends the spans of a splat of several rows, eight at a time; returns the smallest |L d|² in a tile beside them.
template <bool FLOORS>
float list_rows(const BinJob& job, const Ellipse& e, int first_row, int num_rows, Spans& spans) {
  constexpr int ROWS = 8;
  float nearest = FAR;
  const float width = job.width, height = job.height;
  Span* out = grow(spans, num_rows);
  for (int begin = 0; begin < num_rows; begin += ROWS) {
    int32_t first[ROWS], end[ROWS];
    float beside[ROWS];
#pragma omp simd
    for (int r = 0; r < ROWS; ++r) {
      const Interval strip = strip_of(first_row + begin + r, height);
      const Tiles columns = tiles_in(reach_of(e, strip.low, strip.high), width);
      first[r] = columns.first, end[r] = columns.end;
      if constexpr (FLOORS) beside[r] = nearest_beside(e, columns, strip, job.num_tiles_x);
    }
    for (int r = 0; r < ROWS && begin + r < num_rows; ++r) {
      out[begin + r] = {uint16_t(first[r]), uint16_t(end[r])};
      if (FLOORS) nearest = least(beside[r], nearest);
    }
  }
  return nearest;
}

// Appends the same span for each row.
void repeat_span(Span span, int num_rows, Spans& spans) {
  Span* out = grow(spans, num_rows);
  for (int row = 0; row < num_rows; ++row) out[row] = span;
}

SPLATREE_FN uint32_t word_of(int low, int high) { return uint32_t(low) | uint32_t(high) << 16; }

SPLATREE_FN Ellipse ellipse_at(const Planes& p, int i) {
  return {p.column[X][i], p.column[Y][i], p.k_squared[i],   p.c_squared[i], p.skew[i],
          p.inverse_a[i], p.height[i],    p.dy_of_right[i], p.margin[i]};
}

// The tiles of lane i's ellipse in the first of its rows, or of its box.
template <TileRule RULE>
SPLATREE_FN void cover_ellipse(const BinJob& job, int i, Planes& p) {
  const float width = job.width, height = job.height;
  const float log2_threshold =
      log2_threshold_of(job.log2_threshold, job.area_power, p.column[FACTOR_A][i], p.column[FACTOR_C][i]);
  const Ellipse e =
      ellipse_of(p.column[X][i], p.column[Y][i], p.column[FACTOR_A][i], p.column[FACTOR_B][i], p.column[FACTOR_C][i],
                 p.column[LOG2_OPACITY][i], p.column[HALF_SIZE_X][i], p.column[HALF_SIZE_Y][i], log2_threshold);
  p.log2_threshold[i] = log2_threshold;
  p.k_squared[i] = e.k_squared, p.c_squared[i] = e.c_squared, p.skew[i] = e.skew;
  p.inverse_a[i] = e.inverse_a, p.height[i] = e.height, p.dy_of_right[i] = e.dy_of_right, p.margin[i] = e.margin;
  const Tiles rows = tiles_in({e.y - e.height - e.margin, e.y + e.height + e.margin}, height);
  const int num_rows = rows.end - rows.first;
#pragma GCC unroll 3
  for (int r = 0; r < NEAR_ROWS; ++r) {
    const Interval strip = strip_of(rows.first + r, height);
    const float box = p.column[HALF_SIZE_X][i] + e.margin;
    const Interval reach = RULE == TileRule::BOX ? Interval{e.x - box, e.x + box} : reach_of(e, strip.low, strip.high);
    const Tiles columns = tiles_in(reach, width);
    p.tiles[1 + r][i] = r < num_rows ? word_of(columns.first, columns.end) : 0;
  }
  p.first_row[i] = rows.first, p.num_rows[i] = num_rows;
  p.tiles[0][i] = word_of(rows.first, num_rows);
}

// The smallest |L d|² of lane i's ellipse in a tile around those of its first rows.
SPLATREE_FN void find_nearest(const BinJob& job, int i, Planes& p) {
  const Ellipse e = ellipse_at(p, i);
  const float height = job.height;
  const int first_row = p.first_row[i], num_rows = p.num_rows[i];
  float nearest = nearest_above_or_below(e, {first_row, first_row + num_rows}, job.num_tiles_y);
#pragma GCC unroll 3
  for (int r = 0; r < NEAR_ROWS; ++r) {
    const uint32_t word = p.tiles[1 + r][i];
    const Tiles columns = {int(word & 0xffff), int(word >> 16)};
    const float beside = nearest_beside(e, columns, strip_of(first_row + r, height), job.num_tiles_x);
    nearest = least(r < num_rows ? beside : FAR, nearest);
  }
  p.nearest[i] = nearest;
}

// The tiles of lane i's square.
SPLATREE_FN void cover_square(const BinJob& job, int i, Planes& p) {
  const float half_side = half_side_of_factor(job.square, p.column[FACTOR_A][i], p.column[FACTOR_B][i], p.column[FACTOR_C][i],
                                              p.column[LOG2_OPACITY][i]);
  const Side across = side_of(p.column[X][i], half_side, job.num_tiles_x);
  const Side down = side_of(p.column[Y][i], half_side, job.num_tiles_y);
  const int first_row = int(down.first), num_rows = int(down.end) - first_row;
  p.first_row[i] = first_row, p.num_rows[i] = num_rows;
  p.tiles[0][i] = word_of(first_row, num_rows);
#pragma GCC unroll 3
  for (int r = 0; r < NEAR_ROWS; ++r) p.tiles[1 + r][i] = r < num_rows ? word_of(int(across.first), int(across.end)) : 0;
}

// Appends the spans of lane i, which has many rows; returns the smallest |L d|² in a tile beside them.
template <TileRule RULE, bool FLOORS>
float list_far_rows(const BinJob& job, int i, const Planes& p, Spans& spans) {
  const int num_rows = p.num_rows[i];
  if (RULE == TileRule::ELLIPSE) return list_rows<FLOORS>(job, ellipse_at(p, i), p.first_row[i], num_rows, spans);
  repeat_span({uint16_t(p.tiles[1][i]), uint16_t(p.tiles[1][i] >> 16)}, num_rows, spans);
  return FAR;
}

template <TileRule RULE, bool FLOORS>
void list_all(const BinJob& job, int64_t begin, int64_t end, SplatTiles* tiles, Spans& spans) {
  Planes p;
  for (int64_t batch = begin; batch < end; batch += BATCH) {
    const int num_blocks = load_records(job, batch, end, p);
    for (int block = 0; block < num_blocks; ++block) {
#pragma omp simd
      for (int i = block * LANES; i < (block + 1) * LANES; ++i) {
        if constexpr (RULE == TileRule::SQUARE)
          cover_square(job, i, p);
        else
          cover_ellipse<RULE>(job, i, p);
      }
    }
    if constexpr (FLOORS) {
#pragma omp simd
      for (int i = 0; i < num_blocks * LANES; ++i) find_nearest(job, i, p);
    }
    const int used = end - batch < BATCH ? int(end - batch) : BATCH;
    for (int i = 0; i < used; ++i) {
      SplatTiles& t = tiles[batch - begin + i];
      const uint32_t words[1 + NEAR_ROWS] = {p.tiles[0][i], p.tiles[1][i], p.tiles[2][i], p.tiles[3][i]};
      memcpy(&t, words, sizeof t);
      if (p.num_rows[i] > NEAR_ROWS) {
        t.first_span = spans.size;
        const float beside = list_far_rows<RULE, FLOORS>(job, i, p, spans);
        if (FLOORS) p.nearest[i] = least(beside, p.nearest[i]);
      }
      if (FLOORS) job.floors[job.order[batch + i]] = floor_of(p.column[LOG2_OPACITY][i], p.nearest[i], p.log2_threshold[i]);
    }
  }
}

}  // namespace

void list_spans(const BinJob& job, int64_t begin, int64_t end, SplatTiles* tiles, Spans& spans) {
  switch (job.tile_rule) {
    case TileRule::ELLIPSE:
      return job.floors ? list_all<TileRule::ELLIPSE, true>(job, begin, end, tiles, spans)
                        : list_all<TileRule::ELLIPSE, false>(job, begin, end, tiles, spans);
    case TileRule::BOX:
      return list_all<TileRule::BOX, false>(job, begin, end, tiles, spans);
    case TileRule::SQUARE:
      return list_all<TileRule::SQUARE, false>(job, begin, end, tiles, spans);
  }
}

}  // namespace splatree::SPLATREE_ISA
