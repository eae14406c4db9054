// Dynamic programming: the best k + 1 intervals of the first j numbers are the best k of the first i and the rest, for the best
// i. That i does not decrease with j (Wu 1991, "Optimal quantization by matrix searching"), so it is found by halving: for the
// middle j by looking at all i between the neighbours' answers. Cost: count · n log n.
#include "cpu/codec/intervals.h"

#include <limits>
#include <utility>
#include <vector>

namespace splatree {
namespace {

struct Search {
  const double *mass, *moment, *square;
  const double* before;  // least error of k intervals over the first i numbers
  double* error;         // of k + 1 intervals over the first j
  int32_t* last;         // where the last of them begins

  double spread(int64_t i, int64_t j) const {  // squared error of the numbers i … j − 1 about their mean
    const double w = mass[j] - mass[i], x = moment[j] - moment[i];
    return w > 0 ? square[j] - square[i] - x * x / w : 0;
  }

  void solve(int64_t first, int64_t end, int64_t lowest, int64_t highest) const {
    if (first >= end) return;
    const int64_t j = first + (end - first) / 2;
    double least = std::numeric_limits<double>::infinity();
    int64_t best = lowest;
    for (int64_t i = lowest; i <= highest && i < j; ++i) {
      const double sum = before[i] + spread(i, j);
      if (sum < least) least = sum, best = i;
    }
    error[j] = least;
    last[j] = static_cast<int32_t>(best);
    solve(first, j, lowest, best);
    solve(j + 1, end, best, highest);
  }
};

}  // namespace

void best_intervals(const double* mass, const double* moment, const double* square, int64_t num_numbers, int64_t count,
                    int64_t* cuts) {
  const int64_t n = num_numbers;
  std::vector<double> before(n + 1), error(n + 1);
  std::vector<int32_t> last(count * (n + 1));
  Search search{mass, moment, square, nullptr, nullptr, nullptr};
  for (int64_t j = 0; j <= n; ++j) before[j] = search.spread(0, j);
  for (int64_t k = 1; k < count; ++k) {
    search.before = before.data(), search.error = error.data(), search.last = last.data() + k * (n + 1);
    search.solve(k + 1, n + 1, k, n);
    std::swap(before, error);
  }
  cuts[count] = n;
  for (int64_t k = count - 1; k > 0; --k) cuts[k] = last[k * (n + 1) + cuts[k + 1]];
  cuts[0] = 0;
}

}  // namespace splatree
