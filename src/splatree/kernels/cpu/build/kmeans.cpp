// A step of K-means; kernels/reference/kmeans.py is the definition.
//
// The points are cut into chunks whose number depends on the numbers of points and centres alone. A chunk finds its nearest
// centres (nearest.cpp) and adds its points up in float64; then the chunks' sums are added in their order: the same bits for any
// number of threads.
#include "cpu/build/kmeans.h"

#include <algorithm>
#include <cstring>

#include "cpu/build/box_tree.h"
#include "cpu/runtime/isa.h"
#include "cpu/runtime/pool.h"
#include "cpu/runtime/scratch.h"

namespace splatree {
namespace {

constexpr int64_t MAX_CHUNKS = 64;
constexpr int64_t GRAIN = 4096;  // points whose labels stay in the cache until they are added up

struct Sum {
  double x, y, z;
  int64_t count;
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
  const BoxTree tree(job.num_centers, job.centers, job.threads);
  const NearestJob nearest = {&tree, job.points, job.labels, job.squared_distances};
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
