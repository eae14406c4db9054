// A step of K-means: the nearest centre of each point, and the sums of the points of each centre; kernels/reference/kmeans.py is
// the definition.
//
// 32 consecutive centres are a leaf, whose box is found anew in each step: where they were drawn from points along a curve they
// lie together, and stay so. A warp takes 64 consecutive points, two a lane. It compares them with the leaf that is sure to be
// near, then with every leaf that may hold a centre nearer than the farthest of its points has found, a bound that falls on the
// way. Sums are of whole numbers, so that they have the same bits in any order.
#include "cuda/kmeans.h"

using namespace splatree;

namespace {

constexpr int THREADS = 256, POINTS = 2, POINTS_OF_WARP = POINTS * WARP;
constexpr float SLACK = 1.00001f;  // what float32 may lose of a squared distance

struct Box {
  Vector lower, upper;
};

// The points of a lane, and the nearest centre of each so far.
struct Points {
  Vector at[POINTS];
  float best[POINTS];
  int label[POINTS];
};

SPLATREE_FN float squared(float x) { return x * x; }

SPLATREE_FN float least_of_warp(float value) {
  for (int step = WARP / 2; step; step /= 2) value = least(__shfl_xor_sync(ALL_LANES, value, step), value);
  return value;
}

SPLATREE_FN float greatest_of_warp(float value) { return -least_of_warp(-value); }

SPLATREE_FN Box box_of_warp(const Vector& lower, const Vector& upper) {
  return {{least_of_warp(lower.x), least_of_warp(lower.y), least_of_warp(lower.z)},
          {greatest_of_warp(upper.x), greatest_of_warp(upper.y), greatest_of_warp(upper.z)}};
}

SPLATREE_FN Vector load(Global<const float> column, long long row) {
  return {column[3 * row], column[3 * row + 1], column[3 * row + 2]};
}

SPLATREE_FN Box load_box(const KmeansJob* job, int leaf) {
  const long long at = 6ll * leaf;
  return {{job->boxes[at], job->boxes[at + 1], job->boxes[at + 2]}, {job->boxes[at + 3], job->boxes[at + 4], job->boxes[at + 5]}};
}

// How far apart intervals are, and how far the farthest of their points.
SPLATREE_FN float gap(float lower_a, float upper_a, float lower_b, float upper_b) {
  return greatest(greatest(lower_a - upper_b, lower_b - upper_a), 0.f);
}
SPLATREE_FN float reach(float lower_a, float upper_a, float lower_b, float upper_b) {
  return greatest(upper_a - lower_b, upper_b - lower_a);
}

SPLATREE_FN float least_squared_distance(const Box& a, const Box& b) {
  return squared(gap(a.lower.x, a.upper.x, b.lower.x, b.upper.x)) + squared(gap(a.lower.y, a.upper.y, b.lower.y, b.upper.y)) +
         squared(gap(a.lower.z, a.upper.z, b.lower.z, b.upper.z));
}

SPLATREE_FN float largest_squared_distance(const Box& a, const Box& b) {
  return squared(reach(a.lower.x, a.upper.x, b.lower.x, b.upper.x)) + squared(reach(a.lower.y, a.upper.y, b.lower.y, b.upper.y)) +
         squared(reach(a.lower.z, a.upper.z, b.lower.z, b.upper.z));
}

// Compares the points with the centres of a leaf; equal distances go to the smaller label.
SPLATREE_FN void compare(const KmeansJob* job, int leaf, Points& points) {
  const int begin = leaf * WARP, end = smaller(begin + WARP, (int)job->num_centers);
  for (int label = begin; label < end; ++label) {
    const Vector center = load(job->centers, label);
#pragma unroll
    for (int i = 0; i < POINTS; ++i) {
      const Vector& at = points.at[i];
      const float distance = squared(at.x - center.x) + squared(at.y - center.y) + squared(at.z - center.z);
      const bool nearer = distance < points.best[i] || (distance == points.best[i] && label < points.label[i]);
      points.best[i] = nearer ? distance : points.best[i];
      points.label[i] = nearer ? label : points.label[i];
    }
  }
}

// The largest squared distance that a point of the warp has to its nearest centre so far.
SPLATREE_FN float bound_of(const Points& points) {
  float farthest = points.best[0];
#pragma unroll
  for (int i = 1; i < POINTS; ++i) farthest = greatest(points.best[i], farthest);
  return greatest_of_warp(farthest);
}

// The leaf whose farthest centre is nearest to the box: it is sure to hold a near one.
SPLATREE_FN int near_leaf(const KmeansJob* job, const Box& box, int num_leaves) {
  float distance = float_of(0x7f800000);
  int nearest = 0;
  for (int leaf = lane_of(); leaf < num_leaves; leaf += WARP) {
    const float to_leaf = largest_squared_distance(box, load_box(job, leaf));
    nearest = to_leaf < distance ? leaf : nearest;
    distance = least(to_leaf, distance);
  }
  const unsigned lanes = __ballot_sync(ALL_LANES, distance == least_of_warp(distance));
  return __shfl_sync(ALL_LANES, nearest, __ffs(lanes) - 1);
}

}  // namespace

// A warp a leaf.
SPLATREE_KERNEL(256, 1) box_centers(const KmeansJob* job, int) {
  const long long leaf = index_of_thread() / WARP;
  if (leaf * WARP >= job->num_centers) return;
  const long long last = job->num_centers - 1, label = leaf * WARP + lane_of();
  const Vector center = load(job->centers, label < last ? label : last);
  const Box box = box_of_warp(center, center);
  if (lane_of()) return;
  job->boxes[6 * leaf] = box.lower.x, job->boxes[6 * leaf + 1] = box.lower.y, job->boxes[6 * leaf + 2] = box.lower.z;
  job->boxes[6 * leaf + 3] = box.upper.x, job->boxes[6 * leaf + 4] = box.upper.y, job->boxes[6 * leaf + 5] = box.upper.z;
}

// A warp 64 points.
SPLATREE_KERNEL(256, 1) label_points(const KmeansJob* job, int) {
  const long long warp = index_of_thread() / WARP, first = warp * POINTS_OF_WARP, last = job->num_points - 1;
  if (first > last) return;
  Points points;
  for (int i = 0; i < POINTS; ++i) {
    const long long row = first + i * WARP + lane_of();
    points.at[i] = load(job->points, row < last ? row : last);
    points.best[i] = float_of(0x7f800000), points.label[i] = 0x7fffffff;
  }
  const Vector &a = points.at[0], &b = points.at[1];
  const Box box = box_of_warp({least(a.x, b.x), least(a.y, b.y), least(a.z, b.z)},
                              {greatest(a.x, b.x), greatest(a.y, b.y), greatest(a.z, b.z)});
  const int num_leaves = (int)((job->num_centers + WARP - 1) / WARP), near = near_leaf(job, box, num_leaves);
  compare(job, near, points);
  float bound = bound_of(points);
  for (int begin = 0; begin < num_leaves; begin += WARP) {
    const int mine = begin + lane_of();
    const float away = mine < num_leaves ? least_squared_distance(box, load_box(job, mine)) : float_of(0x7f800000);
    unsigned open = __ballot_sync(ALL_LANES, away <= bound * SLACK && mine != near);
    for (; open; open &= open - 1) {
      const int lane = __ffs(open) - 1;
      if (__shfl_sync(ALL_LANES, away, lane) > bound * SLACK) continue;
      compare(job, begin + lane, points);
      bound = bound_of(points);
    }
  }

  const double unit = ldexp(1.0, (int)job->sum_bits);
  double inertia = 0;
  for (int i = 0; i < POINTS; ++i) {
    const long long row = first + i * WARP + lane_of(), label = points.label[i];
    if (row > last) continue;
    job->labels[row] = points.label[i], job->squared_distances[row] = points.best[i];
    inertia += points.best[i];
    atomicAdd(&job->sums[3 * label], (unsigned long long)llrint(points.at[i].x * unit));
    atomicAdd(&job->sums[3 * label + 1], (unsigned long long)llrint(points.at[i].y * unit));
    atomicAdd(&job->sums[3 * label + 2], (unsigned long long)llrint(points.at[i].z * unit));
    atomicAdd(&job->counts[label], 1ull);
  }
  for (int step = WARP / 2; step; step /= 2) inertia += __shfl_xor_sync(ALL_LANES, inertia, step);
  if (lane_of() == 0) job->inertia[warp] = inertia;
}
