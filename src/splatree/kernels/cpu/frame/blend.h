// Job of the blending.
#pragma once
#include <cstdint>

namespace splatree {

struct BlendJob {
  const float* records;            // v splats
  const int64_t* tile_start;       // t + 1
  const int32_t* splat_from_pair;  // m
  int num_tiles_x, num_tiles_y;
  int width, height;     // px
  float log2_threshold;  // smallest opacity drawn at a pixel
  const float* floors;   // v, opacity at which each splat is tapered off; null: none is
  float background[3];
  float least_light;  // below which a pixel is finished, if neither depth nor anything of the kind is wanted
  bool whole_tile;    // evaluate all 4 × 4 px cells of a tile instead of those that the ellipse touches
  int threads;
  float* image;  // h w 3
  float* alpha;  // h w
  // Null where they are not wanted:
  float* depth;                                         // h w; wanted with any of the others
  float* contributions;                                 // m, Σ α T of each pair
  int64_t* last_pair;                                   // h w, index of the last pair that each pixel blended, -1 if none
  float* median_depth;                                  // h w, depth of the splat at which T falls below ½, 0 if it never does
  int64_t *num_consumed, *num_evaluated, *num_blended;  // a tile
};

}  // namespace splatree
