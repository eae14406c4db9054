// A row at a time: what is gathered of it lies in many places of memory, which takes longer than the arithmetic.
#include "cpu/codec/nodes.h"

#include <cmath>

#include "cpu/runtime/pool.h"
#include "shared/harmonics.h"
#include "shared/project.h"

namespace splatree {
namespace {

constexpr int64_t ROWS_PER_CHUNK = 2048, AHEAD = 8;  // rows, the second is how far ahead columns are fetched
constexpr float COLOR_MAX = 2.f, LOG_SCALE_MAX = 20.f;

float held(float x, float low, float high) { return x < low ? low : x > high ? high : x; }

uint32_t rounded(float x) { return static_cast<uint32_t>(std::nearbyint(x)); }

uint32_t bits(float x) {
  uint32_t word;
  __builtin_memcpy(&word, &x, 4);
  return word;
}

uint32_t color_of(const NodeColumns& columns, int64_t row, const double* eye) {
  const float* mean = columns.means + 3 * row;
  float basis[16];
  float x = 0, y = 0, z = 0;
  if (columns.degree) {
    x = static_cast<float>(mean[0] - eye[0]), y = static_cast<float>(mean[1] - eye[1]), z = static_cast<float>(mean[2] - eye[2]);
    const float length = std::sqrt(x * x + y * y + z * z), inverse = 1.f / (length > 1e-37f ? length : 1e-37f);
    x *= inverse, y *= inverse, z *= inverse;
  }
  harmonics_of(x, y, z, columns.degree, basis, 1);
  const int count = (columns.degree + 1) * (columns.degree + 1);
  const float* sh = columns.sh + 3 * count * row;
  float color[3] = {0.5f, 0.5f, 0.5f};
  for (int k = 0; k < count; ++k)
    for (int c = 0; c < 3; ++c) color[c] += basis[k] * sh[3 * k + c];
  for (float& channel : color) channel = held(channel * (1 / COLOR_MAX), 0.f, 1.f);
  return rounded(2047 * color[0]) | rounded(2047 * color[1]) << 11 | rounded(1023 * color[2]) << 22;
}

// The index of the largest component, and the others in their order, 16 bits each.
int smallest_three(const float* quat, uint32_t (&small)[3]) {
  double norm = 0;
  int largest = 0;
  for (int i = 0; i < 4; ++i) {
    norm += static_cast<double>(quat[i]) * quat[i];
    if (std::fabs(quat[i]) > std::fabs(quat[largest])) largest = i;
  }
  norm = std::sqrt(norm);
  const double scale = (quat[largest] < 0 ? -1 : 1) * 32767 * 1.4142135623730951 / (norm > 1e-37 ? norm : 1e-37);
  for (int i = 0, j = 0; i < 4; ++i)
    if (i != largest) small[j++] = static_cast<uint32_t>(static_cast<int32_t>(std::nearbyint(quat[i] * scale))) & 0xffff;
  return largest;
}

struct Shape {
  float log_scales[3], opacity;
};

// A merged row as it is drawn at a dilation.
Shape drawn_at(float dilation, const float* curve, const Shape& stored) {
  const float* s = stored.log_scales;
  const Followed drawn = followed_of({curve[0], curve[1], curve[2], curve[3]}, dilation,
                                     {std::exp(s[0]), std::exp(s[1]), std::exp(s[2])}, stored.opacity);
  const auto log_of = [](float scale) { return std::log(scale > 1e-30f ? scale : 1e-30f); };
  return {{log_of(drawn.scale.x), log_of(drawn.scale.y), log_of(drawn.scale.z)}, drawn.opacity};
}

// A row as it is drawn at a dilation, of a tree with curves, in steps of 16 bits: opacity and three scales.
void steps_of(const NodeColumns& columns, const NodeTree& tree, int64_t row, const float* dilation, uint32_t (&steps)[4]) {
  const float* given = columns.log_scales + 3 * row;
  Shape shape = {{given[0], given[1], given[2]}, 1.f / (1.f + std::exp(-columns.logit_opacities[row]))};
  if (tree.curves && tree.curves[4 * row + 2] > 0) shape = drawn_at(*dilation, tree.curves + 4 * row, shape);
  steps[0] = rounded(65535 * shape.opacity);
  for (int axis = 0; axis < 3; ++axis) {
    const float share = held(shape.log_scales[axis] * (1 / LOG_SCALE_MAX), -1.f, 1.f);
    steps[1 + axis] = rounded((share + 1.f) * 32767.5f);
  }
}

void fetch_color(const NodeColumns& columns, int64_t row) {
  const int64_t size = 3 * (columns.degree + 1) * (columns.degree + 1);
  __builtin_prefetch(columns.means + 3 * row);
  for (int64_t i = 0; i < size; i += 16) __builtin_prefetch(columns.sh + size * row + i);
  __builtin_prefetch(columns.sh + size * row + size - 1);
}

void fetch_shape(const NodeColumns& columns, const NodeTree& tree, int64_t row) {
  __builtin_prefetch(columns.log_scales + 3 * row);
  __builtin_prefetch(columns.logit_opacities + row);
  if (tree.curves) __builtin_prefetch(tree.curves + 4 * row);
}

void fetch_rest(const NodeColumns& columns, const NodeTree& tree, int64_t row) {
  __builtin_prefetch(columns.quats + 4 * row);
  __builtin_prefetch(tree.subtree_end + row);
  __builtin_prefetch(tree.depth + row);
}

}  // namespace

void pack_nodes(const NodeColumns& columns, const NodeTree& tree, const int32_t* rows, const float* dilations, int64_t num_rows,
                const double* eye, const double* centre, uint32_t* out, int threads) {
  parallel_ranges(num_rows, ROWS_PER_CHUNK, threads, [&](int64_t begin, int64_t end) {
    for (int64_t i = begin; i < end; ++i) {
      if (i + AHEAD < end) {
        fetch_shape(columns, tree, rows[i + AHEAD]);
        fetch_rest(columns, tree, rows[i + AHEAD]);
        fetch_color(columns, rows[i + AHEAD]);
      }
      const int64_t row = rows[i];
      uint32_t* words = out + 8 * i;
      for (int axis = 0; axis < 3; ++axis) words[axis] = bits(static_cast<float>(columns.means[3 * row + axis] - centre[axis]));
      uint32_t small[3], steps[4];
      const int largest = smallest_three(columns.quats + 4 * row, small);
      steps_of(columns, tree, row, dilations + i, steps);
      const uint32_t level = (tree.depth[row] < 127 ? tree.depth[row] : 127) | (tree.subtree_end[row] == row + 1) << 7;
      words[3] = largest | level << 8 | steps[0] << 16;
      words[4] = color_of(columns, row, eye);
      words[5] = small[0] | small[1] << 16;
      words[6] = small[2] | steps[1] << 16;
      words[7] = steps[2] | steps[3] << 16;
    }
  });
}

void pack_shapes(const NodeColumns& columns, const NodeTree& tree, const int32_t* rows, const float* dilations, int64_t num_rows,
                 uint32_t* out, int threads) {
  parallel_ranges(num_rows, ROWS_PER_CHUNK, threads, [&](int64_t begin, int64_t end) {
    for (int64_t i = begin; i < end; ++i) {
      if (i + AHEAD < end) fetch_shape(columns, tree, rows[i + AHEAD]);
      uint32_t steps[4];
      steps_of(columns, tree, rows[i], dilations + i, steps);
      out[2 * i] = steps[0] | steps[1] << 16;
      out[2 * i + 1] = steps[2] | steps[3] << 16;
    }
  });
}

void pack_colors(const NodeColumns& columns, const int32_t* rows, int64_t num_rows, const double* eye, uint32_t* out,
                 int threads) {
  parallel_ranges(num_rows, ROWS_PER_CHUNK, threads, [&](int64_t begin, int64_t end) {
    for (int64_t i = begin; i < end; ++i) {
      if (i + AHEAD < end) fetch_color(columns, rows[i + AHEAD]);
      out[i] = color_of(columns, rows[i], eye);
    }
  });
}

}  // namespace splatree
