// Job of the binning: which tiles each splat touches, and the scatter to tiles.
#pragma once
#include <cstdint>

namespace splatree {

struct BinJob {
  const float* records;  // v splats
  const int32_t* order;  // v
  int64_t num_splats;
  float log2_threshold;
  int width, height;  // px
  int num_tiles_x, num_tiles_y;
  bool whole_box;  // all tiles of the box instead of those of the ellipse
  int threads;
};

// Fills tile_start (t + 1) and returns the splats of all tiles, tile_start[t] of them, to be freed with delete[].
int32_t* bin(const BinJob& job, int64_t* tile_start);

}  // namespace splatree
