#include "cpu/codec/palette.h"

#include <algorithm>
#include <cstring>
#include <limits>
#include <vector>

#include "cpu/codec/scores.h"
#include "cpu/runtime/isa.h"
#include "cpu/runtime/pool.h"
#include "cpu/runtime/scratch.h"

namespace splatree {
namespace {

constexpr int64_t POINTS_PER_CHUNK = 1 << 12;

int64_t blocks_for(int64_t num_centres) { return (num_centres + LANES - 1) / LANES; }

int64_t floats_for(int64_t num_centres, int64_t dims) { return blocks_for(num_centres) * (dims + 1) * LANES; }

// Lays row-major centres out in blocks: centre i in lane i mod 16.
Centres arrange(const float* centres, int64_t count, int64_t dims, float* blocks) {
  for (int64_t b = 0; b < blocks_for(count); ++b)
    for (int64_t l = 0; l < LANES; ++l) {
      const int64_t i = b * LANES + l;
      float* lane = blocks + b * (dims + 1) * LANES + l;
      double norm = 0;
      for (int64_t d = 0; d < dims; ++d) {
        const float x = i < count ? centres[i * dims + d] : 0;
        lane[d * LANES] = x;
        norm += double(x) * x;
      }
      lane[dims * LANES] = i < count ? float(norm / 2) : std::numeric_limits<float>::infinity();
    }
  return {blocks, blocks_for(count), dims};
}

// Calls search(points, k) for each four of the `count` points at(k), from number k on. The last four are filled up with the last
// point: a point's result does not depend on its companions.
template <class At, class Search>
void each_four(int64_t count, const At& at, const Search& search) {
  constexpr int64_t AHEAD = 4 * POINTS_AT_ONCE;  // points between the fetch of one and its use
  for (int64_t k = 0; k < count; k += POINTS_AT_ONCE) {
    const float* points[POINTS_AT_ONCE];
    for (int64_t p = 0; p < POINTS_AT_ONCE; ++p) {
      points[p] = at(std::min(k + p, count - 1));
      __builtin_prefetch(at(std::min(k + p + AHEAD, count - 1)));
    }
    search(points, k);
  }
}

// Calls visit(k, score, centre) with the centre nearest to each point at(k), k in [0, count).
template <class At, class Visit>
void each_nearest(const Centres& centres, int64_t count, const At& at, const Visit& visit) {
  each_four(count, at, [&](const float* const* points, int64_t k) {
    NearestCentres nearest;
    kernels().nearest_centres(centres, points, &nearest);
    for (int64_t p = 0; p < POINTS_AT_ONCE && k + p < count; ++p) visit(k + p, nearest.score[p], nearest.centre[p]);
  });
}

// The lane with the lowest score, of equal ones that of the centre with the lowest number. Scores are compared as whole numbers
// without branches, which could not be foretold: a float's bits order as an integer's do, once those below zero are turned.
int64_t best_lane(const float* scores, const int32_t* blocks) {
  int64_t best = std::numeric_limits<int64_t>::max();
  for (int64_t l = 0; l < LANES; ++l) {
    int32_t bits;
    std::memcpy(&bits, scores + l, sizeof bits);
    bits ^= (bits >> 31) & 0x7fffffff;
    best = std::min(best, int64_t(bits) * (int64_t(1) << 32) + blocks[l] * LANES + l);
  }
  return best & (LANES - 1);
}

// K-means of `count` points: starts from points evenly spread along the running sum of their weights.
void split_group(const float* points, const float* weights, int64_t count, int64_t dims, int64_t num_centres, int iterations,
                 float* centres) {
  double total = 0;
  for (int64_t i = 0; i < count; ++i) total += weights[i];
  double sum = 0;
  int64_t chosen = 0;
  for (int64_t i = 0; i < count && chosen < num_centres; ++i) {
    sum += weights[i];
    // A row is taken if its weight passes the next mark, and wherever no more rows are left than marks.
    if (sum * num_centres >= (chosen + 0.5) * total || count - i <= num_centres - chosen) {
      std::memcpy(centres + chosen * dims, points + i * dims, dims * sizeof(float));
      ++chosen;
    }
  }
  Scratch<float> blocks = allocate<float>(floats_for(num_centres, dims));
  std::vector<double> sums(num_centres * (dims + 1));
  for (int iteration = 0; iteration < iterations; ++iteration) {
    const Centres arranged = arrange(centres, num_centres, dims, blocks.get());
    std::fill(sums.begin(), sums.end(), 0.0);
    each_nearest(
        arranged, count, [&](int64_t k) { return points + k * dims; },
        [&](int64_t k, float, int64_t centre) {
          double* row = &sums[centre * (dims + 1)];
          const double w = weights[k];
          for (int64_t d = 0; d < dims; ++d) row[d] += w * points[k * dims + d];
          row[dims] += w;
        });
    for (int64_t c = 0; c < num_centres; ++c) {
      const double* row = &sums[c * (dims + 1)];
      if (row[dims] > 0)  // a centre that no point is nearest to stays where it is
        for (int64_t d = 0; d < dims; ++d) centres[c * dims + d] = float(row[d] / row[dims]);
    }
  }
}

}  // namespace

void nearest_few(const Points& points, const float* centres, int64_t num_centres, int64_t num_near, int32_t* near, int threads) {
  Scratch<float> blocks = allocate<float>(floats_for(num_centres, points.dims));
  const Centres arranged = arrange(centres, num_centres, points.dims, blocks.get());
  parallel_ranges(points.count, POINTS_PER_CHUNK, threads, [&](int64_t begin, int64_t end) {
    const auto at = [&](int64_t k) { return points.values + (begin + k) * points.dims; };
    each_four(end - begin, at, [&](const float* const* four, int64_t first) {
      LaneMinima minima;
      kernels().nearest_lanes(arranged, four, &minima);
      for (int64_t p = 0; p < POINTS_AT_ONCE && begin + first + p < end; ++p) {
        int32_t* out = near + (begin + first + p) * num_near;
        for (int64_t j = 0; j < num_near; ++j) {
          const int64_t lane = best_lane(minima.score[p], minima.block[p]);
          out[j] = int32_t(minima.block[p][lane] * LANES + lane);
          minima.score[p][lane] = std::numeric_limits<float>::infinity();
        }
      }
    });
  });
}

void split_groups(const Points& points, const float* weights, const int64_t* start, const int32_t* rows,
                  const int64_t* first_centre, int64_t num_groups, int iterations, float* centres, int threads) {
  const int64_t dims = points.dims;
  parallel_chunks(num_groups, threads, [&](int64_t g) {
    const int64_t count = start[g + 1] - start[g];
    Scratch<float> gathered = allocate<float>(count * (dims + 1));  // stays in the second-level cache for all iterations
    float* own_weights = gathered.get() + count * dims;
    for (int64_t k = 0; k < count; ++k) {
      const int64_t row = rows[start[g] + k];
      std::memcpy(gathered.get() + k * dims, points.values + row * dims, dims * sizeof(float));
      own_weights[k] = weights[row];
    }
    split_group(gathered.get(), own_weights, count, dims, first_centre[g + 1] - first_centre[g], iterations,
                centres + first_centre[g] * dims);
  });
}

void nearest_in_groups(const Points& points, const float* centres, const int64_t* first_centre, int64_t num_groups,
                       const int32_t* near, int64_t num_near, int32_t* label, int threads) {
  const int64_t n = points.count, dims = points.dims;
  std::vector<int64_t> first_float(num_groups + 1);
  for (int64_t g = 0; g < num_groups; ++g)
    first_float[g + 1] = first_float[g] + floats_for(first_centre[g + 1] - first_centre[g], dims);
  Scratch<float> blocks = allocate<float>(first_float[num_groups]);
  parallel_chunks(num_groups, threads, [&](int64_t g) {
    arrange(centres + first_centre[g] * dims, first_centre[g + 1] - first_centre[g], dims, blocks.get() + first_float[g]);
  });

  Scratch<float> best = allocate<float>(n);
  Scratch<int32_t> rows = allocate<int32_t>(n);
  std::fill(best.get(), best.get() + n, std::numeric_limits<float>::infinity());
  std::vector<int64_t> start(num_groups + 1);
  // One round for each place in `near`: its rows are sorted by group, so that no two threads meet at a row.
  for (int64_t j = 0; j < num_near; ++j) {
    std::fill(start.begin(), start.end(), 0);
    for (int64_t i = 0; i < n; ++i) ++start[near[i * num_near + j] + 1];
    for (int64_t g = 0; g < num_groups; ++g) start[g + 1] += start[g];
    std::vector<int64_t> next(start.begin(), start.end() - 1);
    for (int64_t i = 0; i < n; ++i) rows[next[near[i * num_near + j]]++] = int32_t(i);
    parallel_chunks(num_groups, threads, [&](int64_t g) {
      const int64_t num_centres = first_centre[g + 1] - first_centre[g];
      if (num_centres == 0) return;
      const int32_t* own = rows.get() + start[g];
      each_nearest(
          Centres{blocks.get() + first_float[g], blocks_for(num_centres), dims}, start[g + 1] - start[g],
          [&](int64_t k) { return points.values + int64_t(own[k]) * dims; },
          [&](int64_t k, float score, int64_t centre) {
            if (score < best[own[k]]) {
              best[own[k]] = score;
              label[own[k]] = int32_t(first_centre[g] + centre);
            }
          });
    });
  }
}

void label_means(const float* vectors, int64_t stride, int64_t width, const float* weights, const int64_t* start,
                 const int32_t* rows, int64_t num_labels, float* means, int threads) {
  parallel_ranges(num_labels, 64, threads, [&](int64_t begin, int64_t end) {
    std::vector<double> sums(width);
    for (int64_t l = begin; l < end; ++l) {
      std::fill(sums.begin(), sums.end(), 0.0);
      double total = 0;
      for (int64_t k = start[l]; k < start[l + 1]; ++k) {
        const float* vector = vectors + rows[k] * stride;
        const double w = weights[rows[k]];
        for (int64_t j = 0; j < width; ++j) sums[j] += w * vector[j];
        total += w;
      }
      for (int64_t j = 0; j < width; ++j) means[l * width + j] = total > 0 ? float(sums[j] / total) : 0.f;
    }
  });
}

void add_to_sums(const float* vectors, int64_t stride, int64_t width, const float* weights, const int32_t* labels,
                 int64_t num_rows, double* sums) {
  constexpr int64_t AHEAD = 4;  // rows between the fetch of a label's sums and their use
  for (int64_t i = 0; i < num_rows; ++i) {
    const double* later = sums + labels[i + AHEAD < num_rows ? i + AHEAD : i] * (width + 1);
    for (int64_t j = 0; j <= width; j += 8) __builtin_prefetch(later + j, 1);
    double* row = sums + labels[i] * (width + 1);
    const double w = weights[i];
    for (int64_t j = 0; j < width; ++j) row[j] += w * vectors[i * stride + j];
    row[width] += w;
  }
}

int64_t distinct_rows(const float* vectors, int64_t stride, int64_t width, int64_t num_rows, const DistinctRows& known,
                      int64_t count, int32_t* label) {
  const auto bytes = static_cast<size_t>(width) * sizeof(float);
  const uint64_t mask = uint64_t(known.num_slots - 1);
  for (int64_t i = 0; i < num_rows; ++i) {
    const float* row = vectors + i * stride;
    uint64_t hash = 0;
    for (int64_t j = 0; j < width; ++j) {
      uint32_t bits;
      std::memcpy(&bits, row + j, sizeof bits);
      hash = (hash ^ bits) * 0x9e3779b97f4a7c15u;
      hash ^= hash >> 29;
    }
    uint64_t slot = hash & mask;
    while (known.label_from_slot[slot] >= 0 && std::memcmp(known.entries + known.label_from_slot[slot] * width, row, bytes) != 0)
      slot = (slot + 1) & mask;
    if (known.label_from_slot[slot] < 0) {
      if (count == known.limit) return -1;
      std::memcpy(known.entries + count * width, row, bytes);
      known.label_from_slot[slot] = int32_t(count++);
    }
    label[i] = known.label_from_slot[slot];
  }
  return count;
}

}  // namespace splatree
