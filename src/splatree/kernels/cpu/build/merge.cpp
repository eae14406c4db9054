// One Gaussian from each group, in double precision, a group at a time.
//
// Cost: a few hundred nanoseconds a group (one 3×3 eigen-decomposition) and about a hundred a member (an exponential an axis,
// the area's powers). Not vectorised: groups have two to a dozen members, of varying number.
#include "cpu/build/merge.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <vector>

#include "cpu/build/covariance.h"
#include "cpu/build/eigen.h"
#include "cpu/build/subtrees.h"
#include "cpu/runtime/pool.h"
#include "shared/constants.h"

namespace splatree {
namespace {

constexpr double LOG_SCALE_MAX = constants::MERGED_LOG_SCALE_MAX;
constexpr double ALPHA_MAX = constants::MERGED_ALPHA_MAX;
constexpr double AREA_POWER = 1.6075;  // Thomsen's exponent

struct Member {
  double mean[3], variance[3], weight;
  double alpha, depth, log_alpha;  // opacity α, −log(1 − α), log α
};

double clamped_log_scale(float log_scale) { return std::min(std::max<double>(log_scale, -LOG_SCALE_MAX), LOG_SCALE_MAX); }

// Mean projected area / π of an ellipsoid over all directions: a quarter of its surface (Cauchy), the surface by Thomsen's
// formula, within 1.1 %. `log_variance` are twice the logarithms of the semi-axes.
double mean_area(const double* log_variance) {
  const double a = log_variance[0], b = log_variance[1], c = log_variance[2];
  const double largest = std::max({a + b, a + c, b + c});
  const double half = 0.5 * AREA_POWER;
  const double sum = std::exp(half * (a + b - largest)) + std::exp(half * (a + c - largest)) + std::exp(half * (b + c - largest));
  return std::exp(0.5 * largest + std::log(sum / 3) / AREA_POWER);
}

double dilated_area(const double* variance, double added) {
  double log_variance[3];
  for (int a = 0; a < 3; ++a) log_variance[a] = std::log(variance[a] + added);
  return mean_area(log_variance);
}

// Li₂(1 − e^−u) by its series in u (Bernoulli numbers), for 0 ≤ u ≤ 2: the first term left out is below 1e-12.
double dilogarithm_series(double u) {
  constexpr double BERNOULLI[] = {1.0 / 36,
                                  -1.0 / 3600,
                                  1.0 / 211680,
                                  -1.0 / 10886400,
                                  1.0 / 526901760,
                                  -4.0647616451442e-11,
                                  8.9216910204564e-13,
                                  -1.9939295860721e-14,
                                  4.5189800296199e-16,
                                  -1.0356517612182e-17};
  const double u2 = u * u;
  double sum = 0;
  for (int k = 9; k >= 0; --k) sum = sum * u2 + BERNOULLI[k];
  return u - 0.25 * u2 + u * u2 * sum;
}

// Dilogarithm Li₂(α) from u = −log(1 − α) and v = −log α; above u = 2 by Euler's reflection formula.
double dilogarithm(double u, double v) {
  return u <= 2 ? dilogarithm_series(u) : 1.6449340668482264 - u * v - dilogarithm_series(v);
}

double dilogarithm(double u) { return dilogarithm(u, u <= 2 ? 0 : -std::log1p(-std::exp(-u))); }

// u = −log(1 − α) of the opacity with the given dilogarithm, by Newton's method. Li₂(1 − e^−u) is concave in u, so it comes from
// below, beginning with the inverse series.
double inverse_dilogarithm(double value) {
  double u = value + 0.25 * value * value + 7.0 / 72 * value * value * value;
  for (int i = 0; i < 24; ++i) {
    const double step = (value - dilogarithm(u)) * (u > 1e-12 ? std::expm1(u) / u : 1);
    u += step;
    if (std::abs(step) < 1e-10 * u) break;
  }
  return u;
}

// What a stack of Gaussians of optical depth T covers, ∫ 1 − exp(−T g) over a Gaussian g of area 1: Ein(T) = E₁(T) + ln T + γ.
double coverage(double depth) {
  if (depth > 8) return std::log(depth) + 0.57721566490153286;  // E₁ is below 4e-5
  double sum = 0, term = 1;
  for (int k = 1; term > 1e-11; ++k) {
    term *= depth / k;
    sum += (k % 2 ? term : -term) / k;
  }
  return sum;
}

double logit_of_alpha(double alpha) { return std::log(alpha) - std::log1p(-alpha); }

class Merger {
 public:
  explicit Merger(const MergeJob& job) : job_(job), sum_(3 * job.k) {}

  void merge_group(int64_t group) {
    const int64_t begin = job_.start[group], size = job_.start[group + 1] - begin;
    const int32_t* rows = job_.rows + begin;
    if (size == 1)
      copy(rows[0], group);
    else
      merge_members(rows, size, job_.representatives[group], group);
  }

 private:
  void copy(int64_t row, int64_t group) {
    const int64_t width = 3 * job_.k;
    std::memcpy(job_.means + 3 * group, job_.in.means + 3 * row, 3 * sizeof(float));
    std::memcpy(job_.quats + 4 * group, job_.in.quats + 4 * row, 4 * sizeof(float));
    std::memcpy(job_.log_scales + 3 * group, job_.in.log_scales + 3 * row, 3 * sizeof(float));
    std::memcpy(job_.logit_opacities + group, job_.in.logit_opacities + row, sizeof(float));
    std::memcpy(job_.sh + width * group, job_.in.sh + width * row, width * sizeof(float));
  }

  void merge_members(const int32_t* rows, int64_t size, int64_t representative, int64_t group) {
    read_members(rows, size);
    double mean[3] = {0, 0, 0};
    for (const Member& m : members_)
      for (int a = 0; a < 3; ++a) mean[a] += m.weight * m.mean[a];
    for (int a = 0; a < 3; ++a) {
      mean[a] = job_.keep_position ? job_.in.means[3 * representative + a] : mean[a] / total_;
      job_.means[3 * group + a] = static_cast<float>(mean[a]);
    }
    double variance[3];
    if (job_.rule == MergeRule::MOMENTS)
      merge_moments(rows, mean, variance, group);
    else
      merge_axes(rows, mean, representative, variance, group);
    const double widening = merge_opacity(variance, group);
    for (int a = 0; a < 3; ++a) job_.log_scales[3 * group + a] = static_cast<float>(0.5 * std::log(variance[a]) + widening);
    merge_harmonics(rows, size, group);
  }

  void read_members(const int32_t* rows, int64_t size) {
    members_.resize(size);
    total_ = 0;
    for (int64_t i = 0; i < size; ++i) {
      const int64_t row = rows[i];
      Member& m = members_[i];
      for (int a = 0; a < 3; ++a) {
        m.mean[a] = job_.in.means[3 * row + a];
        m.variance[a] = std::exp(2 * clamped_log_scale(job_.in.log_scales[3 * row + a]));
      }
      const double logit = job_.in.logit_opacities[row], e = std::exp(-std::abs(logit));
      m.alpha = (logit > 0 ? 1 : e) / (1 + e);
      m.depth = std::max(logit, 0.0) + std::log1p(e);
      m.log_alpha = logit - m.depth;
      m.weight = job_.weights[row];
      total_ += m.weight;
    }
  }

  // Mean and covariance of the group as one distribution: Σ = Σ w (Σ_i + d dᵀ) / W.
  void merge_moments(const int32_t* rows, const double* mean, double* variance, int64_t group) {
    double A[3][3] = {};
    double mean_sigma = 0;
    for (size_t i = 0; i < members_.size(); ++i) {
      const Member& m = members_[i];
      double R[9];
      rotation_from_quat(job_.in.quats + 4 * int64_t{rows[i]}, R);
      const double d[3] = {m.mean[0] - mean[0], m.mean[1] - mean[1], m.mean[2] - mean[2]};
      const double share = m.weight / total_;
      for (int p = 0; p < 3; ++p)
        for (int q = p; q < 3; ++q)
          A[p][q] += share * (R[3 * p] * R[3 * q] * m.variance[0] + R[3 * p + 1] * R[3 * q + 1] * m.variance[1] +
                              R[3 * p + 2] * R[3 * q + 2] * m.variance[2] + d[p] * d[q]);
      mean_sigma += share * std::sqrt(std::max({m.variance[0], m.variance[1], m.variance[2]}));
    }
    A[1][0] = A[0][1], A[2][0] = A[0][2], A[2][1] = A[1][2];
    double R[9];
    eigen_symmetric(A, variance, R);
    // Below this share of the largest, an eigenvalue is rounding.
    const double floor = std::max(variance[0] * 1e-15, std::exp(-2 * LOG_SCALE_MAX));
    const double bound = job_.scale_bound * mean_sigma;
    for (int a = 0; a < 3; ++a) variance[a] = std::min(std::max(variance[a], floor), bound * bound);
    quat_from_rotation(R, job_.quats + 4 * group);
  }

  // Axis by axis: σ_a² = Σ w (|x − x̄|² + σ_{i,a}²) / W, bounded by κ times the weighted mean of σ_a; quaternions averaged in
  // the hemisphere of the representative's.
  void merge_axes(const int32_t* rows, const double* mean, int64_t representative, double* variance, int64_t group) {
    double spread = 0, mean_sigma[3] = {0, 0, 0}, q[4] = {0, 0, 0, 0};
    for (int a = 0; a < 3; ++a) variance[a] = 0;
    const float* reference = job_.in.quats + 4 * representative;
    for (size_t i = 0; i < members_.size(); ++i) {
      const Member& m = members_[i];
      const double share = m.weight / total_;
      const float* quat = job_.in.quats + 4 * int64_t{rows[i]};
      double dot = 0, norm2 = 0;
      for (int a = 0; a < 3; ++a) {
        const double d = m.mean[a] - mean[a];
        spread += share * d * d;
        variance[a] += share * m.variance[a];
        mean_sigma[a] += share * std::sqrt(m.variance[a]);
      }
      for (int a = 0; a < 4; ++a) dot += double{quat[a]} * reference[a], norm2 += double{quat[a]} * quat[a];
      const double factor = share * (dot < 0 ? -1 : 1) / std::sqrt(norm2);
      for (int a = 0; a < 4; ++a) q[a] += factor * quat[a];
    }
    for (int a = 0; a < 3; ++a) {
      const double bound = job_.scale_bound * mean_sigma[a];
      variance[a] = std::min(variance[a] + spread, bound * bound);
    }
    const double norm = std::sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
    for (int a = 0; a < 4; ++a) job_.quats[4 * group + a] = norm > 1e-9 ? static_cast<float>(q[a] / norm) : reference[a];
  }

  // Writes the opacity and returns what is to be added to the logarithm of the scales.
  double merge_opacity(const double* variance, int64_t group) {
    if (job_.opacities && job_.opacities[group] > 0) {
      job_.logit_opacities[group] = static_cast<float>(logit_of_alpha(job_.opacities[group]));
      return 0;
    }
    double log_through = 0, mass = 0;  // log Π (1 − α_i); Σ α_i A_i or Σ Li₂(α_i) A_i
    const double added = job_.added + job_.dilation * std::max({variance[0], variance[1], variance[2]});
    for (const Member& m : members_) {
      log_through -= m.depth;
      if (job_.opacity == OpacityRule::UNION) continue;
      const double depth = job_.opacity == OpacityRule::OPTICAL ? dilogarithm(m.depth, -m.log_alpha) : m.alpha;
      mass += depth * dilated_area(m.variance, added);
    }
    const double limit = logit_of_alpha(ALPHA_MAX);
    // logit(1 − e^L) = log(e^−L − 1)
    const double union_logit = log_through < -700 ? -log_through : std::log(std::expm1(-log_through));
    double logit = std::min(union_logit, limit), widening = 0;
    if (job_.opacity != OpacityRule::UNION) {
      mass /= dilated_area(variance, added);
      if (job_.opacity == OpacityRule::OPTICAL) {
        static const double most = dilogarithm(-std::log1p(-ALPHA_MAX)), most_covered = coverage(most);
        logit = mass >= most ? limit : mass > 0 ? std::log(std::expm1(inverse_dilogarithm(mass))) : union_logit;
        if (mass > most) widening = 0.5 * std::log(coverage(mass) / most_covered);
      } else if (job_.opacity == OpacityRule::MASS) {
        logit = mass > 0 ? logit_of_alpha(std::min(mass, ALPHA_MAX)) : union_logit;
      } else {
        if (mass > -std::expm1(log_through)) logit = logit_of_alpha(std::min(mass, ALPHA_MAX));
        if (mass > 1) widening = job_.widening * std::log(std::min(mass, job_.mass_limit));
      }
    }
    job_.logit_opacities[group] = static_cast<float>(std::max(logit, -1e30));
    return widening;
  }

  void merge_harmonics(const int32_t* rows, int64_t size, int64_t group) {
    const int64_t width = 3 * job_.k;
    std::fill(sum_.begin(), sum_.end(), 0.0);
    for (int64_t i = 0; i < size; ++i) {
      const float* sh = job_.in.sh + width * int64_t{rows[i]};
      const double share = members_[i].weight / total_;
      for (int64_t j = 0; j < width; ++j) sum_[j] += share * sh[j];
    }
    for (int64_t j = 0; j < width; ++j) job_.sh[width * group + j] = static_cast<float>(sum_[j]);
  }

  const MergeJob& job_;
  std::vector<Member> members_;
  std::vector<double> sum_;
  double total_ = 0;
};

}  // namespace

void merge(const MergeJob& job) {
  parallel_ranges(job.num_groups, 1 << 11, job.threads, [&](int64_t begin, int64_t end) {
    Merger merger(job);
    for (int64_t group = begin; group < end; ++group) merger.merge_group(group);
  });
}

void group_rows(int64_t n, const int32_t* group_from_row, int64_t num_groups, int64_t* start, int32_t* rows) {
  std::fill(start, start + num_groups + 1, int64_t{0});
  for (int64_t i = 0; i < n; ++i) ++start[group_from_row[i] + 1];
  for (int64_t g = 0; g < num_groups; ++g) start[g + 1] += start[g];
  std::vector<int64_t> next(start, start + num_groups);
  for (int64_t i = 0; i < n; ++i) rows[next[group_from_row[i]]++] = static_cast<int32_t>(i);
}

void average_children(int64_t n, int64_t width, const int32_t* subtree_end, const float* weights, float* values, int threads) {
  // Children of i start at i + 1 and follow each other.
  const auto average = [&](int64_t i) {
    const int64_t end = subtree_end[i];
    if (end == i + 1) return;
    float* mean = values + width * i;
    double total = 0;
    for (int64_t child = i + 1; child < end; child = subtree_end[child]) total += weights[child];
    for (int64_t j = 0; j < width; ++j) mean[j] = 0;
    for (int64_t child = i + 1; child < end; child = subtree_end[child]) {
      const float share = static_cast<float>(weights[child] / total);
      const float* value = values + width * child;
      for (int64_t j = 0; j < width; ++j) mean[j] += share * value[j];
    }
  };
  from_children_to_parents(n, subtree_end, threads, average);
}

}  // namespace splatree
