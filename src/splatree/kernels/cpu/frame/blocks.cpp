// The block index of a tree; kernels/reference/blocks.py is the definition. One pass over the rows, limited by memory.
#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>
#include <vector>

#include "cpu/frame/select.h"
#include "cpu/runtime/pool.h"

namespace splatree {
namespace {

constexpr double LN_2 = 0.69314718055994531;
constexpr float INFINITE = std::numeric_limits<float>::infinity();

// Corners of a box that grows; NaN is never drawn and passed over.
struct Box {
  float lower[3] = {INFINITE, INFINITE, INFINITE}, upper[3] = {-INFINITE, -INFINITE, -INFINITE};

  void add(const float* low, const float* high) {
    for (int i = 0; i < 3; ++i) {
      lower[i] = low[i] < lower[i] ? low[i] : lower[i];
      upper[i] = high[i] > upper[i] ? high[i] : upper[i];
    }
  }

  void store(float* low, float* high) const {
    for (int i = 0; i < 3; ++i) low[i] = lower[i], high[i] = upper[i];
  }
};

float lesser(float a, float b) { return a < b ? a : b; }   // a NaN in a gives b
float greater(float a, float b) { return a > b ? a : b; }  // and here

// Of the middle standard deviation, or of a third of the extent if that is less.
uint8_t class_of(const float* log_scales, float log_third) {
  const float a = log_scales[0], b = log_scales[1], c = log_scales[2];
  const float middle = lesser(log_third, greater(lesser(a, b), lesser(greater(a, b), c)));
  const double size_class = std::floor(middle * (CLASSES_PER_OCTAVE / LN_2)) + CLASS_OF_UNIT;
  return uint8_t(size_class > 0 ? size_class < LEAF_CLASS - 1 ? size_class : LEAF_CLASS - 1 : 0);
}

constexpr float RESERVE = 1.f + 1e-5f;  // for the rounding of any exponential in float32

// A row that may be drawn beyond its extent: this, and its largest log-scale.
using Wide = std::pair<float, float>;

// The steps of a block, given the largest log-scale of its leaves and its wide rows, which are sorted.
void store_steps(float leaf, std::vector<Wide>& wide, float* extents, float* scales) {
  std::sort(wide.begin(), wide.end());
  std::vector<Wide> steps{{0.f, leaf}};
  for (const Wide& row : wide) {
    if (!(row.second > steps.back().second)) continue;
    if (steps.size() > 1 && row.first == steps.back().first) steps.pop_back();
    steps.push_back(row);
  }
  // Of too many steps the first ones behind that of the leaves become one: it begins where they begin.
  const int surplus = steps.size() > BLOCK_STEPS ? int(steps.size()) - BLOCK_STEPS : 0;
  for (int i = 0; i < BLOCK_STEPS; ++i) {
    const size_t from = i ? i + surplus : 0;
    const bool is_there = from < steps.size();
    extents[i] = !is_there ? INFINITE : steps[i == 1 ? 1 : from].first;
    scales[i] = std::exp((is_there ? steps[from] : steps.back()).second) * RESERVE;
  }
}

void bound_block(const BoundsJob& job, int64_t block, int64_t begin, int64_t end) {
  Box box;
  float leaf = -INFINITE, logit = INFINITE;
  std::vector<Wide> wide;
  for (int64_t i = begin; i < end; ++i) {
    const float* s = job.log_scales + 3 * i;
    box.add(job.means + 3 * i, job.means + 3 * i);
    logit = lesser(job.logit_opacities[i], logit);
    const bool is_leaf = job.subtree_end[i] == i + 1;
    const float largest = greater(greater(s[0], s[1]), s[2]);
    if (is_leaf) {
      leaf = greater(largest, leaf);
      job.size_classes[i] = LEAF_CLASS;
      continue;
    }
    const float log_third = std::log(job.extents[i] / 3.f);
    if (largest > log_third + 1e-5f) wide.emplace_back(job.extents[i], largest);  // an extent that is 3σ may have been rounded
    const float* mean = job.means + 3 * i;
    const bool has_place = !(std::isnan(mean[0]) || std::isnan(mean[1]) || std::isnan(mean[2]));
    job.size_classes[i] = has_place ? class_of(s, log_third) : uint8_t(UNBOUNDED_CLASS);
  }
  box.store(job.lower + 3 * block, job.upper + 3 * block);
  float* const scales = job.step_scales + BLOCK_STEPS * block;
  store_steps(leaf, wide, job.step_extents + BLOCK_STEPS * block, scales);
  job.leaf_scales[block] = scales[BLOCK_STEPS - 1];
  job.min_logits[block] = logit;
}

}  // namespace

void bound_blocks(const BoundsJob& job) {
  const int64_t num_blocks = (job.num_rows + job.rows_per_block - 1) / job.rows_per_block;
  const int64_t num_groups = (num_blocks + BLOCKS_PER_GROUP - 1) / BLOCKS_PER_GROUP;
  parallel_chunks(num_groups, job.threads, [&](int64_t group) {
    Box box;
    float leaf = 0;
    for (int64_t b = group * BLOCKS_PER_GROUP; b < num_blocks && b < (group + 1) * BLOCKS_PER_GROUP; ++b) {
      const int64_t begin = b * job.rows_per_block, end = begin + job.rows_per_block;
      bound_block(job, b, begin, end < job.num_rows ? end : job.num_rows);
      box.add(job.lower + 3 * b, job.upper + 3 * b);
      leaf = greater(job.leaf_scales[b], leaf);
    }
    box.store(job.group_lower + 3 * group, job.group_upper + 3 * group);
    job.group_leaf_scales[group] = leaf;
  });
}

void each_ancestors(const int32_t* subtree_end, int64_t num_rows, int rows_per_block,
                    void (*visit)(void*, const int32_t*, int64_t), void* context) {
  std::vector<int32_t> path;
  int64_t row = 0;  // the path holds the ancestors of this row
  for (int64_t first = 0; first < num_rows; first += rows_per_block) {
    while (row < first) {
      if (subtree_end[row] <= first) {
        row = subtree_end[row];
      } else {
        path.push_back(int32_t(row));
        ++row;
      }
      while (!path.empty() && subtree_end[path.back()] <= row) path.pop_back();
    }
    visit(context, path.data(), int64_t(path.size()));
  }
}

}  // namespace splatree
