// The nearest neighbours of all points and the matching of pairs.
//
// All points of a leaf of the tree (box_tree.h) look for their neighbours in one walk from the root, the nearer child first,
// which passes over boxes farther than the farthest neighbour that any of them has so far. Cost: O(n log n), about two
// microseconds a point.
// Not vectorised: the walk is branchy; the costs of the candidates are (pair_costs.cpp).
#include "cpu/pairs.h"

#include <algorithm>
#include <cmath>
#include <cstring>

#include "cpu/box_tree.h"
#include "cpu/isa.h"
#include "cpu/pool.h"
#include "cpu/radix.h"
#include "cpu/scratch.h"

namespace splatree {
namespace {

constexpr float kRoundness = 1.0f / 256;  // a splat thinner than this share of its length counts as that thick
constexpr float kLogScaleMax = 20;  // beyond, float32 could not hold the square of an area
constexpr float kShC0 = 0.28209479177387814f;

float distance2(const float* p, const Box& box) {
  float sum = 0;
  for (int a = 0; a < 3; ++a) {
    const float gap = std::max({box.lower[a] - p[a], p[a] - box.upper[a], 0.0f});
    sum += gap * gap;
  }
  return sum;
}

// The nearest points of one, by rising distance, ties by place.
struct Nearest {
  int count = 0;
  float distances2[kPairNeighbors];
  int32_t places[kPairNeighbors];

  // Takes no point any more.
  void close() {
    count = kPairNeighbors;
    distances2[kPairNeighbors - 1] = 0;
  }

  float bound() const { return count < kPairNeighbors ? HUGE_VALF : distances2[kPairNeighbors - 1]; }

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

void find_nearest(const BoxTree& tree, const PairRecord* records, int64_t leaf, Nearest* nearest) {
  const int64_t begin = first_of(tree, leaf), end = first_of(tree, leaf + 1);
  const Box& own = tree.boxes[tree.num_leaves - 1 + leaf];
  struct Entry {
    int64_t node;
    float distance2;
  } stack[128];
  int size = 0;
  stack[size++] = {0, 0.0f};
  float bound = HUGE_VALF;
  while (size > 0) {
    const Entry entry = stack[--size];
    if (entry.distance2 > bound) continue;
    if (!is_leaf(tree, entry.node)) {
      const int64_t left = 2 * entry.node + 1;
      Entry near{left, least_squared_distance(tree.boxes[left], own)}, far{left + 1, least_squared_distance(tree.boxes[left + 1], own)};
      if (far.distance2 < near.distance2) std::swap(near, far);
      stack[size++] = far;
      stack[size++] = near;
      continue;
    }
    const int64_t other = entry.node - (tree.num_leaves - 1);
    const int64_t first = first_of(tree, other);
    const Box& box = tree.boxes[entry.node];
    const BoxLeaf& there = tree.leaves[other];
    bound = 0;
    for (int64_t i = begin; i < end; ++i) {
      Nearest& found = nearest[i - begin];  // of a row that is not wanted the bound is 0
      const float* p = records[i].mean;
      if (!(distance2(p, box) < found.bound())) {
        bound = std::max(bound, found.bound());
        continue;
      }
      float distances2[LEAF_POINTS];
#pragma omp simd
      for (int l = 0; l < LEAF_POINTS; ++l) {
        const float x = p[0] - there.x[l], y = p[1] - there.y[l], z = p[2] - there.z[l];
        distances2[l] = x * x + y * y + z * z;
      }
      for (int l = 0; l < LEAF_POINTS; ++l)
        if (distances2[l] < found.bound() && first + l != i) found.offer(distances2[l], static_cast<int32_t>(first + l));
      bound = std::max(bound, found.bound());
    }
  }
}

PairRecord record_of(const PairJob& job, int64_t row) {
  PairRecord r;
  float variance[3], largest = 0;
  for (int a = 0; a < 3; ++a) {
    r.mean[a] = job.means[3 * row + a];
    variance[a] = std::exp(2 * std::min(std::max(job.log_scales[3 * row + a], -kLogScaleMax), kLogScaleMax));
    largest = std::max(largest, variance[a]);
  }
  const float added = static_cast<float>(job.dilation) + kRoundness * kRoundness * largest;
  const float* q = job.quats + 4 * row;
  const float norm2 = q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3], s = norm2 > 0 ? 2 / norm2 : 0;
  const float w = q[0], x = q[1], y = q[2], z = q[3];
  const float R[3][3] = {{1 - s * (y * y + z * z), s * (x * y - w * z), s * (x * z + w * y)},
                         {s * (x * y + w * z), 1 - s * (x * x + z * z), s * (y * z - w * x)},
                         {s * (x * z - w * y), s * (y * z + w * x), 1 - s * (x * x + y * y)}};
  for (int i = 0, k = 0; i < 3; ++i)
    for (int j = i; j < 3; ++j, ++k)
      r.covariance[k] = R[i][0] * R[j][0] * variance[0] + R[i][1] * R[j][1] * variance[1] +
                        R[i][2] * R[j][2] * variance[2] + (i == j ? added : 0);
  r.visibility = job.visibilities ? job.visibilities[row] : 1;
  r.opacity = r.visibility / (1 + std::exp(-job.logit_opacities[row]));
  r.weight = job.weights[row];
  float color2 = 1;
  for (int c = 0; c < 3; ++c) {
    r.color[c] = std::max(job.sh[3 * job.k * row + c] * kShC0 + 0.5f, 0.0f);
    color2 += r.color[c] * r.color[c];
  }
  const float* v = r.covariance;
  const auto area = [](float a, float b, float c) { return std::sqrt(std::max(a * c - b * b, 1e-6f * a * c)); };
  r.energy = r.opacity * r.opacity * color2 * (area(v[0], v[1], v[3]) + area(v[0], v[2], v[5]) + area(v[3], v[4], v[5]));
  return r;
}

// The longest axis of two merged, less what records add: the largest root of the characteristic polynomial of their covariance
// (Smith 1961).
float merged_sigma(const PairRecord& p, const PairRecord& q, double dilation) {
  const double share = double{q.weight} / (double{p.weight} + q.weight), rest = 1 - share;
  double m[6];
  for (int i = 0, k = 0; i < 3; ++i)
    for (int j = i; j < 3; ++j, ++k)
      m[k] = rest * p.covariance[k] + share * q.covariance[k] +
             share * rest * (double{q.mean[i]} - p.mean[i]) * (double{q.mean[j]} - p.mean[j]);
  const double mean = (m[0] + m[3] + m[5]) / 3;
  const double xx = m[0] - mean, yy = m[3] - mean, zz = m[5] - mean, xy = m[1], xz = m[2], yz = m[4];
  const double spread2 = (xx * xx + yy * yy + zz * zz + 2 * (xy * xy + xz * xz + yz * yz)) / 6, spread = std::sqrt(spread2);
  const double determinant = xx * (yy * zz - yz * yz) - xy * (xy * zz - yz * xz) + xz * (xy * yz - yy * xz);
  const double cosine = spread2 > 0 ? determinant / (2 * spread2 * spread) : 1;
  const double largest = mean + 2 * spread * std::cos(std::acos(std::min(std::max(cosine, -1.0), 1.0)) / 3);
  return static_cast<float>(std::sqrt(std::max(largest - dilation, 0.0)));
}

}  // namespace

void best_partners(const PairJob& job) {
  const int64_t n = job.n;
  if (n < 2) {
    if (n) job.partner_from_row[0] = -1, job.costs[0] = HUGE_VALF, job.opacities[0] = 0;
    if (n && job.sigmas) job.sigmas[0] = HUGE_VALF;
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
      Nearest nearest[LEAF_POINTS];
      const int64_t begin = first_of(tree, leaf), end = first_of(tree, leaf + 1);
      int64_t num_wanted = end - begin;
      for (int64_t i = begin; job.wanted && i < end; ++i)
        if (!job.wanted[tree.rows[i]]) nearest[i - begin].close(), --num_wanted;
      if (num_wanted == 0) continue;
      find_nearest(tree, records.get(), leaf, nearest);
      for (int64_t i = begin; i < end; ++i) {
        const Nearest& found = nearest[i - begin];
        PairCandidates pair{&records[i], {}, found.count};
        const int32_t row = tree.rows[i];
        if (job.wanted && !job.wanted[row]) continue;
        if (found.count == 0) {  // all others are farther than float32 can square
          job.partner_from_row[row] = -1, job.costs[row] = HUGE_VALF, job.opacities[row] = 0;
          if (job.sigmas) job.sigmas[row] = HUGE_VALF;
          continue;
        }
        for (int k = 0; k < kPairNeighbors; ++k) pair.others[k] = &records[found.places[k < found.count ? k : 0]];
        const PairCost cheapest = vector.cheapest_pair(pair);
        job.partner_from_row[row] = tree.rows[found.places[cheapest.best]];
        job.costs[row] = cheapest.cost;
        job.opacities[row] = cheapest.opacity;
        if (job.sigmas) job.sigmas[row] = merged_sigma(records[i], *pair.others[cheapest.best], job.dilation);
      }
    }
  });
}

int64_t match_pairs(int64_t n, const int32_t* partner_from_row, const float* costs, int64_t max_pairs,
                    int32_t* representative_from_row, int threads) {
  Scratch<KeyRow> order = allocate<KeyRow>(n);
  for (int64_t i = 0; i < n; ++i) {
    uint32_t bits;
    const float cost = std::max(costs[i], 0.0f);  // rounding may leave a little less than nothing
    std::memcpy(&bits, &cost, sizeof bits);
    order[i] = {bits, static_cast<uint32_t>(i)};
    representative_from_row[i] = -1;
  }
  radix_sort(order, n, threads);
  int64_t made = 0;
  for (int64_t i = 0; i < n && made < max_pairs; ++i) {
    const int32_t row = static_cast<int32_t>(order[i].row), partner = partner_from_row[row];
    if (partner < 0 || representative_from_row[row] >= 0 || representative_from_row[partner] >= 0) continue;
    representative_from_row[row] = representative_from_row[partner] = row;
    ++made;
  }
  for (int64_t i = 0; i < n; ++i)
    if (representative_from_row[i] < 0) representative_from_row[i] = static_cast<int32_t>(i);
  return made;
}

}  // namespace splatree
