// Four axes, each looked along both ways; kernels/reference/visibility.py is the definition.
//
// For each axis the Gaussians are sorted by depth and projected, then walked through from either end (see_through.cpp). Axes are
// independent of each other and their results are added in their order: the same bits for any number of threads.
// Cost: per axis a radix sort and one random read a Gaussian, and the two walks; memory per thread 72 bytes a Gaussian.
#include "cpu/build/visibility.h"

#include <algorithm>
#include <cmath>

#include "cpu/build/covariance.h"
#include "cpu/runtime/isa.h"
#include "cpu/runtime/pool.h"
#include "cpu/runtime/radix.h"
#include "cpu/runtime/scratch.h"

namespace splatree {
namespace {

struct Frame {
  float u[3], v[3], w[3];
};

constexpr float R2 = 0.70710678f, R3 = 0.57735027f, R6 = 0.40824829f;
// The diagonals of the world's cubes.
constexpr Frame FRAMES[] = {
    {{R2, -R2, 0}, {R6, R6, -2 * R6}, {R3, R3, R3}},
    {{R2, -R2, 0}, {R6, R6, 2 * R6}, {R3, R3, -R3}},
    {{R2, R2, 0}, {R6, -R6, -2 * R6}, {R3, -R3, R3}},
    {{R2, R2, 0}, {R6, -R6, 2 * R6}, {R3, -R3, -R3}},
};
constexpr int64_t NUM_AXES = sizeof FRAMES / sizeof FRAMES[0];
static_assert(NUM_AXES == SIGHT_AXES);

constexpr float FILTER = 0.3f;                     // variance that a cell adds, cells²
constexpr float FARTHEST = 1e6f;                   // cells: what is farther out is put there
constexpr float LARGEST = 5, SMALLEST = -10;       // log of a scale in cells: float32 holds determinants within these
constexpr float MOST = 0.5f * SIGHT_CELLS - 0.5f;  // half the box of a splat, cells
constexpr float DEPTH_STEPS = 1 << 22;             // depths are sorted in so many steps: two passes

// A Gaussian in cells.
struct Source {
  float mean[3];
  float covariance[6];  // xx xy xz yy yz zz
  float opacity;
};

void mean_in_cells(const VisibilityJob& job, int64_t row, float* mean) {
  for (int a = 0; a < 3; ++a) {
    const float cells = static_cast<float>((job.means[3 * row + a] - job.middle[a]) / job.cell);
    mean[a] = std::min(std::max(cells, -FARTHEST), FARTHEST);
  }
}

Source source_of(const VisibilityJob& job, int64_t row) {
  Source source;
  mean_in_cells(job, row, source.mean);
  float variance[3];
  const float log_cell = static_cast<float>(std::log(job.cell));
  for (int a = 0; a < 3; ++a) {
    variance[a] = std::exp(2 * std::min(std::max(job.log_scales[3 * row + a] - log_cell, SMALLEST), LARGEST));
  }
  covariance_from(job.quats + 4 * row, variance, source.covariance);
  source.opacity = 1 / (1 + std::exp(-job.logit_opacities[row]));
  return source;
}

float dot(const float* a, const float* b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

// aᵀ S b
float form(const float* s, const float* a, const float* b) {
  return a[0] * (s[0] * b[0] + s[1] * b[1] + s[2] * b[2]) + a[1] * (s[1] * b[0] + s[3] * b[1] + s[4] * b[2]) +
         a[2] * (s[2] * b[0] + s[4] * b[1] + s[5] * b[2]);
}

Sighted project(const Source& source, const Frame& frame, int64_t width) {
  Sighted s;
  const float half = 0.5f * static_cast<float>(width);  // where the plane repeats itself is far from the middle
  s.u = dot(source.mean, frame.u) + half, s.v = dot(source.mean, frame.v) + half, s.depth = dot(source.mean, frame.w);
  const float* S = source.covariance;
  float uu = form(S, frame.u, frame.u), vv = form(S, frame.v, frame.v);
  const float uv = form(S, frame.u, frame.v), own = std::max(uu * vv - uv * uv, 0.0f);
  uu += FILTER, vv += FILTER;
  const float determinant = std::max(uu * vv - uv * uv, FILTER * FILTER);
  s.opacity = source.opacity * std::sqrt(own / determinant);
  s.a = vv / determinant, s.b = -uv / determinant, s.c = uu / determinant;
  s.half_u = std::min(2 * std::sqrt(uu), MOST), s.half_v = std::min(2 * std::sqrt(vv), MOST);
  s.sum = 0;
  return s;
}

// Of the whole scene, in a unit of depth: how many steps it is.
float steps_in_depth(float nearest, float farthest) { return farthest > nearest ? (DEPTH_STEPS - 1) / (farthest - nearest) : 0; }

uint32_t step_of(float depth, float nearest, float steps) { return static_cast<uint32_t>((depth - nearest) * steps); }

// Rows by rising depth along w.
Scratch<KeyRow> order_of(const Source* sources, int64_t n, const float* w) {
  float nearest = HUGE_VALF, farthest = -HUGE_VALF;
  for (int64_t i = 0; i < n; ++i) {
    const float depth = dot(sources[i].mean, w);
    nearest = std::min(nearest, depth), farthest = std::max(farthest, depth);
  }
  const float steps = steps_in_depth(nearest, farthest);
  Scratch<KeyRow> order = allocate<KeyRow>(n);
  for (int64_t i = 0; i < n; ++i) order[i] = {step_of(dot(sources[i].mean, w), nearest, steps), static_cast<uint32_t>(i)};
  radix_sort(order, n, 1);
  return order;
}

// Adds to each row the squares of what is seen of it along the axis, one way and the other.
void look_along(const VisibilityJob& job, const Source* sources, const Frame& frame, float* sums) {
  const int64_t n = job.n, cells = job.width * (job.width + SIGHT_MARGIN);
  const Scratch<KeyRow> order = order_of(sources, n, frame.w);
  const Scratch<Sighted> splats = allocate<Sighted>(n);
  for (int64_t i = 0; i < n; ++i) splats[i] = project(sources[order[i].row], frame, job.width);
  const Scratch<float> passing = allocate<float>(cells), depths = allocate<float>(cells);
  for (const bool backwards : {false, true}) {
    std::fill_n(passing.get(), cells, 1.0f);
    std::fill_n(depths.get(), cells, 0.0f);
    const float inverse_reach = static_cast<float>(job.cell / job.reach);
    kernels().see_through({splats.get(), n, backwards, job.width, passing.get(), depths.get(), inverse_reach});
  }
  for (int64_t i = 0; i < n; ++i) sums[order[i].row] = splats[i].sum;
}

}  // namespace

void measure_visibilities(const VisibilityJob& job) {
  const int64_t n = job.n;
  if (n == 0) return;
  const Scratch<Source> sources = allocate<Source>(n);
  const Scratch<float> sums = allocate<float>(n * NUM_AXES);
  parallel_ranges(n, 1 << 13, job.threads, [&](int64_t begin, int64_t end) {
    for (int64_t i = begin; i < end; ++i) sources[i] = source_of(job, i);
  });
  parallel_chunks(NUM_AXES, job.threads, [&](int64_t axis) { look_along(job, sources.get(), FRAMES[axis], &sums[axis * n]); });
  parallel_ranges(n, 1 << 13, job.threads, [&](int64_t begin, int64_t end) {
    for (int64_t i = begin; i < end; ++i) {
      float sum = 0;
      for (int64_t axis = 0; axis < NUM_AXES; ++axis) sum += sums[axis * n + i];
      job.visibilities[i] = std::sqrt(sum / (2 * NUM_AXES));
    }
  });
}

void depths_along(const VisibilityJob& job, int64_t axis, float* depths) {
  parallel_ranges(job.n, 1 << 13, job.threads, [&](int64_t begin, int64_t end) {
    for (int64_t i = begin; i < end; ++i) {
      float mean[3];
      mean_in_cells(job, i, mean);
      depths[i] = dot(mean, FRAMES[axis].w);
    }
  });
}

void steps_of_depths(int64_t n, const float* depths, float nearest, float farthest, uint32_t* steps) {
  const float in_depth = steps_in_depth(nearest, farthest);
  for (int64_t i = 0; i < n; ++i) steps[i] = step_of(depths[i], nearest, in_depth);
}

void sighted_along(const VisibilityJob& job, int64_t axis, Sighted* splats) {
  parallel_ranges(job.n, 1 << 13, job.threads, [&](int64_t begin, int64_t end) {
    for (int64_t i = begin; i < end; ++i) splats[i] = project(source_of(job, i), FRAMES[axis], job.width);
  });
}

}  // namespace splatree
