// Moments of the leaves below each node, and what they show at the pixel of its level (reference/curves.py).
//
// A first pass adds up the moments from children to parents: means and covariances of parts, so that nothing cancels. A second
// finds each node's axes, then adds what its leaves show at its own dilation: a node's leaves are one run of the list of leaves.
// Each sum is of one thread, in the order of the rows: the same bits for any number of threads.
// Cost: a covariance a leaf, an eigen-decomposition a node, three roots for each leaf and node above it (0.6 CPU-seconds a
// million leaves). Memory: 32 bytes a leaf, 104 an inner node.
//
// Where leaves stand for leaves elsewhere, they come with the moments of these, and the sums at a node's dilation are made by
// `add_shown`, leaf by leaf in the same order: what is written has the bits that the whole tree gives.
#include "cpu/build/curves.h"

#include <algorithm>
#include <cmath>
#include <cstring>

#include "cpu/build/covariance.h"
#include "cpu/build/eigen.h"
#include "cpu/build/subtrees.h"
#include "cpu/runtime/pool.h"
#include "cpu/runtime/scratch.h"
#include "shared/constants.h"

namespace splatree {
namespace {

constexpr double LEAST_VARIANCE = 1e-24, LEAST_WEIGHT = 1e-12, LEAST_OPACITY = 1e-6, LARGEST = 1e15, WIDENING = 0.3;

struct Leaf {
  double variance[3];
  float alpha, weight;  // opacity α, and α v
};

struct Moments {
  double mean[3], covariance[6];   // of the mixture with the weights α v
  double alpha, weight;            // Σ α, Σ α v
  double bare_alpha, bare_weight;  // Σ α A(0), Σ α v A(0)
};
static_assert(sizeof(Moments) == MOMENTS * sizeof(double));

// 3 A(h)
double area(const double* variance, double h) {
  const double a = std::sqrt(variance[0] + h), b = std::sqrt(variance[1] + h), c = std::sqrt(variance[2] + h);
  return a * b + b * c + a * c;
}

Leaf leaf_of(const float* log_scales, float logit_opacity, float seen) {
  Leaf leaf;
  for (int a = 0; a < 3; ++a) leaf.variance[a] = std::exp(2 * std::min<double>(log_scales[a], constants::MERGED_LOG_SCALE_MAX));
  const double alpha = 1 / (1 + std::exp(-static_cast<double>(logit_opacity)));
  leaf.alpha = static_cast<float>(alpha);
  leaf.weight = static_cast<float>(std::max(alpha * seen, LEAST_WEIGHT));
  return leaf;
}

// Σ α 3A(h) and Σ α v 3A(h) of leaves, added to sums.
void add_leaves(const Leaf* leaves, int64_t n, double h, double* sums) {
  double alpha = sums[0], weight = sums[1];
  for (int64_t i = 0; i < n; ++i) {
    const double each = area(leaves[i].variance, h);
    alpha += leaves[i].alpha * each, weight += leaves[i].weight * each;
  }
  sums[0] = alpha, sums[1] = weight;
}

class Fitter {
 public:
  explicit Fitter(const CurvesJob& job) : job_(job), leaves_before_(allocate<int32_t>(job.n + 1)) {
    leaves_before_[0] = 0;
    for (int64_t i = 0; i < job.n; ++i) leaves_before_[i + 1] = leaves_before_[i] + (job.subtree_end[i] == i + 1);
    if (!job.below) leaves_ = allocate<Leaf>(leaves_before_[job.n]);
    moments_ = allocate<Moments>(job.n - leaves_before_[job.n]);
  }

  void fit() {
    add_up();
    parallel_ranges(job_.n, 1 << 8, job_.threads, [&](int64_t begin, int64_t end) {
      for (int64_t row = begin; row < end; ++row) {
        if (is_leaf(row))
          std::fill_n(job_.curves + 4 * row, 4, 0.f);
        else
          write(row);
      }
    });
  }

  void write_roots(double* out) {
    add_up();
    for (int64_t row = 0; row < job_.n; row = job_.subtree_end[row], out += MOMENTS) {
      const Moments root = is_leaf(row) ? of_leaf(row) : moments(row);
      std::memcpy(out, &root, sizeof root);
    }
  }

 private:
  bool is_leaf(int64_t row) const { return job_.subtree_end[row] == row + 1; }
  int64_t inner(int64_t row) const { return row - leaves_before_[row]; }
  Moments& moments(int64_t row) const { return moments_[inner(row)]; }

  void add_up() {
    from_children_to_parents(job_.n, job_.subtree_end, job_.threads, [&](int64_t row) {
      if (!is_leaf(row))
        add_children(row);
      else if (!job_.below)
        leaves_[leaves_before_[row]] = leaf_of(job_.log_scales + 3 * row, job_.logit_opacities[row], job_.seen[row]);
    });
  }

  Moments of_leaf(int64_t row) const {
    if (job_.below) {
      Moments m;
      std::memcpy(&m, job_.below + MOMENTS * static_cast<int64_t>(leaves_before_[row]), sizeof m);
      return m;
    }
    const Leaf& leaf = leaves_[leaves_before_[row]];
    Moments m;
    for (int a = 0; a < 3; ++a) m.mean[a] = job_.means[3 * row + a];
    covariance_from(job_.quats + 4 * row, leaf.variance, m.covariance);
    m.alpha = leaf.alpha, m.weight = leaf.weight;
    const double bare = area(leaf.variance, 0) / 3;
    m.bare_alpha = leaf.alpha * bare, m.bare_weight = leaf.weight * bare;
    return m;
  }

  template <class Visit>
  void each_child(int64_t row, const Visit& visit) const {
    for (int64_t child = row + 1; child < job_.subtree_end[row]; child = job_.subtree_end[child])
      visit(is_leaf(child) ? of_leaf(child) : moments(child));
  }

  void add_children(int64_t row) {
    Moments sum{};
    each_child(row, [&](const Moments& child) {
      sum.alpha += child.alpha, sum.weight += child.weight;
      sum.bare_alpha += child.bare_alpha, sum.bare_weight += child.bare_weight;
      for (int a = 0; a < 3; ++a) sum.mean[a] += child.weight * child.mean[a];
    });
    for (double& x : sum.mean) x /= sum.weight;
    each_child(row, [&](const Moments& child) {
      const double share = child.weight / sum.weight;
      double apart[3];
      for (int a = 0; a < 3; ++a) apart[a] = child.mean[a] - sum.mean[a];
      for (int i = 0, k = 0; i < 3; ++i)
        for (int j = i; j < 3; ++j, ++k) sum.covariance[k] += share * (child.covariance[k] + apart[i] * apart[j]);
    });
    moments(row) = sum;
  }

  void write(int64_t row) const {
    double variance[3];
    const double extent = job_.extents[row],
                 scale = extent <= job_.kept_extent ? keep(row, variance) : become_moments(row, variance);
    const double h = std::max({job_.dilation_share * (extent * extent), job_.least_dilation, 1e-30});
    const double mass = scale * shown(row, h) / area(variance, h);  // G(h_l)
    const double wide = std::pow(std::max(mass / constants::ALPHA_MAX, 1.0), WIDENING);
    const double opacity = std::min(std::max(mass, LEAST_OPACITY), constants::ALPHA_MAX);
    for (int a = 0; a < 3; ++a) {
      const double log_scale = 0.5 * std::log(wide * variance[a] + (wide - 1) * h);
      job_.log_scales[3 * row + a] = static_cast<float>(std::min(log_scale, constants::MERGED_LOG_SCALE_MAX));
    }
    job_.logit_opacities[row] = static_cast<float>(std::log(opacity) - std::log1p(-opacity));
    write_curve(row, scale, mass, h);
  }

  // The variances of the node as it is; returns the factor that makes the mass of its leaves what it shows itself.
  double keep(int64_t row, double* variance) const {
    for (int a = 0; a < 3; ++a)
      variance[a] =
          std::max(std::exp(2 * std::min<double>(job_.log_scales[3 * row + a], constants::MERGED_LOG_SCALE_MAX)), LEAST_VARIANCE);
    const double alpha = std::min(1 / (1 + std::exp(-static_cast<double>(job_.logit_opacities[row]))), constants::ALPHA_MAX);
    const double mass = shown(row, job_.kept_dilation);
    return mass > 0 ? alpha * area(variance, job_.kept_dilation) / mass : 1;  // 0 of leaves that are all invisible
  }

  // The variances of the moments of the leaves; writes their mean and axes.
  double become_moments(int64_t row, double* variance) const {
    const Moments& m = moments(row);
    const double* c = m.covariance;
    double matrix[3][3] = {{c[0], c[1], c[2]}, {c[1], c[3], c[4]}, {c[2], c[4], c[5]}}, rotation[9];
    eigen_symmetric(matrix, variance, rotation);
    for (int a = 0; a < 3; ++a) variance[a] = std::max(variance[a], LEAST_VARIANCE);
    for (int a = 0; a < 3; ++a) job_.means[3 * row + a] = static_cast<float>(m.mean[a]);
    quat_from_rotation(rotation, job_.quats + 4 * row);
    return 1;
  }

  // √(Σ α 3 A(h) Σ α v 3 A(h))
  double shown(int64_t row, double h) const {
    if (job_.sums) return std::sqrt(job_.sums[2 * inner(row)] * job_.sums[2 * inner(row) + 1]);
    double sums[2] = {0, 0};
    const int32_t first = leaves_before_[row];
    add_leaves(&leaves_[first], leaves_before_[job_.subtree_end[row]] - first, h, sums);
    return std::sqrt(sums[0] * sums[1]);
  }

  void write_curve(int64_t row, double scale, double mass, double h) const {
    const Moments& m = moments(row);
    const double curve[4] = {scale * std::sqrt(m.bare_alpha * m.bare_weight), scale * std::sqrt(m.alpha * m.weight), mass, h};
    const bool is_sane = std::all_of(curve, curve + 4, [](double x) { return x < LARGEST; });
    for (int k = 0; k < 4; ++k) job_.curves[4 * row + k] = is_sane ? static_cast<float>(curve[k]) : 0.f;
  }

  const CurvesJob& job_;
  Scratch<int32_t> leaves_before_;
  Scratch<Leaf> leaves_;
  Scratch<Moments> moments_;
};

}  // namespace

void fit_curves(const CurvesJob& job) { Fitter(job).fit(); }

void root_moments(const CurvesJob& job, double* moments) { Fitter(job).write_roots(moments); }

// A thread takes some of the nodes, so each sum is of one thread.
void add_shown(const ShownJob& job) {
  Scratch<Leaf> leaves = allocate<Leaf>(job.n);
  parallel_ranges(job.n, 1 << 12, job.threads, [&](int64_t begin, int64_t end) {
    for (int64_t i = begin; i < end; ++i) leaves[i] = leaf_of(job.log_scales + 3 * i, job.logit_opacities[i], job.seen[i]);
  });
  parallel_ranges(job.num_nodes, 1, job.threads, [&](int64_t first, int64_t last) {
    for (int64_t node = first; node < last; ++node) {
      const int64_t begin = std::max<int64_t>(job.begin[node] - job.first, 0);
      const int64_t end = std::min(job.end[node] - job.first, job.n);
      if (begin < end) add_leaves(&leaves[begin], end - begin, job.dilations[node], job.sums + 2 * node);
    }
  });
}

}  // namespace splatree
