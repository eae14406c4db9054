// The nearest centre of each point, for runs of neighbouring points at once.
//
// No centre outside of the ball that is sure to hold one can be the nearest of any point of a run: if u is the least, over
// centres, of the largest squared distance to the run's box, the candidates are the centres whose least squared distance to the
// box is at most u. The tree finds them once for up to 64 points; then each point is compared with each candidate, 16 points at a
// time. A run with too many candidates, as where neighbours in the list are far apart, is halved, and at last its points look for
// themselves.
#include "cpu/build/box_tree.h"
#include "cpu/build/kmeans.h"
#include "cpu/runtime/isa.h"
#include "shared/portable.h"

namespace splatree::SPLATREE_ISA {
namespace {

constexpr int RUN = 64, LANES = 16;
constexpr int MAX_CANDIDATES = 1024;  // of a run of points
constexpr int MAX_VISITS = 512;       // leaves that are seen before a run counts as spread too far
constexpr int FEW = 64;               // candidates that are not worth halving a run
constexpr float SLACK = 1.00001f;     // what float32 may lose of a squared distance

struct alignas(64) Run {
  float x[RUN], y[RUN], z[RUN];
  float best[RUN];
  int32_t label[RUN];
};

struct Candidates {
  float x[MAX_CANDIDATES], y[MAX_CANDIDATES], z[MAX_CANDIDATES];
  int32_t label[MAX_CANDIDATES];
  int size;
};

SPLATREE_FN float squared(float x) { return x * x; }

struct LeafDistances {
  alignas(32) float least[LEAF_POINTS];
  float smallest_largest;  // least, over the centres, of the largest squared distance to the box
};

LeafDistances distances_of(const BoxLeaf& leaf, const Box& box) {
  LeafDistances found;
  float largest[LEAF_POINTS];
#pragma omp simd
  for (int i = 0; i < LEAF_POINTS; ++i) {
    const float below_x = box.lower[0] - leaf.x[i], above_x = leaf.x[i] - box.upper[0];
    const float below_y = box.lower[1] - leaf.y[i], above_y = leaf.y[i] - box.upper[1];
    const float below_z = box.lower[2] - leaf.z[i], above_z = leaf.z[i] - box.upper[2];
    found.least[i] = squared(greatest(greatest(below_x, above_x), 0.f)) + squared(greatest(greatest(below_y, above_y), 0.f)) +
                     squared(greatest(greatest(below_z, above_z), 0.f));
    // From the centre to the far side: the box is `below` or `above` away, plus its width.
    largest[i] = squared(box.upper[0] - box.lower[0] + greatest(below_x, above_x)) +
                 squared(box.upper[1] - box.lower[1] + greatest(below_y, above_y)) +
                 squared(box.upper[2] - box.lower[2] + greatest(below_z, above_z));
  }
  found.smallest_largest = largest[0];
  for (int i = 1; i < LEAF_POINTS; ++i) found.smallest_largest = least(largest[i], found.smallest_largest);
  return found;
}

// The best so far of points [begin, end) against the candidates; equal distances go to the smaller label.
void compare(const Candidates& from, int begin, int end, Run& run) {
  for (int first = begin; first < end; first += LANES) {
    for (int c = 0; c < from.size; ++c) {
      const float x = from.x[c], y = from.y[c], z = from.z[c];
      const int32_t label = from.label[c];
#pragma omp simd
      for (int i = first; i < first + LANES; ++i) {
        const float distance = squared(run.x[i] - x) + squared(run.y[i] - y) + squared(run.z[i] - z);
        const bool nearer = (distance < run.best[i]) | ((distance == run.best[i]) & (label < run.label[i]));
        run.best[i] = nearer ? distance : run.best[i];
        run.label[i] = nearer ? label : run.label[i];
      }
    }
  }
}

Box box_of(const Run& run, int begin, int end) {
  Box box = {{run.x[begin], run.y[begin], run.z[begin]}, {run.x[begin], run.y[begin], run.z[begin]}};
  for (int i = begin + 1; i < end; ++i) {
    const float point[3] = {run.x[i], run.y[i], run.z[i]};
    for (int axis = 0; axis < 3; ++axis) {
      box.lower[axis] = least(point[axis], box.lower[axis]);
      box.upper[axis] = greatest(point[axis], box.upper[axis]);
    }
  }
  return box;
}

bool is_point(const Box& box) {
  return (box.lower[0] == box.upper[0]) & (box.lower[1] == box.upper[1]) & (box.lower[2] == box.upper[2]);
}

// Points [begin, end) against the centres that can be the nearest of a point of the box, which is theirs or that of one of them.
void label_run(const BoxTree& tree, const Box& box, int begin, int end, Run& run) {
  // First the bound, the largest squared distance to the nearest centre, which falls while leaves are visited; then what lies
  // within it.
  const int most_visits = is_point(box) ? 0x7fffffff : MAX_VISITS;
  int visits = 0;
  bool crowded = false;
  float bound = float_of(0x7f800000);
  each_leaf(tree, box, bound, [&](int64_t leaf) {
    crowded = ++visits > most_visits;
    bound = crowded ? -1.f : least(distances_of(tree.leaves[leaf], box).smallest_largest, bound);
    return bound * SLACK;
  });
  const float limit = bound * SLACK;
  Candidates candidates;
  candidates.size = 0;
  each_leaf(tree, box, limit, [&](int64_t index) {
    const BoxLeaf& leaf = tree.leaves[index];
    if (candidates.size > MAX_CANDIDATES - LEAF_POINTS) {
      crowded = !is_point(box);
      if (crowded) return -1.f;
      compare(candidates, begin, end, run);  // so many centres at one distance from a point
      candidates.size = 0;
    }
    const LeafDistances distances = distances_of(leaf, box);
    for (int i = 0; i < LEAF_POINTS; ++i) {
      const int place = candidates.size;
      candidates.x[place] = leaf.x[i], candidates.y[place] = leaf.y[i], candidates.z[place] = leaf.z[i];
      candidates.label[place] = leaf.row[i];
      candidates.size += distances.least[i] <= limit;
    }
    return limit;
  });
  if (end - begin > LANES && (crowded || candidates.size > FEW)) {
    const int middle = begin + (end - begin) / 2 / LANES * LANES;
    label_run(tree, box_of(run, begin, middle), begin, middle, run);
    label_run(tree, box_of(run, middle, end), middle, end, run);
  } else if (crowded) {
    for (int i = begin; i < end; ++i) label_run(tree, box_of(run, i, i + 1), begin, end, run);
  } else {
    compare(candidates, begin, end, run);
  }
}

}  // namespace

void label_nearest(const NearestJob& job, int64_t begin, int64_t end) {
  Run run;
  for (int64_t first = begin; first < end; first += RUN) {
    const int used = int(end - first < RUN ? end - first : RUN);
    const int filled = (used + LANES - 1) / LANES * LANES;  // the last point is repeated
    for (int i = 0; i < filled; ++i) {
      const float* point = job.points + 3 * (first + (i < used ? i : used - 1));
      run.x[i] = point[0], run.y[i] = point[1], run.z[i] = point[2];
      run.best[i] = float_of(0x7f800000);
      run.label[i] = 0x7fffffff;
    }
    label_run(*job.centers, box_of(run, 0, filled), 0, filled, run);
    for (int i = 0; i < used; ++i) job.labels[first + i] = run.label[i], job.squared_distances[first + i] = run.best[i];
  }
}

}  // namespace splatree::SPLATREE_ISA
