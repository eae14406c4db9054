// What every kernel of a frame gets: one struct in device memory, so that a recorded frame can be replayed with other numbers.
//
// The numbers of the view are laid out by the compiler of the CPU core (kernels/cpu/frame/bind_cuda.cpp), the arrays by
// kernels/cuda/job.py, which reads their names and types from the lines `Global<...> name;` below.
#pragma once
#include "shared/select.h"

namespace splatree {

// What the selection and the drawing ask of a view.
struct FrameNumbers {
  View view;  // its log2_threshold is of the smallest opacity at which any splat ends
  SelectRule rule;
  ViewPlanes planes;
  double reach[NUM_SIDES];
  double eye[3];
  int view_test;  // of enum ViewTest
  int all_small;  // τ_R is infinite
  int cull;       // whether blocks are tested against the image
  int degree;     // of harmonics evaluated
  int width, height, num_tiles_x, num_tiles_y;
  float background[3];
  float log2_threshold, area_power;  // of τ; how it falls with a splat's area
  float log2_pixel_threshold;        // of the smallest opacity that is drawn at a pixel
  int tile_rule;                     // of enum TileRule
  Square square;                     // if that is what it is
};

// Counts that kernels leave; the first four may exceed what the arrays hold: then the frame is drawn again with larger ones.
enum Counter {
  NUM_SELECTED,  // rows of the visible cut
  NUM_PAIRS,     // pairs of splat and tile
  NUM_VISITED,   // rows looked at by the selection
  NUM_VISIBLE,   // splats that touch the image
  NUM_OPEN,      // blocks that the selection has to look into
  NUM_FRONTIER,  // rows of the next level (serial baseline)
  NUM_COUNTERS = 8,
};

}  // namespace splatree

#ifdef SPLATREE_DEVICE
namespace splatree {

struct FrameJob {
  FrameNumbers numbers;
  // The scene: n rows, their tree, its b blocks.
  Global<const float> means;                 // n 3
  Global<const float4> quats;                // n
  Global<const float> log_scales;            // n 3
  Global<const float> logit_opacities;       // n
  Global<const float> sh;                    // n k 3
  Global<const float4> curves;               // n; of length 0 where all rows are drawn as stored
  Global<const float> extents;               // n
  Global<const int> subtree_end;             // n
  Global<const unsigned> ids;                // n; of length 0 where rows are their own
  Global<const float> block_lower;           // b 3
  Global<const float> block_upper;           // b 3
  Global<const float> leaf_scales;           // b
  Global<const float> min_logits;            // b
  Global<const unsigned char> size_classes;  // n
  Global<const int> ancestor_start;          // b + 1
  Global<const int> ancestors;
  // Selection.
  Global<int4> open_blocks;     // b: block, shadow, largest small class, 1 if it lies inside the image
  Global<unsigned> kept_masks;  // b words_per_block
  Global<unsigned> num_kept;    // b
  Global<unsigned> first_kept;  // b
  Global<int> rows;             // v
  // Splats: a record of 16 floats each, the order, and the two sides of the sort.
  Global<float4> records;       // v 4
  Global<unsigned> depth_keys;  // v; all ones: not visible
  Global<float> floors;         // v, opacity at which each is tapered off
  Global<unsigned> order;       // v: splats from the nearest to the farthest
  Global<unsigned> keys_a;      // v; max(v, m) where tiles need more than 16 bits
  Global<unsigned> keys_b;
  Global<unsigned short> tile_keys_a;  // m, where tiles need no more than 16 bits
  Global<unsigned short> tile_keys_b;
  Global<unsigned> values_a;  // max(v, m)
  Global<unsigned> values_b;
  Global<unsigned> tile_start;  // t + 1
  Global<unsigned> tile_order;  // t: tiles in the order in which thread blocks take them
  Global<float> contributions;  // m
  // Picture.
  Global<float> image;                   // h w 3
  Global<float> alpha;                   // h w
  Global<float> depth;                   // h w
  Global<int> last_pair;                 // h w, the last pair that was blended, -1 if none
  Global<float> median_depth;            // h w, of the splat at which the transmittance falls below ½
  Global<unsigned long long> tile_work;  // t 3: consumed, evaluated, blended
  // Cleared before each frame.
  Global<unsigned long long> counters;  // NUM_COUNTERS
  Global<unsigned> tickets;             // one a scan of the frame, one a pass of a sort
  Global<unsigned> histograms;          // 256 a pass of a sort
  Global<unsigned long long> sweeps;    // 256 a pass and tile of a sort
  Global<unsigned long long> chains;    // chain_stride a scan of the frame
  // Backward: derivatives by the picture, sums, derivatives by the rows of the splats.
  Global<const float> by_image;      // h w 3
  Global<const float> by_alpha;      // h w
  Global<const float> by_depth;      // h w
  Global<const float> pixel_errors;  // h w
  Global<float> pair_sums;           // m NUM_SUMS
  Global<float> splat_sums;          // v NUM_SUMS
  Global<float> by_means;            // v 3
  Global<float> by_quats;            // v 4
  Global<float> by_log_scales;       // v 3
  Global<float> by_logit_opacities;  // v
  Global<float> by_sh;               // v k 3
  // Baselines.
  Global<const int> ancestor_table;  // n num_levels, root first, -1 behind the last
  Global<unsigned char> states;      // n
  Global<const int> children;        // rows by level, children of one node together
  Global<const int> first_child;     // n
  Global<const int> num_children;    // n
  Global<int> frontier_a;            // n
  Global<int> frontier_b;            // n
  // Sizes.
  long long num_rows;
  long long num_blocks;
  long long rows_per_block;
  long long words_per_block;
  long long row_capacity;
  long long pair_capacity;
  long long num_coefficients;  // of sh, a channel
  long long follows;           // whether there are curves
  long long chain_stride;
  long long num_levels;
  long long num_roots;
};

}  // namespace splatree
#endif
