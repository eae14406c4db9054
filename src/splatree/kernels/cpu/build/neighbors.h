// The nearest neighbours of the points of a leaf of a tree of boxes (neighbors.cpp).
#pragma once
#include <cstdint>

#include "cpu/build/box_tree.h"
#include "cpu/build/pairs.h"
#include "shared/portable.h"

namespace splatree {

// A sorted list for each point of a leaf: the nearest places of the tree's list of rows, ties in the order they are met.
struct LeafNeighbors {
  alignas(64) float distances2[PAIR_NEIGHBORS][LEAF_POINTS];
  alignas(64) int32_t places[PAIR_NEIGHBORS][LEAF_POINTS];  // −1 where there are fewer
};

// An empty list, or one that takes no point: as those of lanes without a point have to be.
SPLATREE_FN void reset_list(LeafNeighbors& found, int64_t lane, bool is_open) {
  for (int k = 0; k < PAIR_NEIGHBORS; ++k)
    found.distances2[k][lane] = is_open ? float_of(0x7f800000) : 0.f, found.places[k][lane] = -1;
}

SPLATREE_FN int size_of_list(const LeafNeighbors& found, int64_t lane) {
  int size = 0;
  while (size < PAIR_NEIGHBORS && found.places[size][lane] >= 0) ++size;
  return size;
}

}  // namespace splatree
