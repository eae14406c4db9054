// The block index of a tree; kernels/reference/blocks.py is the definition. One pass over the rows, limited by memory.
#include <cmath>
#include <limits>
#include <vector>

#include "cpu/pool.h"
#include "cpu/select.h"

namespace splatree {
namespace {

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

// Standard deviations come from float32 logarithms; the reserve covers the rounding of any exponential of them.
float scale_above(float log_scale) { return std::exp(log_scale) * (1.f + 1e-5f); }
float scale_below(float log_scale) { return std::exp(log_scale) * (1.f - 1e-5f); }

float middle_of(const float* v) {
  const float low = std::fmin(v[0], v[1]), high = std::fmax(v[0], v[1]);
  return std::fmax(low, std::fmin(high, v[2]));
}

void bound_block(const BoundsJob& job, int64_t block, int64_t begin, int64_t end) {
  Box box;
  float leaf = -INFINITE, inner = INFINITE, logit = INFINITE;
  for (int64_t i = begin; i < end; ++i) {
    const float* s = job.log_scales + 3 * i;
    box.add(job.means + 3 * i, job.means + 3 * i);
    logit = std::fmin(logit, job.logit_opacities[i]);
    if (job.subtree_end[i] == i + 1)
      leaf = std::fmax(leaf, std::fmax(std::fmax(s[0], s[1]), s[2]));
    else
      inner = std::fmin(inner, middle_of(s));
  }
  box.store(job.lower + 3 * block, job.upper + 3 * block);
  job.leaf_scales[block] = scale_above(leaf);
  job.inner_scales[block] = scale_below(inner);
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
      leaf = std::fmax(leaf, job.leaf_scales[b]);
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
