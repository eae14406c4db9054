// Jobs of the binning: the tiles of each splat (spans.cpp) and the scatter to tiles (bin.cpp).
#pragma once
#include <cstdint>

#include "shared/square.h"

namespace splatree {

// The tiles of one splat: a span of columns in each of its rows.
struct Span {
  uint16_t first, end;  // columns
};

struct SplatTiles {
  uint16_t first_row, num_rows;
  union {
    Span span;            // of the row, if there is one
    uint32_t first_span;  // of the rows in the chunk's spans, if there are more
  };
};

// The spans of the splats of a chunk that have several rows.
struct Spans {
  Span* data;  // from malloc, or null
  uint32_t size, capacity;
};

constexpr int64_t SPAN_CHUNK = 4096;  // splats

struct BinJob {
  const float* records;  // v splats
  const int32_t* order;  // v
  int64_t num_splats;
  float log2_threshold, area_power;  // of τ; how it falls with a splat's area
  int width, height;  // px
  int num_tiles_x, num_tiles_y;
  Extent extent;
  Square square;
  int threads;
  float* floors;  // v, opacity at which each splat ends; null: not asked for
};

}  // namespace splatree
