// The rules of published methods as a flag for each row, and the first rows on all paths that a flag stops; lod/baselines.py says
// what the rules are and where they are from. Every function goes once over all rows, as the methods' own kernels do.
#include "cpu/frame/baselines.h"

#include <cmath>

#include "cpu/runtime/pool.h"

namespace splatree {
namespace {

constexpr int64_t GRAIN = 1 << 15;

float square(float x) { return x * x; }

float least(float a, float b) { return a < b ? a : b; }

float greatest(float a, float b) { return a > b ? a : b; }

}  // namespace

void flag_small_boxes(const float* lower, const float* upper, int64_t num_rows, const float* eye, float limit, int threads,
                      uint8_t* small) {
  parallel_ranges(num_rows, GRAIN, threads, [&](int64_t begin, int64_t end) {
    for (int64_t i = begin; i < end; ++i) {
      float longest = 0, squared = 0;
      for (int axis = 0; axis < 3; ++axis) {
        const float low = lower[3 * i + axis], high = upper[3 * i + axis];
        longest = greatest(longest, high - low);
        squared += square(greatest(0.f, greatest(low - eye[axis], eye[axis] - high)));
      }
      small[i] = square(longest) < square(limit) * squared;
    }
  });
}

void nest_boxes(const uint8_t* depth, int64_t num_rows, float* lower, float* upper) {
  // Backwards, children come before their parent: open[d] is what the next row of depth d - 1 has below it.
  struct Box {
    float lower[3], upper[3];
  };
  const Box nothing = {{INFINITY, INFINITY, INFINITY}, {-INFINITY, -INFINITY, -INFINITY}};
  Box open[257];
  for (Box& box : open) box = nothing;
  for (int64_t i = num_rows - 1; i >= 0; --i) {
    Box &below = open[depth[i] + 1], &level = open[depth[i]];
    for (int axis = 0; axis < 3; ++axis) {
      float &low = lower[3 * i + axis], &high = upper[3 * i + axis];
      low = least(low, below.lower[axis]);
      high = greatest(high, below.upper[axis]);
      level.lower[axis] = least(level.lower[axis], low);
      level.upper[axis] = greatest(level.upper[axis], high);
    }
    below = nothing;
  }
}

void flag_depths(const float* means, const uint8_t* depth, int64_t num_rows, const float* eye, const DistanceBands& bands,
                 int threads, uint8_t* flags) {
  parallel_ranges(num_rows, GRAIN, threads, [&](int64_t begin, int64_t end) {
    for (int64_t i = begin; i < end; ++i) {
      const float* mean = means + 3 * i;
      const float squared = square(mean[0] - eye[0]) + square(mean[1] - eye[1]) + square(mean[2] - eye[2]);
      int band = 0;
      for (int b = 0; b + 1 < bands.count; ++b) band += squared >= bands.squared_edges[b];
      const int wanted = bands.depths[band];
      flags[i] = uint8_t(depth[i] < wanted ? ABOVE : depth[i] == wanted ? AT : BELOW);
    }
  });
}

int64_t first_stops(const uint8_t* flags, const int32_t* subtree_end, int64_t num_rows, uint8_t least, int32_t* rows) {
  int64_t size = 0;
  for (int64_t i = 0; i < num_rows;) {
    const bool stops = flags[i] >= least || subtree_end[i] == i + 1;
    rows[size] = int32_t(i);
    size += stops;
    i = stops ? subtree_end[i] : i + 1;
  }
  return size;
}

}  // namespace splatree
