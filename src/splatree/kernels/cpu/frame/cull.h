// Jobs of culling clusters (cull.cpp).
#pragma once
#include <cstdint>

namespace splatree {

constexpr int CULL_SIDES = 5;  // right, left, bottom, top, near

// The view as in scene/clusters.py: Sides.
struct CullJob {
  const float *centers, *radii, *near_radii;  // c
  double plane[CULL_SIDES][4], reach[CULL_SIDES], eye[3], scale, slack, margin;
  bool guard;
  uint8_t* kept;  // c
};

struct CullBoxesJob {
  const float *low, *high;  // c 3
  double plane[CULL_SIDES][4], reach[CULL_SIDES], box_reach[CULL_SIDES][3], eye[3], slack, margin;
  uint8_t* kept;  // c
};

}  // namespace splatree
