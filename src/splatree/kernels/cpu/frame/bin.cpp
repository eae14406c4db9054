// Stable counting scatter of depth-ordered splats to tiles.
//
// Chunks of the depth order find the tiles of their splats and count them, the counts become places (tile by tile, in a tile
// chunk by chunk), and each chunk writes its pairs there: every tile's list is in depth order for any number of threads and
// chunks. A span of columns is counted by its two ends, +1 where it begins and -1 where it is over; sums along the rows of
// tiles are the counts.
#include <algorithm>
#include <cstdlib>
#include <stdexcept>
#include <vector>

#include "cpu/frame/scatter.h"
#include "cpu/runtime/isa.h"
#include "cpu/runtime/pool.h"

namespace splatree {
namespace {

// What is known of a chunk of splats besides their tiles.
struct Chunk {
  std::vector<Spans> spans;     // of those with many rows, SPAN_CHUNK splats together
  std::vector<uint32_t> place;  // of the next pair of each tile; before that, by how many pairs it has more than the tile before

  ~Chunk() {
    for (Spans& s : spans) std::free(s.data);
  }

  const Span* rows_of(const SplatTiles& t, int64_t i) const {
    return t.num_rows <= NEAR_ROWS ? t.span : spans[i / SPAN_CHUNK].data + t.first_span;
  }
};

// Finds the tiles of splats begin to end, and counts them.
void list_chunk(const BinJob& job, int64_t begin, int64_t end, SplatTiles* tiles, Chunk& chunk) {
  // A span may be over behind the last column; empty spans after the last row may lie below the picture.
  const int64_t stride = job.num_tiles_x + 1, size = (job.num_tiles_y + NEAR_ROWS) * stride;
  std::vector<uint32_t> begun(size, 0), over(size, 0);
  chunk.spans.assign((end - begin + SPAN_CHUNK - 1) / SPAN_CHUNK, Spans{nullptr, 0, 0});
  for (int64_t first = begin; first < end; first += SPAN_CHUNK) {
    const int64_t last = std::min(first + SPAN_CHUNK, end);
    kernels().list_spans(job, first, last, tiles + first, chunk.spans[(first - begin) / SPAN_CHUNK]);
    for (int64_t i = first; i < last; ++i) {
      const SplatTiles& t = tiles[i];
      const Span* span = chunk.rows_of(t, i - begin);
      // Empty spans cancel out; a loop over the rows that there are would be mispredicted at every other splat.
      const int num_rows = t.num_rows <= NEAR_ROWS ? NEAR_ROWS : t.num_rows;
      int64_t row = t.first_row * stride;
      for (int r = 0; r < num_rows; ++r, row += stride) ++begun[row + span[r].first], ++over[row + span[r].end];
    }
  }
  for (int64_t k = 0; k < size; ++k) begun[k] -= over[k];
  chunk.place.swap(begun);
}

}  // namespace

Scratch<int32_t> bin(const BinJob& job, int64_t* tile_start) {
  const int64_t grain = std::max<int64_t>(16384, (job.num_splats / 16 / SPAN_CHUNK + 1) * SPAN_CHUNK);
  std::vector<Chunk> chunks((job.num_splats + grain - 1) / grain);
  const Scratch<SplatTiles> tiles = allocate<SplatTiles>(job.num_splats);
  parallel_ranges(job.num_splats, grain, job.threads,
                  [&](int64_t begin, int64_t end) { list_chunk(job, begin, end, tiles.get(), chunks[begin / grain]); });

  const int64_t stride = job.num_tiles_x + 1;
  int64_t total = 0;
  std::vector<uint32_t> count(chunks.size());
  for (int y = 0; y < job.num_tiles_y; ++y) {
    std::fill(count.begin(), count.end(), 0);
    for (int x = 0; x < job.num_tiles_x; ++x) {
      tile_start[int64_t(y) * job.num_tiles_x + x] = total;
      for (size_t c = 0; c < chunks.size(); ++c) {
        uint32_t& place = chunks[c].place[y * stride + x];
        count[c] += place;
        place = uint32_t(total);
        total += count[c];
      }
    }
  }
  tile_start[int64_t(job.num_tiles_x) * job.num_tiles_y] = total;
  if (total > UINT32_MAX) throw std::length_error("more than 2^32 pairs of splat and tile: draw fewer splats or fewer pixels");

  Scratch<int32_t> splat_from_pair = allocate<int32_t>(total);
  int32_t* pairs = splat_from_pair.get();
  parallel_ranges(job.num_splats, grain, job.threads, [&](int64_t begin, int64_t end) {
    Chunk& chunk = chunks[begin / grain];
    for (int64_t i = begin; i < end; ++i) {
      const SplatTiles& t = tiles[i];
      const Span* span = chunk.rows_of(t, i - begin);
      const int32_t splat = job.order[i];
      uint32_t* row = chunk.place.data() + t.first_row * stride;
      for (int r = 0; r < t.num_rows; ++r, row += stride)
        for (int x = span[r].first; x < span[r].end; ++x) pairs[row[x]++] = splat;
    }
  });
  return splat_from_pair;
}

}  // namespace splatree
