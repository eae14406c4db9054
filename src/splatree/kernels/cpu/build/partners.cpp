// Neighbours are looked for where too few are left; merging carries them on. So a round costs what it changes: about a third of a
// microsecond for each row whose partner is to be found among known ones.
#include "cpu/build/partners.h"

#include <algorithm>
#include <cmath>
#include <cstring>

#include "cpu/build/box_tree.h"
#include "cpu/build/neighbors.h"
#include "cpu/runtime/isa.h"
#include "cpu/runtime/pool.h"
#include "cpu/runtime/scratch.h"

namespace splatree {
namespace {

constexpr int FEW = PAIR_NEIGHBORS * 3 / 4;

int count_neighbors(const int32_t* neighbors) {
  int count = 0;
  while (count < PAIR_NEIGHBORS && neighbors[count] >= 0) ++count;
  return count;
}

bool has_few(const PartnerColumns& columns, int64_t row) { return columns.neighbors[PAIR_NEIGHBORS * row + FEW - 1] < 0; }

// The covariance of two merged, xx xy xz yy yz zz, and the mean of its diagonal.
struct MergedCovariance {
  double m[6], mean;

  MergedCovariance(const PairRecord& p, const PairRecord& q) {
    const double share = double{q.weight} / (double{p.weight} + q.weight), rest = 1 - share;
    for (int i = 0, k = 0; i < 3; ++i)
      for (int j = i; j < 3; ++j, ++k)
        m[k] = rest * p.covariance[k] + share * q.covariance[k] +
               share * rest * (double{q.mean[i]} - p.mean[i]) * (double{q.mean[j]} - p.mean[j]);
    mean = (m[0] + m[3] + m[5]) / 3;
  }
};

float sigma_of(double variance, double dilation) { return static_cast<float>(std::sqrt(std::max(variance - dilation, 0.0))); }

// The nearest points of one, by rising distance.
struct Nearest {
  int count = 0;
  float distances2[PAIR_NEIGHBORS];
  int32_t rows[PAIR_NEIGHBORS];

  float bound() const { return count < PAIR_NEIGHBORS ? HUGE_VALF : distances2[PAIR_NEIGHBORS - 1]; }

  // A point nearer than bound().
  void offer(float distance2, int32_t row) {
    int i = count < PAIR_NEIGHBORS ? count++ : count - 1;
    for (; i > 0 && distances2[i - 1] > distance2; --i) {
      distances2[i] = distances2[i - 1];
      rows[i] = rows[i - 1];
    }
    distances2[i] = distance2;
    rows[i] = row;
  }
};

// Candidates of a row, each once, none of them itself.
struct Candidates {
  int32_t rows[2 * PAIR_NEIGHBORS];
  int count = 0;

  void add(const int32_t* neighbors, const int32_t* to, int64_t self) {
    for (int k = 0; k < PAIR_NEIGHBORS && neighbors[k] >= 0; ++k) {
      const int32_t row = to[neighbors[k]];
      if (row != self && std::find(rows, rows + count, row) == rows + count) rows[count++] = row;
    }
  }

  void keep_nearest(const float* means, int64_t self) {
    if (count <= PAIR_NEIGHBORS) return;
    Nearest nearest;
    for (int c = 0; c < count; ++c) {
      float distance2 = 0;
      for (int a = 0; a < 3; ++a) {
        const float d = means[3 * int64_t{rows[c]} + a] - means[3 * self + a];
        distance2 += d * d;
      }
      if (distance2 < nearest.bound()) nearest.offer(distance2, rows[c]);
    }
    count = nearest.count;
    std::copy(nearest.rows, nearest.rows + count, rows);
  }
};

}  // namespace

void find_neighbors(int64_t n, const float* means, const PartnerColumns& columns, int threads) {
  if (n < 2) return;
  int64_t num_wanted = 0;
  for (int64_t row = 0; row < n; ++row) num_wanted += has_few(columns, row);
  if (num_wanted == 0) return;
  const BoxTree tree(n, means, threads);
  parallel_ranges(tree.num_leaves, 256, threads, [&](int64_t first, int64_t last) {
    for (int64_t leaf = first; leaf < last; ++leaf) {
      const int64_t begin = first_of(tree, leaf), end = first_of(tree, leaf + 1);
      LeafNeighbors found;
      uint32_t wanted = 0;
      for (int64_t lane = 0; lane < LEAF_POINTS; ++lane) {
        const bool is_wanted = begin + lane < end && has_few(columns, tree.rows[begin + lane]);
        reset_list(found, lane, is_wanted);
        wanted |= uint32_t{is_wanted} << lane;
      }
      if (!wanted) continue;
      kernels().nearest_of_leaf(tree, leaf, found);
      for (int64_t i = begin; i < end; ++i) {
        if (!(wanted >> (i - begin) & 1)) continue;
        const int64_t row = tree.rows[i];
        const int count = size_of_list(found, i - begin);
        for (int k = 0; k < PAIR_NEIGHBORS; ++k)
          columns.neighbors[PAIR_NEIGHBORS * row + k] = k < count ? tree.rows[found.places[k][i - begin]] : -1;
        columns.states[row] = STALE;
      }
    }
  });
}

void keep_partners(int64_t n, const uint8_t* is_kept, const PartnerColumns& from, const PartnerColumns& to, int threads) {
  Scratch<int32_t> number = allocate<int32_t>(n);
  int32_t num_kept = 0;
  for (int64_t row = 0; row < n; ++row) number[row] = is_kept[row] ? num_kept++ : -1;
  parallel_ranges(n, 1 << 12, threads, [&](int64_t begin, int64_t end) {
    for (int64_t row = begin; row < end; ++row) {
      if (!is_kept[row]) continue;
      const int64_t kept = number[row];
      const int32_t* neighbors = from.neighbors + PAIR_NEIGHBORS * row;
      int32_t* list = to.neighbors + PAIR_NEIGHBORS * kept;
      int count = 0, num_before = 0;
      for (; num_before < PAIR_NEIGHBORS && neighbors[num_before] >= 0; ++num_before)
        if (number[neighbors[num_before]] >= 0) list[count++] = number[neighbors[num_before]];
      const bool has_lost = count < num_before;
      while (count < PAIR_NEIGHBORS) list[count++] = -1;

      const int32_t partner = from.rows[row] < 0 ? -1 : number[from.rows[row]];
      to.rows[kept] = partner;
      to.costs[kept] = from.costs[row];
      to.opacities[kept] = from.opacities[row];
      to.least_sigmas[kept] = from.least_sigmas[row];
      to.states[kept] = partner < 0 ? STALE : std::max(from.states[row], has_lost ? OUTDATED : FOUND);
    }
  });
}

void find_partner(const PairRecord* records, int64_t row, double dilation, const PartnerColumns& columns) {
  const int32_t* neighbors = columns.neighbors + PAIR_NEIGHBORS * row;
  PairCandidates pair{&records[row], {}, count_neighbors(neighbors)};
  columns.states[row] = FOUND;
  if (pair.count == 0) {  // all others are farther than float32 can square
    columns.rows[row] = -1, columns.opacities[row] = 0;
    columns.costs[row] = columns.least_sigmas[row] = HUGE_VALF;
    return;
  }
  for (int k = 0; k < PAIR_NEIGHBORS; ++k) pair.others[k] = &records[neighbors[k < pair.count ? k : 0]];
  const PairCost cheapest = kernels().cheapest_pair(pair);
  columns.rows[row] = neighbors[cheapest.best];
  columns.costs[row] = cheapest.cost;
  columns.opacities[row] = cheapest.opacity;
  columns.least_sigmas[row] = sigma_of(MergedCovariance(records[row], *pair.others[cheapest.best]).mean, dilation);
}

// The largest root of the characteristic polynomial of the covariance (Smith 1961). It is no less than the mean of the roots, in
// floating point, too: the cosine is not below 0.
float merged_sigma(const PairRecord& p, const PairRecord& q, double dilation) {
  const MergedCovariance covariance(p, q);
  const double *m = covariance.m, mean = covariance.mean;
  const double xx = m[0] - mean, yy = m[3] - mean, zz = m[5] - mean, xy = m[1], xz = m[2], yz = m[4];
  const double spread2 = (xx * xx + yy * yy + zz * zz + 2 * (xy * xy + xz * xz + yz * yz)) / 6, spread = std::sqrt(spread2);
  const double determinant = xx * (yy * zz - yz * yz) - xy * (xy * zz - yz * xz) + xz * (xy * yz - yy * xz);
  const double cosine = spread2 > 0 ? determinant / (2 * spread2 * spread) : 1;
  const double largest = mean + 2 * spread * std::cos(std::acos(std::min(std::max(cosine, -1.0), 1.0)) / 3);
  return sigma_of(largest, dilation);
}

void follow_moves(const Moves& moves, const float* means, int64_t row, int64_t other, const PartnerColumns& columns) {
  int32_t* neighbors = columns.neighbors + PAIR_NEIGHBORS * row;
  bool has_moved = other >= 0;
  for (int k = 0; k < PAIR_NEIGHBORS && neighbors[k] >= 0; ++k) has_moved |= moves.is_new[neighbors[k]] != 0;
  if (!has_moved) return;
  const bool is_merged = other >= 0 || (columns.rows[row] >= 0 && moves.is_new[columns.rows[row]]);
  columns.states[row] = is_merged ? STALE : std::max(columns.states[row], OUTDATED);
  Candidates candidates;
  candidates.add(neighbors, moves.to, row);
  if (other >= 0) candidates.add(columns.neighbors + PAIR_NEIGHBORS * other, moves.to, row);
  candidates.keep_nearest(means, row);
  std::fill(neighbors, neighbors + PAIR_NEIGHBORS, -1);
  std::copy(candidates.rows, candidates.rows + candidates.count, neighbors);
}

}  // namespace splatree
