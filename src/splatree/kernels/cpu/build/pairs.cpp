// The cheapest partner of each Gaussian among its nearest neighbours (neighbors.h), and the matching of pairs.
//
// Rows are taken a leaf of the tree (box_tree.h) at a time. Cost: O(n log n), about a microsecond and a half a row.
#include "cpu/build/pairs.h"

#include <algorithm>
#include <cmath>
#include <cstring>

#include "cpu/build/box_tree.h"
#include "cpu/build/covariance.h"
#include "cpu/build/neighbors.h"
#include "cpu/runtime/isa.h"
#include "cpu/runtime/pool.h"
#include "cpu/runtime/radix.h"
#include "cpu/runtime/scratch.h"
#include "shared/constants.h"

namespace splatree {
namespace {

constexpr float ROUNDNESS = 1.0f / 256;  // a splat thinner than this share of its length counts as that thick
constexpr float LOG_SCALE_MAX = 20;      // beyond, float32 could not hold the square of an area
constexpr float SH_C0 = float(constants::SH_C0);

}  // namespace

PairRecord record_of(const PairJob& job, int64_t row) {
  PairRecord r;
  float variance[3], largest = 0;
  for (int a = 0; a < 3; ++a) {
    r.mean[a] = job.means[3 * row + a];
    variance[a] = std::exp(2 * std::min(std::max(job.log_scales[3 * row + a], -LOG_SCALE_MAX), LOG_SCALE_MAX));
    largest = std::max(largest, variance[a]);
  }
  const float added = static_cast<float>(job.dilation) + ROUNDNESS * ROUNDNESS * largest;
  covariance_from(job.quats + 4 * row, variance, r.covariance);
  for (const int diagonal : {0, 3, 5}) r.covariance[diagonal] += added;
  r.visibility = job.visibilities ? job.visibilities[row] : 1;
  r.opacity = r.visibility / (1 + std::exp(-job.logit_opacities[row]));
  r.weight = job.weights[row];
  float color2 = 1;
  for (int c = 0; c < 3; ++c) {
    r.color[c] = std::max(job.sh[3 * job.k * row + c] * SH_C0 + 0.5f, 0.0f);
    color2 += r.color[c] * r.color[c];
  }
  const float* v = r.covariance;
  const auto area = [](float a, float b, float c) { return std::sqrt(std::max(a * c - b * b, 1e-6f * a * c)); };
  r.energy = r.opacity * r.opacity * color2 * (area(v[0], v[1], v[3]) + area(v[0], v[2], v[5]) + area(v[3], v[4], v[5]));
  return r;
}

void best_partners(const PairJob& job) {
  const int64_t n = job.n;
  if (n < 2) {
    if (n) job.partner_from_row[0] = -1, job.costs[0] = HUGE_VALF, job.opacities[0] = 0;
    return;
  }
  const BoxTree tree(n, job.means, job.threads);
  Scratch<PairRecord> records = allocate<PairRecord>(n);
  parallel_ranges(n, 1 << 13, job.threads, [&](int64_t begin, int64_t end) {
    for (int64_t i = begin; i < end; ++i) records[i] = record_of(job, tree.rows[i]);
  });
  const Kernels& vector = kernels();
  parallel_ranges(tree.num_leaves, 256, job.threads, [&](int64_t first, int64_t last) {
    for (int64_t leaf = first; leaf < last; ++leaf) {
      const int64_t begin = first_of(tree, leaf), end = first_of(tree, leaf + 1);
      LeafNeighbors found;
      for (int64_t lane = 0; lane < LEAF_POINTS; ++lane) reset_list(found, lane, begin + lane < end);
      vector.nearest_of_leaf(tree, leaf, found);
      for (int64_t i = begin; i < end; ++i) {
        const int64_t lane = i - begin;
        PairCandidates pair{&records[i], {}, size_of_list(found, lane)};
        const int32_t row = tree.rows[i];
        if (pair.count == 0) {  // all others are farther than float32 can square
          job.partner_from_row[row] = -1, job.costs[row] = HUGE_VALF, job.opacities[row] = 0;
          continue;
        }
        for (int k = 0; k < PAIR_NEIGHBORS; ++k) pair.others[k] = &records[found.places[k < pair.count ? k : 0][lane]];
        const PairCost cheapest = vector.cheapest_pair(pair);
        job.partner_from_row[row] = tree.rows[found.places[cheapest.best][lane]];
        job.costs[row] = cheapest.cost;
        job.opacities[row] = cheapest.opacity;
      }
    }
  });
}

KeyRow by_cost(float cost, int64_t row) {
  uint32_t bits;
  cost = std::max(cost, 0.0f);  // rounding may leave a little less than nothing
  std::memcpy(&bits, &cost, sizeof bits);
  return {bits, static_cast<uint32_t>(row)};
}

std::vector<FoundPair> cheapest_pairs(Scratch<KeyRow>& listed, int64_t num_listed, const int32_t* partner_from_row,
                                      int64_t max_pairs, uint8_t* is_taken, int threads) {
  radix_sort(listed, num_listed, threads);
  std::vector<FoundPair> pairs;
  for (int64_t i = 0; i < num_listed && int64_t(pairs.size()) < max_pairs; ++i) {
    const int32_t row = static_cast<int32_t>(listed[i].row), partner = partner_from_row[row];
    if (is_taken[row] || is_taken[partner]) continue;
    is_taken[row] = is_taken[partner] = 1;
    pairs.push_back({row, partner});
  }
  return pairs;
}

int64_t match_pairs(int64_t n, const int32_t* partner_from_row, const float* costs, int64_t max_pairs,
                    int32_t* representative_from_row, int threads) {
  Scratch<KeyRow> listed = allocate<KeyRow>(n);
  Scratch<uint8_t> is_taken = allocate<uint8_t>(n);
  int64_t num_listed = 0;
  for (int64_t i = 0; i < n; ++i) {
    if (partner_from_row[i] >= 0) listed[num_listed++] = by_cost(costs[i], i);
    representative_from_row[i] = static_cast<int32_t>(i);
    is_taken[i] = 0;
  }
  const std::vector<FoundPair> pairs = cheapest_pairs(listed, num_listed, partner_from_row, max_pairs, is_taken.get(), threads);
  for (const FoundPair& pair : pairs) representative_from_row[pair.partner] = pair.finder;
  return int64_t(pairs.size());
}

}  // namespace splatree
