// What of each Gaussian others leave to be seen (reference/visibility.py): the job, and the walk along one axis
// (see_through.cpp).
#pragma once
#include <cstdint>

namespace splatree {

constexpr int SIGHT_AXES = 4;

struct VisibilityJob {
  int64_t n;
  const float *means, *quats, *log_scales, *logit_opacities;
  const double* middle;  // 3, world units
  double cell;           // edge of a cell, world units
  double reach;          // world units; infinity: nothing is forgotten
  int64_t width;         // cells of the plane along u and v, a power of two; it repeats itself
  float* visibilities;   // n, out: 0 to 1
  int threads;
};

void measure_visibilities(const VisibilityJob& job);

// The steps of `measure_visibilities` for scenes that pass by in pieces.

// Depth along an axis, cells.
void depths_along(const VisibilityJob& job, int64_t axis, float* depths);

// The step of depth that each falls into, of the steps from the nearest to the farthest of the whole scene.
void steps_of_depths(int64_t n, const float* depths, float nearest, float farthest, uint32_t* steps);

constexpr int SIGHT_LANES = 8;
constexpr int SIGHT_CELLS = 32;                              // along u and v, that a splat is looked at in at most
constexpr int64_t SIGHT_MARGIN = SIGHT_CELLS + SIGHT_LANES;  // of a row of the plane

// A Gaussian as it is seen along an axis; lengths in cells.
struct Sighted {
  float u, v, depth;
  float a, b, c;         // inverse of the 2 × 2 covariance
  float half_u, half_v;  // of the box that it is looked at in
  float opacity;
  float sum;  // of the squares of what is seen on either way
};
static_assert(sizeof(Sighted) == 10 * sizeof(float), "SIGHTED in visibility.py");

// Rows as they are seen along an axis, in their order.
void sighted_along(const VisibilityJob& job, int64_t axis, Sighted* splats);

struct SightJob {
  Sighted* splats;  // by rising depth
  int64_t count;
  bool backwards;
  int64_t width;
  float* passing;       // width rows of width + SIGHT_MARGIN: the light that passes each cell, 1 at first
  float* depths;        // the depth where that was
  float inverse_reach;  // per cell
};

}  // namespace splatree
