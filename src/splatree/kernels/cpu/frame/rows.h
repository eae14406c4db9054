// Rows of three or four floats in memory into planes, four rows at a time.
#pragma once
#include <cstdint>

#include "cpu/runtime/quad.h"
#include "shared/portable.h"

namespace splatree {
namespace {

// Rows that follow each other, so many, a multiple of four.
template <int WIDTH, int BATCH>
void load_run(const float* first, int count, float (*planes)[BATCH]) {
  for (int i = 0; i < count; i += 4) {
    const float* from = first + WIDTH * i;
    Quad a = load_quad(from), b = load_quad(from + 4), c = load_quad(from + 8), d;
    if (WIDTH == 4) d = load_quad(from + 12), transpose(a, b, c, d), store_quad(&planes[3][i], d);
    if (WIDTH == 3) transpose_triples(a, b, c);
    store_quad(&planes[0][i], a), store_quad(&planes[1][i], b), store_quad(&planes[2][i], c);
  }
}

// Four rows anywhere.
struct Four {
  int64_t row[4];
};

inline Four four_of(const int32_t* row) { return {{row[0], row[1], row[2], row[3]}}; }

// The first WIDTH floats of each, `stride` floats apart in memory, to places i to i + 3 of the planes.
template <int WIDTH, int BATCH>
SPLATREE_FN void load_four(const float* column, const Four& rows, int64_t stride, int i, float (*planes)[BATCH]) {
  Quad q[4];
  for (int j = 0; j < 4; ++j) {
    const float* from = column + rows.row[j] * stride;
    q[j] = WIDTH == 4 ? load_quad(from) : load_triple(from);
  }
  transpose(q[0], q[1], q[2], q[3]);
  for (int j = 0; j < WIDTH; ++j) store_quad(&planes[j][i], q[j]);
}

}  // namespace
}  // namespace splatree
