// Radius thinning by rounds over a sorted grid.
//
// Points are sorted by cell (edge ≥ r, x the highest digit, z the lowest), inside a cell by priority. The 27 cells around a
// cell are then nine runs of up to three consecutive cells, and as a walk over the cells moves forward, so do the nine
// beginnings: no hash table, nothing stored per cell. A point scans the earlier points within r: a representative among them
// makes it a member, an undecided one makes it wait *there*, an end without either makes it a representative. Who waits goes
// on where it stopped once that neighbour is decided, so each candidate is looked at about once in all rounds together. A
// round reads only what earlier rounds decided: the result and the number of rounds do not depend on the threads.
//
// Where the change of the picture counts, two points within r are neighbours only if merging them changes it by at most `most`.
// A merge changes no more than leaving both out, which is known at once and decides for most. The others are taken up to eight at
// a time, the lanes of a vector.
//
// For a part of a scene, rows near its edge are *open*: neighbours of theirs may be missing, so nothing is known of them. A third
// status, unknown, spreads from them only as far as it has to. What is decided is what the whole scene would decide.
//
// Cost: one radix sort, then O(n · points in 27 cells); 16 + 16 bytes a point while sorting, 32 + 10 after. A third of a
// microsecond for each eight candidates whose changes are computed.
// Not vectorised: the scans are short (a few dozen candidates), branchy and bound by memory.
#include "cpu/build/thin.h"

#include <algorithm>
#include <atomic>
#include <cmath>
#include <cstring>
#include <limits>
#include <vector>

#include "cpu/build/cells.h"
#include "cpu/runtime/isa.h"
#include "cpu/runtime/pool.h"

namespace splatree {
namespace {

using namespace thinning;

enum Status : uint8_t { UNDECIDED, MEMBER, REPRESENTATIVE, UNKNOWN };

// Where an undecided point goes on scanning: at sorted position `position` in column `column`.
struct Waiting {
  uint32_t point;
  uint32_t cell;
  uint32_t position;
  int16_t column;
  bool saw_unknown;  // an unknown neighbour, which may be a representative
};

// A point within r, and where it was found.
struct Near {
  uint32_t position;
  int16_t column;
};

// Points within r of a point, until they are asked whether merging would change little enough.
class Batch {
 public:
  Batch(const Cells& cells, const ThinJob& job) : cells_(cells), job_(job), vector_(kernels()) {}

  // Calls `visit(near)` with those that are neighbours, in the order of adding, until it returns true; whether it did. What is
  // not known at once waits for others, or for the end.
  template <typename Visit>
  bool add(const Point& p, Near near, Visit visit) {
    if (!job_.records || changes_little(record_of(p), record_at(near))) return end(p, visit) || visit(near);
    near_[count_++] = near;
    return count_ == PAIR_NEIGHBORS && end(p, visit);
  }

  // The same with all that wait.
  template <typename Visit>
  bool end(const Point& p, Visit visit) {
    const int count = count_;
    count_ = 0;
    if (count == 0) return false;
    PairCandidates pair{&record_of(p), {}, count};
    for (int l = 0; l < PAIR_NEIGHBORS; ++l) pair.others[l] = &record_at(near_[l < count ? l : 0]);
    alignas(64) float costs[PAIR_NEIGHBORS];
    vector_.costs_of_pairs(pair, costs);
    for (int l = 0; l < count; ++l)
      if (costs[l] <= job_.most && visit(near_[l])) return true;
    return false;
  }

 private:
  const PairRecord& record_of(const Point& p) const { return job_.records[row_of(p)]; }
  const PairRecord& record_at(Near near) const { return record_of(cells_.points[near.position]); }

  // E ≤ ∫ |p + q|² ≤ 2 ∫ |p|² + 2 ∫ |q|².
  bool changes_little(const PairRecord& p, const PairRecord& q) const { return 2 * (p.energy + q.energy) <= job_.most; }

  const Cells& cells_;
  const ThinJob& job_;
  const Kernels& vector_;
  Near near_[PAIR_NEIGHBORS];
  int count_ = 0;
};

// The earlier points of p's neighbourhood from `waiting` on; returns its status as far as known.
Status scan(const Cells& cells, Columns& columns, const Metric& metric, const uint8_t* status, Batch& batch, Waiting& waiting,
            int64_t& visited) {
  const Point& p = cells.points[waiting.point];
  Status found = UNDECIDED;
  const auto ends_with = [&](Near near) {
    if (status[near.position] == REPRESENTATIVE) {
      found = MEMBER;
      return true;
    }
    if (status[near.position] == UNKNOWN) {
      waiting.saw_unknown = true;
      return false;
    }
    waiting.position = near.position;
    waiting.column = near.column;
    return true;
  };
  uint32_t from = waiting.position;
  for (int k = waiting.column; k < COLUMNS; ++k, from = 0)
    for (int64_t c = columns.first(k); c < cells.num_cells && cells.keys[c] <= columns.last_key(k); ++c)
      for (uint32_t j = std::max(from, cells.start[c]); j < cells.start[c + 1]; ++j) {
        const Point& q = cells.points[j];
        if (q.priority >= p.priority) break;
        ++visited;
        if (status[j] == MEMBER || !(metric.distance2(p, q) <= metric.radius2)) continue;
        if (batch.add(p, {j, static_cast<int16_t>(k)}, ends_with)) return found;
      }
  if (batch.end(p, ends_with)) return found;
  return waiting.saw_unknown ? UNKNOWN : REPRESENTATIVE;
}

Scratch<uint8_t> decide(const Lattice& lattice, const Cells& cells, const Metric& metric, ThinJob& job) {
  constexpr int64_t GRAIN = 1 << 14;
  const int64_t n = cells.num_points;
  Scratch<uint8_t> status = allocate<uint8_t>(n), next = allocate<uint8_t>(n);
  std::memset(status.get(), UNDECIDED, n);
  std::memset(next.get(), UNDECIDED, n);
  std::atomic<int64_t> visited{0};
  Scratch<Waiting> waiting = allocate<Waiting>(n);
  parallel_ranges(cells.num_cells, GRAIN, job.threads, [&](int64_t first, int64_t last) {
    for (int64_t c = first; c < last; ++c)
      for (uint32_t i = cells.start[c]; i < cells.start[c + 1]; ++i) waiting[i] = {i, static_cast<uint32_t>(c), 0, 0, false};
  });
  if (job.is_open)
    for (int64_t i = 0; i < n; ++i)
      if (job.is_open[row_of(cells.points[i])]) status[i] = next[i] = UNKNOWN;
  job.rounds = 0;
  for (int64_t size = n; size > 0;) {
    ++job.rounds;
    parallel_ranges(size, GRAIN, job.threads, [&](int64_t begin, int64_t end) {
      Columns columns(lattice, cells);
      Batch batch(cells, job);
      int64_t cell = -1, count = 0;
      for (int64_t w = begin; w < end; ++w) {
        Waiting& waits = waiting[w];
        if (next[waits.point] == UNKNOWN) continue;  // open
        // The neighbour it waits for is still undecided (position 0 may also mean: not begun; then it scans).
        if (job.rounds > 1) {
          const uint8_t seen = status[waits.position];
          if (seen == UNDECIDED) continue;
          if (seen == REPRESENTATIVE) {
            next[waits.point] = MEMBER;
            continue;
          }
        }
        if (waits.cell != cell) columns.move_to(cells.keys[cell = waits.cell]);
        next[waits.point] = scan(cells, columns, metric, status.get(), batch, waits, count);
      }
      visited.fetch_add(count, std::memory_order_relaxed);
    });
    // What was decided becomes visible; the rest waits on, in the order of the cells.
    const int64_t num_chunks = (size + GRAIN - 1) / GRAIN;
    std::vector<int64_t> kept(num_chunks + 1, 0);
    parallel_chunks(num_chunks, job.threads, [&](int64_t chunk) {
      int64_t count = 0;
      for (int64_t w = chunk * GRAIN; w < std::min(size, (chunk + 1) * GRAIN); ++w) {
        const uint32_t point = waiting[w].point;
        status[point] = next[point];
        if (status[point] == UNDECIDED) waiting[chunk * GRAIN + count++] = waiting[w];
      }
      kept[chunk + 1] = count;
    });
    int64_t total = 0;
    for (int64_t chunk = 0; chunk < num_chunks; ++chunk) {
      std::copy_n(&waiting[chunk * GRAIN], kept[chunk + 1], &waiting[total]);
      total += kept[chunk + 1];
    }
    size = total;
  }
  job.num_visited = visited.load();
  return status;
}

// The points that may be representatives: those that are, and those of which nothing is known.
Cells candidates_of(const Cells& cells, const uint8_t* status) {
  Cells kept;
  kept.keys = allocate<uint64_t>(cells.num_cells);
  kept.start = allocate<uint32_t>(cells.num_cells + 1);
  kept.points = allocate<Point>(cells.num_points);
  for (int64_t c = 0; c < cells.num_cells; ++c) {
    const int64_t begin = kept.num_points;
    for (uint32_t i = cells.start[c]; i < cells.start[c + 1]; ++i)
      if (status[i] == REPRESENTATIVE || status[i] == UNKNOWN) kept.points[kept.num_points++] = cells.points[i];
    if (kept.num_points > begin) {
      kept.keys[kept.num_cells] = cells.keys[c];
      kept.start[kept.num_cells++] = static_cast<uint32_t>(begin);
    }
  }
  kept.start[kept.num_cells] = static_cast<uint32_t>(kept.num_points);
  return kept;
}

}  // namespace

void thin(ThinJob& job) {
  job.rounds = 0;
  job.num_visited = 0;
  if (job.n == 0) return;
  const Metric metric(job.radius, job.color_radius);
  const Lattice lattice(job.n, job.means, job.radius, job.threads);
  const Cells cells = sort_into_cells(lattice, job.n, job.means, job.colors, job.importance, job.threads);
  const Scratch<uint8_t> status = decide(lattice, cells, metric, job);
  if (!job.assign) {
    for (int64_t i = 0; i < job.n; ++i) {
      const int32_t row = static_cast<int32_t>(row_of(cells.points[i]));
      job.representative_from_row[row] = status[i] == REPRESENTATIVE ? row : -1;
    }
    return;
  }
  const Cells kept = candidates_of(cells, status.get());
  Scratch<uint8_t> is_unknown = allocate<uint8_t>(job.is_open ? job.n : 0);  // by row
  if (job.is_open)
    for (int64_t i = 0; i < job.n; ++i) is_unknown[row_of(cells.points[i])] = status[i] == UNKNOWN;
  std::atomic<int64_t> visited{0};
  parallel_ranges(cells.num_cells, 1 << 12, job.threads, [&](int64_t first, int64_t last) {
    Columns columns(lattice, kept);
    Batch batch(kept, job);
    int64_t count = 0;
    for (int64_t c = first; c < last; ++c) {
      columns.move_to(cells.keys[c]);
      for (uint32_t i = cells.start[c]; i < cells.start[c + 1]; ++i) {
        const Point& p = cells.points[i];
        const int32_t row = static_cast<int32_t>(row_of(p));
        int32_t nearest = status[i] == UNKNOWN ? -1 : row;
        if (status[i] == MEMBER) {
          double best = std::numeric_limits<double>::infinity();
          uint64_t best_priority = 0;
          const auto is_nearer = [&](const Point& q, double distance2) {
            return distance2 < best || (distance2 == best && q.priority < best_priority);
          };
          const auto take = [&](Near near) {
            const Point& q = kept.points[near.position];
            const double distance2 = metric.distance2(p, q);
            if (is_nearer(q, distance2)) {
              best = distance2;
              best_priority = q.priority;
              nearest = static_cast<int32_t>(row_of(q));
            }
            return false;
          };
          for (int k = 0; k < COLUMNS; ++k)
            for (int64_t d = columns.first(k); d < kept.num_cells && kept.keys[d] <= columns.last_key(k); ++d)
              for (uint32_t j = kept.start[d]; j < kept.start[d + 1]; ++j) {
                const Point& q = kept.points[j];
                if (q.priority >= p.priority) break;
                ++count;
                const double distance2 = metric.distance2(p, q);
                if (!(distance2 <= metric.radius2) || !is_nearer(q, distance2)) continue;
                batch.add(p, {j, static_cast<int16_t>(k)}, take);
              }
          batch.end(p, take);
        }
        if (job.is_open && nearest >= 0 && is_unknown[nearest]) nearest = -1;  // which may be the nearest, or none
        job.representative_from_row[row] = nearest;
      }
    }
    visited.fetch_add(count, std::memory_order_relaxed);
  });
  job.num_visited += visited.load();
}

void nearest_distances(int64_t n, const float* means, int64_t num_queries, const int32_t* queries, double edge, double* distances,
                       int threads) {
  const Lattice lattice(n, means, edge, threads);
  const Cells cells = sort_into_cells(lattice, n, means, nullptr, nullptr, threads);
  const Metric metric(edge, std::numeric_limits<double>::infinity());
  parallel_ranges(num_queries, 64, threads, [&](int64_t begin, int64_t end) {
    for (int64_t q = begin; q < end; ++q) {
      Point point{};
      std::memcpy(point.mean, means + 3 * int64_t{queries[q]}, sizeof point.mean);
      Columns columns(lattice, cells);
      columns.move_to(lattice.key(point.mean));
      double best = std::numeric_limits<double>::infinity();
      for (int k = 0; k < COLUMNS; ++k)
        for (int64_t d = columns.first(k); d < cells.num_cells && cells.keys[d] <= columns.last_key(k); ++d)
          for (uint32_t j = cells.start[d]; j < cells.start[d + 1]; ++j)
            if (row_of(cells.points[j]) != static_cast<uint32_t>(queries[q]))
              best = std::min(best, metric.distance2(point, cells.points[j]));
      distances[q] = best <= metric.radius2 ? std::sqrt(best) : std::numeric_limits<double>::infinity();
    }
  });
}

}  // namespace splatree
