// A step of K-means; kernels/reference/kmeans.py is the definition.
//
// The points are cut into chunks whose number depends on the numbers of points and centres alone. A chunk finds its nearest
// centres (nearest.cpp) and adds its points up in float64; then the chunks' sums are added in their order: the same bits for any
// number of threads.
#include "cpu/kmeans.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>
#include <numeric>
#include <vector>

#include "cpu/isa.h"
#include "cpu/pool.h"
#include "cpu/scratch.h"

namespace splatree {
namespace {

constexpr int64_t MAX_CHUNKS = 64;
constexpr int64_t GRAIN = 4096;  // points whose labels stay in the cache until they are added up

struct Sum {
  double x, y, z;
  int64_t count;
};

// Splits centres by the median along the longest side of their box, down to leaves of at most LEAF_CENTERS.
class TreeBuilder {
 public:
  TreeBuilder(const float* centers, int32_t count) : centers_(centers), order_(count) {
    std::iota(order_.begin(), order_.end(), 0);
    while (num_leaves * LEAF_CENTERS < count) num_leaves *= 2;
    boxes.resize(2 * num_leaves - 1);
    leaves.resize(num_leaves);
    split(0, 0, count);
  }

  std::vector<CenterBox> boxes;
  std::vector<CenterLeaf> leaves;
  int32_t num_leaves = 1;

 private:
  void split(int32_t node, int32_t begin, int32_t end) {
    CenterBox& box = boxes[node];
    for (int axis = 0; axis < 3; ++axis) {
      box.lower[axis] = std::numeric_limits<float>::infinity(), box.upper[axis] = -box.lower[axis];
      for (int32_t i = begin; i < end; ++i) {
        const float value = centers_[3 * int64_t(order_[i]) + axis];
        box.lower[axis] = std::min(box.lower[axis], value), box.upper[axis] = std::max(box.upper[axis], value);
      }
    }
    if (node >= num_leaves - 1) return fill(leaves[node - (num_leaves - 1)], begin, end);
    int longest = 0;
    for (int axis = 1; axis < 3; ++axis)
      if (box.upper[axis] - box.lower[axis] > box.upper[longest] - box.lower[longest]) longest = axis;
    const int32_t middle = begin + (end - begin) / 2;
    std::nth_element(order_.begin() + begin, order_.begin() + middle, order_.begin() + end, [&](int32_t a, int32_t b) {
      const float value_a = centers_[3 * int64_t(a) + longest], value_b = centers_[3 * int64_t(b) + longest];
      return value_a < value_b || (value_a == value_b && a < b);
    });
    split(2 * node + 1, begin, middle);
    split(2 * node + 2, middle, end);
  }

  void fill(CenterLeaf& leaf, int32_t begin, int32_t end) {
    for (int32_t i = 0; i < LEAF_CENTERS; ++i) {
      const bool used = begin + i < end;
      const float* center = used ? centers_ + 3 * int64_t(order_[begin + i]) : nullptr;
      const float away = std::numeric_limits<float>::infinity();
      leaf.x[i] = used ? center[0] : away, leaf.y[i] = used ? center[1] : away, leaf.z[i] = used ? center[2] : away;
      leaf.label[i] = used ? order_[begin + i] : std::numeric_limits<int32_t>::max();
    }
  }

  const float* centers_;
  std::vector<int32_t> order_;
};

void add_points(const KmeansJob& job, int64_t begin, int64_t end, Sum* sums) {
  for (int64_t i = begin; i < end; ++i) {
    Sum& sum = sums[job.labels[i]];
    sum.x += job.points[3 * i], sum.y += job.points[3 * i + 1], sum.z += job.points[3 * i + 2];
    ++sum.count;
  }
}

}  // namespace

void kmeans_step(const KmeansJob& job) {
  const TreeBuilder tree(job.centers, job.num_centers);
  const NearestJob nearest = {{tree.boxes.data(), tree.leaves.data(), tree.num_leaves},
                              job.points, job.labels, job.squared_distances};
  // Each chunk has sums of its own: as many as the points pay for.
  const int64_t num_chunks = std::min(MAX_CHUNKS, job.num_points / job.num_centers + 1);
  const int64_t k = job.num_centers;
  const Scratch<Sum> sums = allocate<Sum>(num_chunks * k);
  parallel_chunks(num_chunks, job.threads, [&](int64_t chunk) {
    Sum* mine = sums.get() + chunk * k;
    std::memset(static_cast<void*>(mine), 0, k * sizeof(Sum));
    const int64_t end = job.num_points * (chunk + 1) / num_chunks;
    for (int64_t begin = job.num_points * chunk / num_chunks; begin < end; begin += GRAIN) {
      const int64_t stop = std::min(begin + GRAIN, end);
      kernels().label_nearest(nearest, begin, stop);
      add_points(job, begin, stop, mine);
    }
  });
  parallel_ranges(k, 1024, job.threads, [&](int64_t begin, int64_t end) {
    for (int64_t j = begin; j < end; ++j) {
      Sum total = {};
      for (int64_t chunk = 0; chunk < num_chunks; ++chunk) {
        const Sum& part = sums[chunk * k + j];
        total.x += part.x, total.y += part.y, total.z += part.z, total.count += part.count;
      }
      job.sums[3 * j] = total.x, job.sums[3 * j + 1] = total.y, job.sums[3 * j + 2] = total.z;
      job.counts[j] = total.count;
    }
  });
}

}  // namespace splatree
