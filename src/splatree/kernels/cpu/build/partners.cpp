// Neighbours are looked for where too few are left; merging carries them on. So a round costs what it changes: about half a
// microsecond for each row whose partner is to be found among known ones, a quarter for each other row.
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

void find_partner(const PairJob& job, const PairRecord* records, int64_t row, const PartnerColumns& columns) {
  const int32_t* neighbors = columns.neighbors + PAIR_NEIGHBORS * row;
  PairCandidates pair{&records[row], {}, count_neighbors(neighbors)};
  columns.is_stale[row] = 0;
  if (pair.count == 0) {  // all others are farther than float32 can square
    columns.rows[row] = -1, columns.opacities[row] = 0;
    columns.costs[row] = columns.sigmas[row] = HUGE_VALF;
    return;
  }
  for (int k = 0; k < PAIR_NEIGHBORS; ++k) pair.others[k] = &records[neighbors[k < pair.count ? k : 0]];
  const PairCost cheapest = kernels().cheapest_pair(pair);
  columns.rows[row] = neighbors[cheapest.best];
  columns.costs[row] = cheapest.cost;
  columns.opacities[row] = cheapest.opacity;
  columns.sigmas[row] = merged_sigma(records[row], *pair.others[cheapest.best], job.dilation);
}

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

// Neighbours of a group, each once, none of them itself.
struct Candidates {
  int32_t groups[2 * PAIR_NEIGHBORS];
  int count = 0;

  void add(const int32_t* neighbors, const int32_t* group_from_row, int64_t self) {
    for (int k = 0; k < PAIR_NEIGHBORS && neighbors[k] >= 0; ++k) {
      const int32_t group = group_from_row[neighbors[k]];
      if (group != self && std::find(groups, groups + count, group) == groups + count) groups[count++] = group;
    }
  }

  void keep_nearest(const float* means, int64_t self) {
    if (count <= PAIR_NEIGHBORS) return;
    Nearest nearest;
    for (int c = 0; c < count; ++c) {
      float distance2 = 0;
      for (int a = 0; a < 3; ++a) {
        const float d = means[3 * int64_t{groups[c]} + a] - means[3 * self + a];
        distance2 += d * d;
      }
      if (distance2 < nearest.bound()) nearest.offer(distance2, groups[c]);
    }
    count = nearest.count;
    std::copy(nearest.rows, nearest.rows + count, groups);
  }
};

}  // namespace

void find_neighbors(int64_t n, const float* means, const PartnerColumns& columns, int threads) {
  if (n < 2) return;
  const BoxTree tree(n, means, threads);
  parallel_ranges(tree.num_leaves, 256, threads, [&](int64_t first, int64_t last) {
    for (int64_t leaf = first; leaf < last; ++leaf) {
      const int64_t begin = first_of(tree, leaf), end = first_of(tree, leaf + 1);
      LeafNeighbors found;
      uint32_t wanted = 0;
      for (int64_t lane = 0; lane < LEAF_POINTS; ++lane) {
        const bool is_wanted =
            begin + lane < end && count_neighbors(columns.neighbors + PAIR_NEIGHBORS * int64_t{tree.rows[begin + lane]}) < FEW;
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
        columns.is_stale[row] = 1;
      }
    }
  });
}

void find_partners(const PairJob& job, const PartnerColumns& columns) {
  Scratch<PairRecord> records = allocate<PairRecord>(job.n);
  parallel_ranges(job.n, 1 << 13, job.threads, [&](int64_t begin, int64_t end) {
    for (int64_t row = begin; row < end; ++row) records[row] = record_of(job, row);
  });
  parallel_ranges(job.n, 1 << 11, job.threads, [&](int64_t begin, int64_t end) {
    for (int64_t row = begin; row < end; ++row)
      if (columns.is_stale[row]) find_partner(job, records.get(), row, columns);
  });
}

void carry_partners(const PairGroups& groups, const float* means, const PartnerColumns& from, const PartnerColumns& to,
                    int threads) {
  parallel_ranges(groups.num_groups, 1 << 12, threads, [&](int64_t begin, int64_t end) {
    for (int64_t g = begin; g < end; ++g) {
      const int64_t size = groups.start[g + 1] - groups.start[g];
      Candidates candidates;
      for (int64_t i = groups.start[g]; i < groups.start[g + 1]; ++i)
        candidates.add(from.neighbors + PAIR_NEIGHBORS * int64_t{groups.rows[i]}, groups.group_from_row, g);
      candidates.keep_nearest(means, g);
      int32_t* neighbors = to.neighbors + PAIR_NEIGHBORS * g;
      std::fill(neighbors, neighbors + PAIR_NEIGHBORS, -1);
      std::copy(candidates.groups, candidates.groups + candidates.count, neighbors);

      const int64_t row = groups.representatives[g];
      const int32_t partner = from.rows[row] < 0 ? -1 : groups.group_from_row[from.rows[row]];
      const bool merged = size > 1 || (partner >= 0 && groups.start[partner + 1] - groups.start[partner] > 1);
      to.rows[g] = partner;
      to.costs[g] = from.costs[row];
      to.opacities[g] = from.opacities[row];
      to.sigmas[g] = from.sigmas[row];
      to.is_stale[g] = from.is_stale[row] | merged;
    }
  });
}

}  // namespace splatree
