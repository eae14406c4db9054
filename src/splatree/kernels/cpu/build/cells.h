// Points sorted into cells of a grid, and the walk over the 27 cells around a cell, for thinning (thin.cpp) and for nearest
// distances.
#pragma once
#include <algorithm>
#include <cmath>
#include <cstdint>

#include "cpu/runtime/scratch.h"

namespace splatree::thinning {

constexpr int64_t CELL_MAX = (int64_t{1} << 21) - 4;  // cells along an axis; with a free one at either end, 3 × 21 bits
constexpr int COLUMNS = 9;

struct Point {
  float mean[3];
  float color[3];
  uint64_t priority;  // smaller is earlier: falling importance, then rising row
};
static_assert(sizeof(Point) == 32, "two points a cache line");

inline uint32_t row_of(const Point& p) { return static_cast<uint32_t>(p.priority); }

// Cells along each axis, around the middle of the scene. Far outliers share the outermost cells: clamping moves cells
// together, never apart, so neighbours stay neighbours. The edge grows above r where most of the scene would not fit. A key has
// the x cell in its highest bits, just as many bits as the cells of each axis need, and a free cell at either end: a step to a
// neighbour never carries into the next axis.
struct Lattice {
  double origin[3], inverse_edge;
  int64_t first[3];
  int shift[3];

  Lattice(int64_t n, const float* means, double radius, int threads);

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

// `colors` and `importance` may be null. Inside a cell points stand by priority.
Cells sort_into_cells(const Lattice& lattice, int64_t n, const float* means, const float* colors, const float* importance,
                      int threads);

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

}  // namespace splatree::thinning
