// The nearest neighbours of the points of a tree of boxes.
#pragma once
#include <cmath>
#include <cstdint>

#include "cpu/box_tree.h"
#include "cpu/pairs.h"

namespace splatree {

// The nearest points of one, by rising distance, ties by place in the tree.
struct Nearest {
  int count = 0;
  float distances2[kPairNeighbors];
  int32_t places[kPairNeighbors];

  float bound() const { return count < kPairNeighbors ? HUGE_VALF : distances2[kPairNeighbors - 1]; }

  // Takes no point any more.
  void close() {
    count = kPairNeighbors;
    distances2[kPairNeighbors - 1] = 0;
  }

  // A point nearer than bound().
  void offer(float distance2, int32_t place) {
    int i = count < kPairNeighbors ? count++ : count - 1;
    for (; i > 0 && distances2[i - 1] > distance2; --i) {
      distances2[i] = distances2[i - 1];
      places[i] = places[i - 1];
    }
    distances2[i] = distance2;
    places[i] = place;
  }
};

// The neighbours of the points of a leaf, in places of the tree's list of rows; those that are closed are left out.
void find_nearest(const BoxTree& tree, int64_t leaf, Nearest* nearest);

}  // namespace splatree
