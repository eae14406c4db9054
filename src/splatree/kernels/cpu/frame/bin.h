// Jobs of the binning: the tiles of each splat (spans.cpp) and the scatter to tiles (bin.cpp).
#pragma once
#include <cstdint>

#include "shared/square.h"

namespace splatree {

// A span of columns in a row of tiles.
struct Span {
  uint16_t first, end;
};

constexpr int NEAR_ROWS = 3;  // whose spans are kept with the splat: nearly all splats have no more

// The tiles of one splat: a span in each of its rows. Rows after the last have an empty span.
struct SplatTiles {
  uint16_t first_row, num_rows;
  union {
    Span span[NEAR_ROWS];
    uint32_t first_span;  // of its rows in the spans of its chunk, if there are more
  };
};

// The spans of the splats of a chunk that have many rows.
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
  int width, height;                 // px
  int num_tiles_x, num_tiles_y;
  TileRule tile_rule;
  Square square;
  int threads;
  float* floors;  // v, opacity at which each splat ends; null: not asked for
};

}  // namespace splatree
