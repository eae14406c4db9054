// Stable counting scatter of depth-ordered splats to tiles.
//
// First the tiles of each splat, in the order of memory. Then chunks of the depth order count their pairs for each tile, the
// counts become places (tile by tile, in a tile chunk by chunk), and each chunk writes its pairs there: every tile's list is
// in depth order for any number of threads and chunks.
#include "cpu/scatter.h"

#include <algorithm>
#include <cstdlib>
#include <stdexcept>
#include <vector>

#include "cpu/isa.h"
#include "cpu/pool.h"

namespace splatree {
namespace {

constexpr int AHEAD = 16;  // splats between the fetch of an entry and its use

// The tiles of all splats.
class Cover {
 public:
  explicit Cover(const BinJob& job)
      : tiles_(allocate<SplatTiles>(job.num_splats)),
        spans_((job.num_splats + SPAN_CHUNK - 1) / SPAN_CHUNK, Spans{nullptr, 0, 0}) {
    parallel_ranges(job.num_splats, SPAN_CHUNK, job.threads, [&](int64_t begin, int64_t end) {
      kernels().list_spans(job, begin, end, tiles_.get() + begin, spans_[begin / SPAN_CHUNK]);
    });
  }
  ~Cover() {
    for (Spans& spans : spans_) std::free(spans.data);
  }

  void prefetch(int32_t splat) const { __builtin_prefetch(tiles_.get() + splat); }

  // Calls visit(row, span) for each row of a splat.
  template <class Visit>
  void each_row(int32_t splat, const Visit& visit) const {
    const SplatTiles& t = tiles_[splat];
    if (t.num_rows == 0) return;
    if (t.num_rows == 1) return visit(t.first_row, t.span);
    const Span* spans = spans_[splat / SPAN_CHUNK].data + t.first_span;
    for (int row = 0; row < t.num_rows; ++row) visit(t.first_row + row, spans[row]);
  }

 private:
  Scratch<SplatTiles> tiles_;
  std::vector<Spans> spans_;
};

}  // namespace

Scratch<int32_t> bin(const BinJob& job, int64_t* tile_start) {
  const Cover cover(job);
  const int64_t num_tiles = int64_t(job.num_tiles_x) * job.num_tiles_y;
  const int64_t grain = std::max<int64_t>(16384, (job.num_splats + 15) / 16);
  const int64_t num_chunks = (job.num_splats + grain - 1) / grain;
  std::vector<uint32_t> places(num_chunks * num_tiles, 0);

  // Calls visit(splat, place) with the place of the tile in its chunk, for each pair in order.
  auto each_pair = [&](const auto& visit) {
    parallel_ranges(job.num_splats, grain, job.threads, [&](int64_t begin, int64_t end) {
      uint32_t* place = &places[begin / grain * num_tiles];
      for (int64_t i = begin; i < end; ++i) {
        if (i + AHEAD < end) cover.prefetch(job.order[i + AHEAD]);
        const int32_t splat = job.order[i];
        cover.each_row(splat, [&](int row, Span span) {
          uint32_t* tile = place + int64_t(row) * job.num_tiles_x;
          for (int column = span.first; column < span.end; ++column) visit(splat, tile[column]);
        });
      }
    });
  };

  each_pair([](int32_t, uint32_t& place) { ++place; });
  int64_t total = 0;
  for (int64_t tile = 0; tile < num_tiles; ++tile) {
    tile_start[tile] = total;
    for (int64_t chunk = 0; chunk < num_chunks; ++chunk) {
      const uint32_t count = places[chunk * num_tiles + tile];
      places[chunk * num_tiles + tile] = uint32_t(total);
      total += count;
    }
  }
  tile_start[num_tiles] = total;
  if (total > UINT32_MAX)
    throw std::length_error("more than 2^32 pairs of splat and tile: draw fewer splats or fewer pixels");
  Scratch<int32_t> splat_from_pair = allocate<int32_t>(total);
  int32_t* pairs = splat_from_pair.get();
  each_pair([pairs](int32_t splat, uint32_t& place) { pairs[place++] = splat; });
  return splat_from_pair;
}

}  // namespace splatree
