// Radius thinning by rounds over a sorted grid.
//
// Points are sorted by cell (edge ≥ r, x the highest digit, z the lowest), inside a cell by priority. The 27 cells around a
// cell are then nine runs of up to three consecutive cells, and as a walk over the cells moves forward, so do the nine
// beginnings: no hash table, nothing stored per cell. A point scans the earlier points within r: a representative among them
// makes it a member, an undecided one makes it wait *there*, an end without either makes it a representative. Who waits goes
// on where it stopped once that neighbour is decided, so each candidate is looked at about once in all rounds together. A
// round reads only what earlier rounds decided: the result and the number of rounds do not depend on the threads.
//
// Cost: one radix sort, then O(n · points in 27 cells); 16 + 16 bytes a point while sorting, 32 + 10 after.
// Not vectorised: the scans are short (a few dozen candidates), branchy and bound by memory.
#include "cpu/build/thin.h"

#include <algorithm>
#include <atomic>
#include <cmath>
#include <cstring>
#include <limits>
#include <vector>

#include "cpu/runtime/pool.h"
#include "cpu/runtime/radix.h"
#include "cpu/runtime/scratch.h"

namespace splatree {
namespace {

constexpr int64_t CELL_MAX = (int64_t{1} << 21) - 4;  // cells along an axis; with a free one at either end, 3 × 21 bits
constexpr int COLUMNS = 9;

struct Point {
  float mean[3];
  float color[3];
  uint64_t priority;  // smaller is earlier: falling importance, then rising row
};
static_assert(sizeof(Point) == 32, "two points a cache line");

uint32_t row_of(const Point& p) { return static_cast<uint32_t>(p.priority); }

uint64_t priority_of(float importance, uint32_t row) {
  uint32_t bits;
  importance += 0.0f;  // −0 and 0 are equal
  std::memcpy(&bits, &importance, sizeof bits);
  const uint32_t rising = bits & 0x80000000u ? ~bits : bits | 0x80000000u;
  return (uint64_t{~rising} << 32) | row;
}

// Cells along each axis, around the middle of the scene. Far outliers share the outermost cells: clamping moves cells
// together, never apart, so neighbours stay neighbours. The edge grows above r where most of the scene would not fit. A key has
// the x cell in its highest bits, just as many bits as the cells of each axis need, and a free cell at either end: a step to a
// neighbour never carries into the next axis.
struct Lattice {
  double origin[3], inverse_edge;
  int64_t first[3];
  int shift[3];

  Lattice(int64_t n, const float* means, double radius, int threads) {
    constexpr int64_t SAMPLES = 4096;
    const int64_t stride = n / SAMPLES + 1;
    double span = 0;
    std::vector<float> values;
    for (int a = 0; a < 3; ++a) {
      values.clear();
      for (int64_t i = 0; i < n; i += stride) values.push_back(means[3 * i + a]);
      std::sort(values.begin(), values.end());
      const size_t trimmed = values.size() / 256;
      origin[a] = values[values.size() / 2];
      span = std::max({span, origin[a] - values[trimmed], values[values.size() - 1 - trimmed] - origin[a]});
    }
    // The margin covers the rounding of the product in cell().
    const double edge = std::max({radius * (1 + 1e-6), span / (CELL_MAX / 2 - 1), 1e-300});
    inverse_edge = 1 / edge;

    constexpr int64_t GRAIN = 1 << 16;
    const int64_t num_chunks = (n + GRAIN - 1) / GRAIN;
    std::vector<float> bounds(6 * num_chunks);
    parallel_chunks(num_chunks, threads, [&](int64_t chunk) {
      float* bound = &bounds[6 * chunk];
      for (int a = 0; a < 3; ++a) bound[a] = bound[3 + a] = means[3 * chunk * GRAIN + a];
      for (int64_t i = chunk * GRAIN; i < std::min(n, (chunk + 1) * GRAIN); ++i)
        for (int a = 0; a < 3; ++a) {
          bound[a] = std::min(bound[a], means[3 * i + a]);
          bound[3 + a] = std::max(bound[3 + a], means[3 * i + a]);
        }
    });
    int bits = 0;
    for (int a = 2; a >= 0; --a) {
      int64_t low = CELL_MAX, high = -CELL_MAX;
      for (int64_t chunk = 0; chunk < num_chunks; ++chunk) {
        low = std::min(low, cell(bounds[6 * chunk + a], a));
        high = std::max(high, cell(bounds[6 * chunk + 3 + a], a));
      }
      first[a] = low - 1;
      shift[a] = bits;
      while (high + 1 - first[a] >= int64_t{1} << (bits - shift[a])) ++bits;
    }
  }

  int64_t cell(float coordinate, int axis) const {
    const double c = std::floor((coordinate - origin[axis]) * inverse_edge);
    return static_cast<int64_t>(std::min<double>(std::max<double>(c, -CELL_MAX / 2), CELL_MAX / 2));
  }

  uint64_t key(const float* mean) const {
    uint64_t key = 0;
    for (int a = 0; a < 3; ++a) key |= static_cast<uint64_t>(cell(mean[a], a) - first[a]) << shift[a];
    return key;
  }
};

// Points in runs of one cell each, cells by rising key.
struct Cells {
  int64_t num_cells = 0, num_points = 0;
  Scratch<uint64_t> keys;
  Scratch<uint32_t> start;  // one more than keys
  Scratch<Point> points;
};

Cells sort_into_cells(const Lattice& lattice, int64_t n, const float* means, const float* colors, const float* importance,
                      int threads) {
  Scratch<KeyRow> items = allocate<KeyRow>(n);
  parallel_ranges(n, 1 << 15, threads, [&](int64_t begin, int64_t end) {
    for (int64_t i = begin; i < end; ++i) items[i] = {lattice.key(means + 3 * i), static_cast<uint32_t>(i)};
  });
  radix_sort(items, n, threads);
  Cells cells;
  cells.num_points = n;
  cells.points = allocate<Point>(n);
  for (int64_t i = 0; i < n; ++i) cells.num_cells += i == 0 || items[i].key != items[i - 1].key;
  cells.keys = allocate<uint64_t>(cells.num_cells);
  cells.start = allocate<uint32_t>(cells.num_cells + 1);
  int64_t cell = 0;
  for (int64_t i = 0; i < n; ++i)
    if (i == 0 || items[i].key != items[i - 1].key) {
      cells.keys[cell] = items[i].key;
      cells.start[cell++] = static_cast<uint32_t>(i);
    }
  cells.start[cell] = static_cast<uint32_t>(n);
  parallel_ranges(cells.num_cells, 1 << 13, threads, [&](int64_t first, int64_t last) {
    for (int64_t c = first; c < last; ++c) {
      Point* begin = &cells.points[cells.start[c]];
      Point* end = begin;
      for (uint32_t i = cells.start[c]; i < cells.start[c + 1]; ++i, ++end) {
        const uint32_t row = items[i].row;
        std::memcpy(end->mean, means + 3 * int64_t{row}, sizeof end->mean);
        if (colors)
          std::memcpy(end->color, colors + 3 * int64_t{row}, sizeof end->color);
        else
          std::memset(end->color, 0, sizeof end->color);
        end->priority = priority_of(importance ? importance[row] : 0.0f, row);
      }
      std::sort(begin, end, [](const Point& a, const Point& b) { return a.priority < b.priority; });
    }
  });
  return cells;
}

// The nine runs of cells around a cell, for cells visited in rising order. The column of the cell itself comes first: it
// decides most points. Others are looked up only when asked for.
class Columns {
 public:
  Columns(const Lattice& lattice, const Cells& cells) : cells_(cells) {
    static constexpr int DX[COLUMNS] = {0, 0, 0, -1, 1, -1, -1, 1, 1}, DY[COLUMNS] = {0, -1, 1, 0, 0, -1, 1, -1, 1};
    for (int k = 0; k < COLUMNS; ++k) {
      first_[k] = 0;
      step_[k] = (static_cast<uint64_t>(int64_t{DX[k]}) << lattice.shift[0]) +
                 (static_cast<uint64_t>(int64_t{DY[k]}) << lattice.shift[1]);
    }
  }

  void move_to(uint64_t key) {
    key_ = key;
    sought_ = 0;
  }

  int64_t first(int k) {
    if (!(sought_ >> k & 1)) {
      seek(k, base(k) - 1);
      sought_ |= 1u << k;
    }
    return first_[k];
  }
  uint64_t last_key(int k) const { return base(k) + 1; }

 private:
  uint64_t base(int k) const { return key_ + step_[k]; }

  // The first cell with at least `key`, from where the last search ended: mostly a few cells on, else by galloping.
  void seek(int k, uint64_t key) {
    constexpr int NEAR = 8;
    const uint64_t* keys = cells_.keys.get();
    int64_t low = first_[k];
    for (const int64_t near = std::min(low + NEAR, cells_.num_cells); low < near; ++low)
      if (keys[low] >= key) {
        first_[k] = low;
        return;
      }
    int64_t step = 1;
    while (low + step < cells_.num_cells && keys[low + step] < key) {
      low += step;
      step *= 2;
    }
    const int64_t high = std::min(cells_.num_cells, low + step + 1);
    first_[k] = std::lower_bound(keys + low, keys + high, key) - keys;
  }

  const Cells& cells_;
  uint64_t key_ = 0;
  uint32_t sought_ = 0;  // bit k: first_[k] belongs to key_
  uint64_t step_[COLUMNS];
  int64_t first_[COLUMNS];
};

struct Metric {
  double radius2, color_factor;

  Metric(double radius, double color_radius) : radius2(radius * radius) {
    color_factor = std::isinf(color_radius) ? 0.0 : radius2 / (color_radius * color_radius);
  }

  // |Δx|² + r²/ρ² |Δc|², added in the order of the reference, so that both round alike.
  double distance2(const Point& p, const Point& q) const {
    const double x = double{p.mean[0]} - q.mean[0], y = double{p.mean[1]} - q.mean[1], z = double{p.mean[2]} - q.mean[2];
    const double position = x * x + y * y + z * z;
    if (!(position <= radius2)) return position;
    const double r = double{p.color[0]} - q.color[0], g = double{p.color[1]} - q.color[1], b = double{p.color[2]} - q.color[2];
    return position + color_factor * (r * r + g * g + b * b);
  }
};

enum Status : uint8_t { UNDECIDED, MEMBER, REPRESENTATIVE };

// Where an undecided point goes on scanning: at sorted position `position` in column `column`.
struct Waiting {
  uint32_t point;
  uint32_t cell;
  uint32_t position;
  int32_t column;
};

// The earlier points of p's neighbourhood from `waiting` on; returns its status as far as known.
Status scan(const Cells& cells, Columns& columns, const Metric& metric, const uint8_t* status, Waiting& waiting,
            int64_t& visited) {
  const Point& p = cells.points[waiting.point];
  uint32_t from = waiting.position;
  for (int k = waiting.column; k < COLUMNS; ++k, from = 0)
    for (int64_t c = columns.first(k); c < cells.num_cells && cells.keys[c] <= columns.last_key(k); ++c)
      for (uint32_t j = std::max(from, cells.start[c]); j < cells.start[c + 1]; ++j) {
        const Point& q = cells.points[j];
        if (q.priority >= p.priority) break;
        ++visited;
        if (status[j] == MEMBER || !(metric.distance2(p, q) <= metric.radius2)) continue;
        if (status[j] == REPRESENTATIVE) return MEMBER;
        waiting.position = j;
        waiting.column = k;
        return UNDECIDED;
      }
  return REPRESENTATIVE;
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
      for (uint32_t i = cells.start[c]; i < cells.start[c + 1]; ++i) waiting[i] = {i, static_cast<uint32_t>(c), 0, 0};
  });
  job.rounds = 0;
  for (int64_t size = n; size > 0;) {
    ++job.rounds;
    parallel_ranges(size, GRAIN, job.threads, [&](int64_t begin, int64_t end) {
      Columns columns(lattice, cells);
      int64_t cell = -1, count = 0;
      for (int64_t w = begin; w < end; ++w) {
        Waiting& waits = waiting[w];
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
        next[waits.point] = scan(cells, columns, metric, status.get(), waits, count);
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

Cells representatives_of(const Cells& cells, const uint8_t* status) {
  Cells kept;
  kept.keys = allocate<uint64_t>(cells.num_cells);
  kept.start = allocate<uint32_t>(cells.num_cells + 1);
  kept.points = allocate<Point>(cells.num_points);
  for (int64_t c = 0; c < cells.num_cells; ++c) {
    const int64_t begin = kept.num_points;
    for (uint32_t i = cells.start[c]; i < cells.start[c + 1]; ++i)
      if (status[i] == REPRESENTATIVE) kept.points[kept.num_points++] = cells.points[i];
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
  const Cells kept = representatives_of(cells, status.get());
  std::atomic<int64_t> visited{0};
  parallel_ranges(cells.num_cells, 1 << 12, job.threads, [&](int64_t first, int64_t last) {
    Columns columns(lattice, kept);
    int64_t count = 0;
    for (int64_t c = first; c < last; ++c) {
      columns.move_to(cells.keys[c]);
      for (uint32_t i = cells.start[c]; i < cells.start[c + 1]; ++i) {
        const Point& p = cells.points[i];
        const int32_t row = static_cast<int32_t>(row_of(p));
        int32_t nearest = row;
        if (status[i] == MEMBER) {
          double best = std::numeric_limits<double>::infinity();
          uint64_t best_priority = 0;
          for (int k = 0; k < COLUMNS; ++k)
            for (int64_t d = columns.first(k); d < kept.num_cells && kept.keys[d] <= columns.last_key(k); ++d)
              for (uint32_t j = kept.start[d]; j < kept.start[d + 1]; ++j) {
                const Point& q = kept.points[j];
                if (q.priority >= p.priority) break;
                ++count;
                const double distance2 = metric.distance2(p, q);
                if (!(distance2 <= metric.radius2)) continue;
                if (distance2 < best || (distance2 == best && q.priority < best_priority)) {
                  best = distance2;
                  best_priority = q.priority;
                  nearest = static_cast<int32_t>(row_of(q));
                }
              }
        }
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
