#include "cpu/build/cells.h"

#include <cstring>
#include <vector>

#include "cpu/runtime/pool.h"
#include "cpu/runtime/radix.h"

namespace splatree::thinning {
namespace {

uint64_t priority_of(float importance, uint32_t row) {
  uint32_t bits;
  importance += 0.0f;  // −0 and 0 are equal
  std::memcpy(&bits, &importance, sizeof bits);
  const uint32_t rising = bits & 0x80000000u ? ~bits : bits | 0x80000000u;
  return (uint64_t{~rising} << 32) | row;
}

}  // namespace

Lattice::Lattice(int64_t n, const float* means, double radius, int threads) {
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

}  // namespace splatree::thinning
