// Stable counting scatter of depth-ordered splats to tiles.
//
// Chunks of the order count their pairs for each tile, the counts become places (tile by tile, in a tile chunk by chunk), and
// each chunk writes its pairs there: every tile's list is in depth order for any number of threads and chunks.
#include "cpu/bin.h"

#include <algorithm>
#include <cmath>
#include <vector>

#include "cpu/pool.h"
#include "shared/ellipse.h"

namespace splatree {
namespace {

constexpr float TILE = 16.f;

struct Span {
  int first, end;  // tiles
};

// Tiles whose pixel centres, 16 i + ½ to 16 i + 15½, meet [low, high]; of num tiles that hold `size` pixels.
Span tiles_between(float low, float high, int num, float size) {
  if (!(high >= 0.5f && low <= size - 0.5f)) return {0, 0};
  const float first = std::ceil((std::max(low, 0.f) - (TILE - 0.5f)) / TILE);
  const float last = std::floor((std::min(high, size) - 0.5f) / TILE);
  return {std::max(int(first), 0), std::min(int(last) + 1, num)};
}

// Calls visit(tile) for each tile that the splat touches. Not inlined: counting and writing must run the same code, since
// another contraction of multiply and add could put a tile on the other side.
template <class Visit>
__attribute__((noinline)) void visit_spans(const BinJob& job, int32_t index, Visit& visit) {
  const float* record = job.records + int64_t(index) * NUM_COLUMNS;
  const Ellipse e = ellipse_of(record, job.log2_threshold);
  const float half_height = job.whole_box ? record[EXTENT_Y] + e.margin : e.height + e.margin;
  const Span rows = tiles_between(e.y - half_height, e.y + half_height, job.num_tiles_y, job.height);
  for (int row = rows.first; row < rows.end; ++row) {
    float left = record[EXTENT_X] + e.margin, right = left;
    if (!job.whole_box) {
      const float top = TILE * row + 0.5f - e.y, bottom = std::min(TILE * (row + 1), float(job.height)) - 0.5f - e.y;
      left = reach_of(e, -1.f, top, bottom);
      right = reach_of(e, 1.f, top, bottom);
    }
    const Span columns = tiles_between(e.x - left, e.x + right, job.num_tiles_x, job.width);
    for (int column = columns.first; column < columns.end; ++column) visit(row * job.num_tiles_x + column);
  }
}

}  // namespace

int32_t* bin(const BinJob& job, int64_t* tile_start) {
  const int64_t num_tiles = int64_t(job.num_tiles_x) * job.num_tiles_y;
  const int64_t grain = std::max<int64_t>(4096, (job.num_splats + 15) / 16);
  const int64_t num_chunks = (job.num_splats + grain - 1) / grain;
  std::vector<int64_t> place(num_chunks * num_tiles, 0);
  int32_t* pairs = nullptr;

  // One visitor for both passes, hence one instance of visit_spans.
  struct Visitor {
    int64_t* place;
    int32_t* pairs;  // null while counting
    int32_t splat;
    void operator()(int64_t tile) {
      if (pairs) pairs[place[tile]] = splat;
      ++place[tile];
    }
  };
  auto pass = [&](int64_t begin, int64_t end) {
    Visitor visitor{&place[begin / grain * num_tiles], pairs, 0};
    for (int64_t i = begin; i < end; ++i) {
      visitor.splat = job.order[i];
      visit_spans(job, visitor.splat, visitor);
    }
  };
  parallel_ranges(job.num_splats, grain, job.threads, pass);
  int64_t total = 0;
  for (int64_t t = 0; t < num_tiles; ++t) {
    tile_start[t] = total;
    for (int64_t c = 0; c < num_chunks; ++c) {
      const int64_t count = place[c * num_tiles + t];
      place[c * num_tiles + t] = total;
      total += count;
    }
  }
  tile_start[num_tiles] = total;
  pairs = new int32_t[total];
  parallel_ranges(job.num_splats, grain, job.threads, pass);
  return pairs;
}

}  // namespace splatree
